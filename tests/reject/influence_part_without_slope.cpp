// SPDX-License-Identifier: Apache-2.0
// A part whose metric of the influence has a value but no slope could not be trained.
// expect: m\.slope
#include <rye/rig/parts.hpp>

struct Sharp {
    template <class T>
    T value(const rye::Ramp<T>& ramp, const T& squared) const {
        return squared < ramp.near ? T(1) : T(0);
    }
#if !REJECT
    template <class T>
    T slope(const rye::Ramp<T>&, const T&) const {
        return T(0);
    }
#endif
};

using Mine = rye::More<rye::PaperEffects, rye::ExpressionInfluence<Sharp>>;
