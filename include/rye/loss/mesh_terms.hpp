// SPDX-License-Identifier: Apache-2.0
/// rye/loss/mesh_terms.hpp: the seven losses of the guidance mesh (stage 1), unweighted.
/// Each takes plain columns and returns value and gradient. Units: lengths as given, colours and
/// masks in 0..1. Sums of floats run in double. |x| has derivative 0 at 0.
/// Source: the paper's L_RGB, L_sil, L_def, L_offset, L_lmk, L_lap, L_eyeoffset, with the means
/// as in Gaussian Head Avatar.
#pragma once

#include <type_traits>
#include <vector>

#include <rye/autodiff/widen.hpp>
#include <rye/geometry/mesh.hpp>
#include <rye/loss/photometric.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

/// A loss, its gradient, and the number of values in its mean. A mean over nothing has value 0,
/// count 0 and gradient 0: it can be added, and its absence stays visible.
template <class T>
struct LossTerm : LossGradient<T> {
    Index count = 0;
};

namespace detail {

/// Returns the sum of x^2 / n and its gradient.
template <class T>
LossTerm<T> sum_of_squares(const ColumnsView<T>& x, Index n) {
    using W = widened_t<T>;
    LossTerm<T> out{{T(0), Columns<T>::Zero(x.rows(), x.cols())}, n};
    if (n == 0) return out;
    const double each = 1.0 / static_cast<double>(n);
    W sum(0);
    for (Index j = 0; j < x.cols(); ++j)
        for (Index i = 0; i < x.rows(); ++i) {
            const W v = scalar_cast<W>(T(x(i, j)));
            sum += v * v;
            out.gradient(i, j) = T(2 * each) * x(i, j);
        }
    out.value = scalar_cast<T>(W(W(each) * sum));
    return out;
}

/// Returns the mean of |x| and its gradient.
template <class T>
LossTerm<T> mean_absolute(const ColumnsView<T>& x) {
    using std::abs;
    using W = widened_t<T>;
    LossTerm<T> out{{T(0), Columns<T>::Zero(x.rows(), x.cols())}, x.size()};
    if (out.count == 0) return out;
    const double each = 1.0 / static_cast<double>(out.count);
    W sum(0);
    for (Index j = 0; j < x.cols(); ++j)
        for (Index i = 0; i < x.rows(); ++i) {
            sum += scalar_cast<W>(T(abs(T(x(i, j)))));
            out.gradient(i, j) = T(each) * sign_of<T>(x(i, j));
        }
    out.value = scalar_cast<T>(W(W(each) * sum));
    return out;
}

/// Returns L_RGB: mean over pixels and channels of |(color - target) visible|. color, target:
/// 3 x P, visible: 1 x P. Invisible pixels count in the mean, as zeros.
template <class T, Backend B>
LossTerm<T> color_term(const B& backend, const std::type_identity_t<ColumnsView<T>>& color,
                       const std::type_identity_t<ColumnsView<T>>& target,
                       const Columns<T>& visible) {
    return {masked_l1<T>(backend, color, target, visible), color.size()};
}

/// Returns L_sil: 1 - sum ab / (sum (a + b - ab) + 1e-10) with a = soft visible, b = mask visible,
/// all 1 x P, and its gradient with respect to soft. Two empty masks give 0, count 0.
template <class T, Backend B>
LossTerm<T> silhouette_term(const B& backend, const std::type_identity_t<ColumnsView<T>>& soft,
                            const std::type_identity_t<ColumnsView<T>>& mask,
                            const std::type_identity_t<ColumnsView<T>>& visible) {
    RYE_ASSERT(soft.cols() == mask.cols() && soft.cols() == visible.cols(),
               "silhouette_term: soft, mask and visible differ in size");
    using W = widened_t<T>;
    const auto get = [](const auto& m, Index p) { return scalar_cast<W>(T(m(0, p))); };
    const Vec2<W> sums = sum_chunks(
        backend.threads, soft.cols(), detail::loss_grain, Vec2<W>(W(0), W(0)),
        [&](Index begin, Index end) {
            Vec2<W> of(W(0), W(0));
            for (Index p = begin; p < end; ++p) {
                const W v = get(visible, p), a = get(soft, p) * v, b = get(mask, p) * v;
                of[0] += a * b;
                of[1] += a + b * (W(1) - a);
            }
            return of;
        });
    const W &both = sums[0], &either = sums[1];
    LossTerm<T> out{{T(0), Columns<T>::Zero(1, soft.cols())}, 0};
    if (!(value_of(either) > 0)) return out;
    out.count = soft.cols();
    const W scale = W(1) / (either + W(1e-10));
    const W iou = both * scale;
    out.value = scalar_cast<T>(W(W(1) - iou));
    for_chunks(backend.threads, soft.cols(), detail::loss_grain,
               [&](Index begin, Index end, Index) {
                   for (Index p = begin; p < end; ++p) {
                       const W v = get(visible, p), b = get(mask, p) * v;
                       out.gradient(0, p) = scalar_cast<T>(W((iou * (W(1) - b) - b) * scale * v));
                   }
               });
    return out;
}

/// Returns L_def: mean over points and axes of the squared distance of deformed to observed
/// landmarks, both 3 x L in the head frame.
template <class T>
LossTerm<T> deformation_term(const ColumnsView<T>& deformed, const ColumnsView<T>& observed) {
    const Columns<T> difference = deformed - observed;
    return detail::sum_of_squares<T>(difference, difference.size());
}

/// Returns L_offset of one deformation: mean over points of the squared length of its raw output,
/// D x M.
template <class T>
LossTerm<T> offset_term(const ColumnsView<T>& displacement) {
    return detail::sum_of_squares<T>(displacement, displacement.cols());
}

/// Returns L_lmk: mean |sdf| at the neutral landmarks, 1 x L.
template <class T>
LossTerm<T> landmark_term(const ColumnsView<T>& sdf) {
    return detail::mean_absolute<T>(sdf);
}

/// Returns L_lap: mean over vertices and axes of the squared uniform Laplacian of posed vertices,
/// 3 x V in the world; its weight depends on the world's unit.
template <class T>
LossTerm<T> laplacian_term(const ColumnsView<T>& vertices, const std::vector<Face>& faces) {
    const Columns<T> laplacian = uniform_laplacian<T>(vertices, faces);
    LossTerm<T> out = detail::sum_of_squares<T>(laplacian, laplacian.size());
    out.gradient = laplacian_vjp<T>(faces, out.gradient);
    return out;
}

/// Returns L_eyeoffset: mean over eyes and axes of |predicted - observed| displacement of the eyes'
/// centres, both 3 x 2 in the head frame.
template <class T>
LossTerm<T> eye_offset_term(const ColumnsView<T>& predicted, const ColumnsView<T>& observed) {
    const Columns<T> difference = predicted - observed;
    return detail::mean_absolute<T>(difference);
}

} // namespace detail

} // namespace rye
