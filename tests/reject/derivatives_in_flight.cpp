// SPDX-License-Identifier: Apache-2.0
// Duals of two differentiations at once have different tags, so that their tangents cannot be
// added by mistake.
// expect: no match for .operator\+.|invalid operands to binary expression
// lines: 30
#include <rye/autodiff/dual.hpp>

struct Inner {};

rye::Dual<double, 1> sum(const rye::Dual<double, 1>& a, const rye::Dual<double, 1, Inner>& b) {
#if REJECT
    return a + b;
#else
    return a + b.value;
#endif
}
