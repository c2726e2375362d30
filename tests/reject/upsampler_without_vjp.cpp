// SPDX-License-Identifier: Apache-2.0
// A super-resolution network without a derivative could not be trained.
// expect: UpsamplerPolicy
#include <rye/rig/parts.hpp>

template <class T>
struct Same {
    struct Trace {};
    static Same init(const rye::UpsamplerShape&, const rye::Random&) { return {}; }
    static void fields(auto&&, auto&&...) {}
};
template <class T, class B>
rye::Image<T> upsampler_forward(const B&, const Same<T>&, const rye::Image<T>& in, auto*) {
    return in;
}
#if !REJECT
template <class T, class B>
void upsampler_vjp(const B&, const Same<T>&, const rye::Image<T>&, const auto&,
                   const rye::Columns<T>& g, Same<T>&, rye::Columns<T>* g_in) {
    *g_in = g;
}
#endif
struct SameSize {
    template <class T>
    using Network = Same<T>;
};

using Mine = rye::More<rye::PaperEffects, rye::UpsampledBy<SameSize>>;
