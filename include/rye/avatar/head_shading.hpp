// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/head_shading.hpp: lights that stay while the head turns. The first three channels of
/// every Gaussian are multiplied by
///     exp(E(R n) - E(n)),   E(n) = sum of light_k Y_k(n) over bands 1 and 2,
/// for each of them: E is the logarithm of the light that a surface with the normal n gets, R the
/// head's rotation. So colours are those of the head at rotation 0, and light is one for the scene.
/// Normals are trained and have any length: a short one belongs to a point that less light changes.
/// Y_k are those of math/harmonics.hpp. Head frame. Not in the paper.
/// Source: irradiance in nine harmonics, Ramamoorthi and Hanrahan, "An Efficient Representation for
/// Irradiance Environment Maps", 2001; here of its logarithm, so that no colour becomes negative.
#pragma once

#include <algorithm>

#include <rye/backend/backend.hpp>
#include <rye/core/array.hpp>
#include <rye/core/fields.hpp>
#include <rye/gaussian/gaussians.hpp>
#include <rye/math/harmonics.hpp>
#include <rye/math/rotation.hpp>

namespace rye {

/// Trained parameters of the shading of N Gaussians of the face and of both eyeballs. Without any
/// (default-constructed) nothing is shaded.
template <class T>
struct Shading {
    Columns<T> light;      ///< coefficients of Y_1 to Y_8 of the logarithm of R, G, B, 8 x 3
    Columns<T> normal;     ///< of the face's Gaussians, 3 x N
    Columns<T> eye_normal; ///< of each eyeball, one for all of its Gaussians, 3 x 2

    bool any() const { return light.size() > 0; }

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        if (!(p.any() || ...)) return;
        f("light", p.light...);
        f("normal", p.normal...);
        f("eye_normal", p.eye_normal...);
    }
};

/// No light yet, which shades nothing; the eyes' normals are +z.
template <class T>
Shading<T> initial_shading(const Columns<T>& normals) {
    return {Columns<T>::Zero(8, 3), normals, Vec3<T>(T(0), T(0), T(1)).replicate(1, 2)};
}

/// A driven frame as the shading reads it.
template <class T>
struct ShadedFrame {
    Vec3<T> rotation;  ///< of the head, axis-angle [rad]
    Index face_count;  ///< of the cloud's columns those of the face come first,
    Index left_points; ///< then these of the left eye, then the right one's
};

/// Intermediate results of shade for its vjp.
template <class T>
struct ShadingTrace {
    Columns<T> gain; ///< 3 x (N + 2): of the face's Gaussians, then of each eyeball
};

namespace detail {

/// E of one channel: a linear and a quadratic form of the normal.
template <class T>
struct LogLight {
    Vec3<T> linear = Vec3<T>::Zero();
    Mat3<T> quadratic = Mat3<T>::Zero(); ///< symmetric

