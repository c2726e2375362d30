// SPDX-License-Identifier: Apache-2.0
// Products by libraries that the build found, as a program that links one would write them.
#pragma once

#include <rye/nn/product.hpp>

#ifdef RYE_BENCH_CBLAS
#include <cblas.h>

struct Cblas {
    static void multiply(const rye::StridedMatrix<const float>& a,
                         const rye::StridedMatrix<const float>& x, bool x_transposed,
                         const rye::StridedMatrix<float>& y) {
        const auto i = [](rye::Index v) { return static_cast<int>(v); };
        cblas_sgemm(CblasColMajor, CblasNoTrans, x_transposed ? CblasTrans : CblasNoTrans,
                    i(y.rows), i(y.cols), i(a.cols), 1.F, a.data, i(a.stride), x.data, i(x.stride),
                    0.F, y.data, i(y.stride));
    }
};
#endif

#ifdef RYE_BENCH_ONEDNN
#include <oneapi/dnnl/dnnl.h>

/// oneDNN's matrices are row-major: all factors transposed, in the other order.
struct OneDnn {
    static void multiply(const rye::StridedMatrix<const float>& a,
                         const rye::StridedMatrix<const float>& x, bool x_transposed,
                         const rye::StridedMatrix<float>& y) {
        dnnl_sgemm(x_transposed ? 'T' : 'N', 'N', y.cols, y.rows, a.cols, 1.F, x.data, x.stride,
                   a.data, a.stride, 0.F, y.data, y.stride);
    }
};
#endif
