// SPDX-License-Identifier: Apache-2.0
// A shape of an eyeball must be one that points are made of.
// expect: EyeballSource
#include <rye/rig/parts.hpp>

namespace mine {

struct Ball {
    double radius = 0.12;
};
#if !REJECT
template <rye::Real T>
rye::EyeballTemplate<T> eyeball_template(const Ball&) {
    return {};
}
#endif

using Parts = rye::More<rye::PaperEffects, rye::EyeballsBy<Ball>>;

} // namespace mine