    RYE_HD T at(const Vec3<T>& n) const { return dot(n, Vec3<T>(linear + quadratic * n)); }
    /// Its gradient by the normal.
    RYE_HD Vec3<T> slope(const Vec3<T>& n) const { return linear + T(2) * (quadratic * n); }
    /// Adds the cotangent g of a value at n; this holds cotangents.
    RYE_HD void add(const T& g, const Vec3<T>& n) {
        linear += g * n;
        quadratic += g * (n * n.transpose());
    }
    RYE_HD LogLight& operator+=(const LogLight& b) {
        linear += b.linear;
        quadratic += b.quadratic;
        return *this;
    }
};

/// The forms of Y_1 to Y_8 with these coefficients.
template <class T, class C>
RYE_HD LogLight<T> log_light(const C& light) {
    const auto c = [&](int k) {
        return T(constant<T>(sh_factor(static_cast<std::size_t>(k))) * light(k - 1));
    };
    const T half = constant<T>(0.5);
    LogLight<T> e;
    e.linear = Vec3<T>(c(3), c(1), c(2));
    Mat3<T>& m = e.quadratic;
    m(0, 1) = m(1, 0) = half * c(4);
    m(1, 2) = m(2, 1) = half * c(5);
    m(0, 2) = m(2, 0) = half * c(7);
    m(0, 0) = c(8) - c(6);
    m(1, 1) = -c(8) - c(6);
    m(2, 2) = T(2) * c(6);
    return e;
}

/// Adds the coefficients' cotangent, given that of the forms.
template <class T, class G>
RYE_HD void log_light_vjp(const LogLight<T>& g, G&& g_light) {
    const auto add = [&](int k, const T& v) {
        g_light(k - 1) += T(sh_factor(static_cast<std::size_t>(k))) * v;
    };
    const Mat3<T>& m = g.quadratic;
    add(1, g.linear[1]), add(2, g.linear[2]), add(3, g.linear[0]);
    add(4, T(0.5) * (m(0, 1) + m(1, 0)));
    add(5, T(0.5) * (m(1, 2) + m(2, 1)));
    add(6, T(2) * m(2, 2) - m(0, 0) - m(1, 1));
    add(7, T(0.5) * (m(0, 2) + m(2, 0)));
    add(8, m(0, 0) - m(1, 1));
}

/// E(R n) - E(n) as forms of n, of one channel; exactly 0 where R is the identity.
template <class T>
RYE_HD void turned_light(const LogLight<T>& e, const Mat3<T>& r, LogLight<T>& change) {
    change.linear = r.transpose() * e.linear - e.linear;
    change.quadratic = r.transpose() * (e.quadratic * r) - e.quadratic;
}
/// Adds the cotangent of the coefficients of E, given that of its change; returns that of R.
template <class T, class G>
RYE_HD Mat3<T> turned_light_vjp(const LogLight<T>& e, const Mat3<T>& r, const LogLight<T>& g,
                                G&& g_light) {
    log_light_vjp<T>({r * g.linear - g.linear, r * (g.quadratic * r.transpose()) - g.quadratic},
                     g_light);
    return e.linear * g.linear.transpose() + T(2) * (e.quadratic * (r * g.quadratic));
}

/// One for each channel.
template <class T>
struct LightChange {
    Array<LogLight<T>, 3> of;

    LightChange& operator+=(const LightChange& b) {
        for (std::size_t c = 0; c < 3; ++c) of[c] += b.of[c];
        return *this;
    }
};

/// The change of each.
template <class T>
LightChange<T> light_change(const Shading<T>& shading, const Mat3<T>& r) {
    LightChange<T> change;
    for (std::size_t c = 0; c < 3; ++c) {
        const LogLight<T> e = log_light<T>(shading.light.col(static_cast<Index>(c)));
        turned_light(e, r, change.of[c]);
    }
    return change;
}

/// The normal of column i of the trace's gain.
template <class T>
Vec3<T> shaded_normal(const Shading<T>& shading, Index i) {
    const Index n = shading.normal.cols();
    return i < n ? shading.normal.col(i) : shading.eye_normal.col(i - n);
}

/// Columns of the cloud that column N + eye of the trace's gain shades: the first, and how many.
template <class T>
ColumnRange shaded_eye(const ShadedFrame<T>& frame, Index eye, Index all) {
    const Index right = frame.face_count + frame.left_points;
    return eye == 0 ? ColumnRange{frame.face_count, frame.left_points}
                    : ColumnRange{right, all - right};
}

/// Columns [begin, end) of shading_gain's.
template <class T>
void gain_range(const Shading<T>& shading, const LightChange<T>& change, Index begin, Index end,
                Columns<T>& gain) {
    for (Index i = begin; i < end; ++i) {
        const Vec3<T> normal = shaded_normal(shading, i);
        for (Index c = 0; c < 3; ++c)
            gain(c, i) = change.of[static_cast<std::size_t>(c)].at(normal);
    }
    const Columns<T> log_gain = gain.middleCols(begin, end - begin);
    gain.middleCols(begin, end - begin) = log_gain.array().exp().matrix();
}

/// Sets the gains of a head at this rotation (axis-angle [rad]), 3 x (N + 2): of the face's
/// Gaussians, then of each eyeball. The shading must have parameters.
template <class T, Backend B>
void shading_gain(const B& backend, const Shading<T>& shading, const Vec3<T>& rotation,
                  Columns<T>& gain) {
    const detail::LightChange<T> change = detail::light_change(shading, so3_exp(rotation));
    gain.resize(3, shading.normal.cols() + 2);
    for_chunks(backend.threads, gain.cols(), 512, [&](Index b, Index e, Index) {
        detail::gain_range(shading, change, b, e, gain);
    });
}

} // namespace detail

/// Multiplies the first three channels of a Gaussian's features by column `of` of the gains.
template <class T>
void shade_point(const Columns<T>& gain, Index of, Columns<T>& feature, Index i) {
    for (Index c = 0; c < 3; ++c) feature(c, i) *= gain(c, of);
}

