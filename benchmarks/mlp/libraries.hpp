// SPDX-License-Identifier: Apache-2.0
// Products by libraries that the build found, as a program that links one would write them.
#pragma once

#include <rye/core/config.hpp>

#ifdef RYE_BENCH_CBLAS
#include <cblas.h>

struct Cblas {
    static void multiply(bool x_transposed, rye::Index m, rye::Index n, rye::Index k,
                         const float* a, rye::Index lda, const float* x, rye::Index ldx, float* y,
                         rye::Index ldy) {
        const auto i = [](rye::Index v) { return static_cast<int>(v); };
        cblas_sgemm(CblasColMajor, CblasNoTrans, x_transposed ? CblasTrans : CblasNoTrans, i(m),
                    i(n), i(k), 1.F, a, i(lda), x, i(ldx), 0.F, y, i(ldy));
    }
};
#endif

#ifdef RYE_BENCH_ONEDNN
#include <oneapi/dnnl/dnnl.h>

/// oneDNN's matrices are row-major: all factors transposed, in the other order.
struct OneDnn {
    static void multiply(bool x_transposed, rye::Index m, rye::Index n, rye::Index k,
                         const float* a, rye::Index lda, const float* x, rye::Index ldx, float* y,
                         rye::Index ldy) {
        dnnl_sgemm(x_transposed ? 'T' : 'N', 'N', n, m, k, 1.F, x, ldx, a, lda, 0.F, y, ldy);
    }
};
#endif
