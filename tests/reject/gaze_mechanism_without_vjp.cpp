// SPDX-License-Identifier: Apache-2.0
// A gaze mechanism whose turn has no derivative could not be trained.
// expect: GazeMechanism
#include <rye/rig/parts.hpp>

struct Still {
    static constexpr bool changes_features = false;
    template <class T>
    using Parameters = rye::detail::NoParameters<T, Still>;
    template <class P>
    static P init(int, const rye::Random&) {
        return {};
    }
    template <class P, class T>
    static rye::Quat<T> turn(const P&, std::size_t, const rye::Vec3<T>&) {
        return rye::Quat<T>(T(1), T(0), T(0), T(0));
    }
#if !REJECT
    template <class P, class T>
    static rye::Vec3<T> turn_vjp(const P&, std::size_t, const rye::Vec3<T>&, const rye::Quat<T>&,
                                 P&) {
        return rye::Vec3<T>::Zero();
    }
#endif
    template <class P, class T>
    static void features(const P&, std::size_t, const rye::Vec3<T>&, rye::ColumnsSpan<T>) {}
    template <class P, class T>
    static rye::Vec3<T> features_vjp(const P&, std::size_t, const rye::Vec3<T>&,
                                     const rye::ColumnsView<T>&, rye::ColumnsSpan<T>, P&) {
        return rye::Vec3<T>::Zero();
    }
};

using Mine = rye::More<rye::PaperEffects, rye::GazeBy<Still>>;