/// Multiplies the first three channels of a driven cloud's features, C x P.
template <class T, Backend B>
void shade(const B& backend, const Shading<T>& shading,
           const std::type_identity_t<ShadedFrame<T>>& frame, Columns<T>& feature,
           ShadingTrace<T>& trace) {
    if (!shading.any()) return;
    const Index n = frame.face_count;
    RYE_ASSERT(shading.normal.cols() == n, "shade: another number of normals");
    const detail::LightChange<T> change = detail::light_change(shading, so3_exp(frame.rotation));
    trace.gain.resize(3, n + 2);
    for_chunks(backend.threads, n + 2, 512, [&](Index b, Index e, Index) {
        detail::gain_range(shading, change, b, e, trace.gain);
        for (Index i = b; i < std::min(e, n); ++i) shade_point(trace.gain, i, feature, i);
    });
    for (Index eye = 0; eye < 2; ++eye) {
        const detail::ColumnRange of = detail::shaded_eye(frame, eye, feature.cols());
        for (Index i = of.begin; i < of.begin + of.count; ++i)
            shade_point(trace.gain, n + eye, feature, i);
    }
}

namespace detail {

/// A shaded frame, as far as its vjp reads it: features as shade left them.
template <class T>
struct ShadedPass {
    ShadedFrame<T> frame;
    const Columns<T>& feature;
    const ShadingTrace<T>& trace;
};

} // namespace detail

/// Turns the cotangent of shaded features into that of the features before, and adds the
/// parameters' gradient. Returns the cotangent of the head's axis-angle.
template <class T, Backend B>
Vec3<T> shade_vjp(const B& backend, const Shading<T>& shading,
                  const std::type_identity_t<detail::ShadedPass<T>>& pass, Columns<T>& g_feature,
                  Shading<T>& grad) {
    Vec3<T> g_rotation(T(0), T(0), T(0));
    if (!shading.any()) return g_rotation;
    const ShadedFrame<T>& frame = pass.frame;
    const Columns<T>&gain = pass.trace.gain, &feature = pass.feature;
    const Index n = frame.face_count;
    const Mat3<T> r = so3_exp(frame.rotation);
    const detail::LightChange<T> change = detail::light_change(shading, r);
    // The cotangent of a column's log gain, which becomes that of its normal and of the forms.
    const auto back = [&](Index i, const Vec3<T>& g_log, detail::LightChange<T>& sum) {
        const Vec3<T> normal = detail::shaded_normal(shading, i);
        Vec3<T> g_normal(T(0), T(0), T(0));
        for (std::size_t c = 0; c < 3; ++c) {
            const T g = g_log[static_cast<Index>(c)];
            g_normal += g * change.of[c].slope(normal);
            sum.of[c].add(g, normal);
        }
        if (i < n)
            grad.normal.col(i) += g_normal;
        else
            grad.eye_normal.col(i - n) += g_normal;
    };
    detail::LightChange<T> sum =
        sum_chunks(backend.threads, n, 512, detail::LightChange<T>{}, [&](Index b, Index e) {
            detail::LightChange<T> part;
            for (Index i = b; i < e; ++i) {
                const Vec3<T> g = g_feature.col(i).template head<3>();
                back(i, g.cwiseProduct(feature.col(i).template head<3>()), part);
                g_feature.col(i).template head<3>() = g.cwiseProduct(gain.col(i));
            }
            return part;
        });
    for (Index eye = 0; eye < 2; ++eye) {
        Vec3<T> g_log(T(0), T(0), T(0));
        const detail::ColumnRange of = detail::shaded_eye(frame, eye, feature.cols());
        for (Index i = of.begin; i < of.begin + of.count; ++i) {
            const Vec3<T> g = g_feature.col(i).template head<3>();
            g_log += g.cwiseProduct(feature.col(i).template head<3>());
            g_feature.col(i).template head<3>() = g.cwiseProduct(gain.col(n + eye));
        }
        back(n + eye, g_log, sum);
    }
    Mat3<T> g_r = Mat3<T>::Zero();
    for (std::size_t c = 0; c < 3; ++c) {
        const detail::LogLight<T> e =
            detail::log_light<T>(shading.light.col(static_cast<Index>(c)));
        g_r += detail::turned_light_vjp<T>(e, r, sum.of[c], grad.light.col(static_cast<Index>(c)));
    }
    return so3_exp_vjp(frame.rotation, g_r);
}

} // namespace rye
