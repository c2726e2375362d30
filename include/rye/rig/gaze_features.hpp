// SPDX-License-Identifier: Apache-2.0
/// rye/rig/gaze_features.hpp: eye appearances that follow the gaze by features alone, for eyeballs
/// that do not rotate (FixedEye of rig/gaze_mechanisms.hpp), to compare with explicit rotation.
/// They represent ideas of other methods inside rye's avatar, not those methods.
/// | appearance          | idea of   | the gaze                                                 |
/// | RotatedFeatures     | GazeNeRF  | rotates 10 triplets of features of each Gaussian         |
/// | ConditionedFeatures | HeadNeRF  | is one more input of the network that gives the colours  |
/// | RotatedCode         | ST-ED     | rotates 16 triplets of an eye, which a network decodes   |
/// Their functions are those of FreeFeatures (rig/eye_appearance.hpp). They give no cotangent of
/// the gaze, so the effect Kappa cannot learn from them. Frame: the gaze is the optical axis in the
/// head's frame; triplets rotate by the smallest rotation from +z to it, so at rest they are as
/// stored.
/// Sources: Ruzzi et al., "GazeNeRF", 2023, section 3.2; Hong et al., "HeadNeRF", 2022; Zheng et
/// al., "Self-Learning Transformations for Improving Gaze and Head Redirection", 2020.
#pragma once

#include <array>

#include <rye/math/rotation.hpp>
#include <rye/nn/encoding.hpp>
#include <rye/nn/mlp.hpp>
#include <rye/rig/eye_appearance.hpp>
#include <rye/rig/gaze.hpp>

namespace rye {

namespace detail {

/// Returns the columns of an eye: the first, and their number.
template <class T>
std::array<Index, 2> eye_columns(const EyeInputs<T>& in, Index eye) {
    const Index all = in.position.cols();
    return eye == 0 ? std::array<Index, 2>{0, in.left_points}
                    : std::array<Index, 2>{in.left_points, all - in.left_points};
}

/// Returns the smallest rotation from +z to the gaze of an eye.
template <class T>
Mat3<T> gaze_rotation(const EyeInputs<T>& in, Index eye) {
    const Vec3<T> gaze = checked_gaze(Vec3<T>(in.gaze.col(eye)));
    return quat_matrix(shortest_arc(Vec3<T>(T(0), T(0), T(1)), gaze));
}

/// Returns a triplet multiplied by a matrix.
template <class T>
RYE_HD Vec3<T> turned_triplet(const Mat3<T>& by, const Vec3<T>& v) {
    Vec3<T> r;
    for (int a = 0; a < 3; ++a) r[a] = by(a, 0) * v[0] + by(a, 1) * v[1] + by(a, 2) * v[2];
    return r;
}

/// Multiplies each triplet of rows of the columns by a matrix.
template <class T>
void rotate_triplets(const Mat3<T>& by, ColumnsSpan<T> columns) {
    for (Index i = 0; i < columns.cols(); ++i)
        for (Index k = 0; k < columns.rows(); k += 3) {
            const Vec3<T> v =
                turned_triplet<T>(by, Vec3<T>(columns(k, i), columns(k + 1, i), columns(k + 2, i)));
            for (int a = 0; a < 3; ++a) columns(k + a, i) = v[a];
        }
}

/// Returns numbers uniform in +-0.5.
template <class T>
Columns<T> random_latent(Index rows, Index columns, const Random& random) {
    Columns<T> latent(rows, columns);
    for (Index i = 0; i < latent.size(); ++i)
        latent(i) = T(random.uniform(static_cast<std::uint64_t>(i)) - 0.5);
    return latent;
}

/// Returns PyTorch's default initialisation, with outputs about grey.
template <class M>
M grey_mlp(const MlpShape& shape, const Random& random) {
    using T = typename decltype(M::weight)::value_type::Scalar;
    M m = M::init(shape, random);
    m.bias.back().array() += T(0.5);
    return m;
}

} // namespace detail

/// Appearance by 10 triplets of features per Gaussian, which the gaze of its eye rotates and a
/// small network turns into its colour. Without the network, which GazeNeRF has in its neural
/// renderer, the first channels could not be colours.
struct RotatedFeatures {
    static constexpr bool reads_inputs = true;
    static constexpr int latent_size = 30; ///< 10 triplets
    static constexpr int hidden = 64;      ///< width of the network's hidden layer

    /// Trained parameters.
    template <class T>
    struct Parameters {
        Columns<T> latent; ///< 30 x P: triplets at rest; left eye, then right
        Mlp<T> map;        ///< 30 -> C
        template <class F, class... P>
        static void fields(F&& f, P&&... p) {
            f("latent", p.latent...);
            detail::nested_fields<Mlp<T>>("latent_mlp", f, p.map...);
        }
    };
    /// Returns random latents, with colours about grey.
    template <class P>
    static P init(int channels, Index points, const Random& random) {
        using T = typename decltype(P::latent)::Scalar;
        MlpShape shape{{latent_size, hidden, channels}};
        shape.skip_layer = MlpShape::no_skip;
        return {detail::random_latent<T>(latent_size, points, random),
                detail::grey_mlp<decltype(P::map)>(shape, random.fork(1))};
    }
    /// Writes the features, C x P.
    template <class B, class P, class T>
    static void features(const B& backend, const P& p, const EyeInputs<T>& in,
                         ColumnsSpan<T> feature) {
        feature = mlp_forward(backend, p.map, turned(p.latent, in), VecX<T>(), nullptr);
    }
    /// Accumulates the parameters' gradient from the features' cotangent.
    template <class B, class P, class T>
    static void features_vjp(const B& backend, const P& p, const EyeInputs<T>& in,
                             const ColumnsView<T>& g, P& grad) {
        const Columns<T> x = turned(p.latent, in);
        const VecX<T> none;
        MlpTrace<T> trace;
        mlp_forward(backend, p.map, x, none, &trace);
        Columns<T> g_latent;
        mlp_vjp(backend, p.map, {x, none, trace}, g, {grad.map, &g_latent});
        for (Index eye = 0; eye < 2; ++eye) {
            const auto [first, n] = detail::eye_columns(in, eye);
            const Mat3<T> back = detail::gaze_rotation(in, eye).transpose();
            detail::rotate_triplets<T>(back, g_latent.middleCols(first, n));
        }
        grad.latent += g_latent;
    }

  private:
    template <class T>
    static Columns<T> turned(const Columns<T>& latent, const EyeInputs<T>& in) {
        Columns<T> x = latent;
        for (Index eye = 0; eye < 2; ++eye) {
            const auto [first, n] = detail::eye_columns(in, eye);
            detail::rotate_triplets<T>(detail::gaze_rotation(in, eye), x.middleCols(first, n));
        }
        return x;
    }
};

/// Appearance by a latent per Gaussian: a network of the latent and of the encoded pitch and yaw of
/// its eye gives its colour.
struct ConditionedFeatures {
    static constexpr bool reads_inputs = true;
    static constexpr int latent_size = 30; ///< as in RotatedFeatures
    static constexpr int hidden = 128;     ///< width of the network's hidden layer
    static constexpr int gaze_code =
        static_cast<int>(detail::encoded_size(2, detail::default_frequencies));

    /// Trained parameters.
    template <class T>
    struct Parameters {
        Columns<T> latent; ///< 30 x P; left eye, then right
        Mlp<T> color;      ///< latent and code of the gaze to C
        template <class F, class... P>
        static void fields(F&& f, P&&... p) {
            f("latent", p.latent...);
            detail::nested_fields<Mlp<T>>("conditioned_mlp", f, p.color...);
        }
    };
    /// Returns random latents, with colours about grey.
    template <class P>
    static P init(int channels, Index points, const Random& random) {
        using T = typename decltype(P::latent)::Scalar;
        MlpShape shape{{latent_size + gaze_code, hidden, channels}, gaze_code};
        shape.skip_layer = MlpShape::no_skip;
        return {detail::random_latent<T>(latent_size, points, random),
                detail::grey_mlp<decltype(P::color)>(shape, random.fork(1))};
    }
    /// Writes the features, C x P.
    template <class B, class P, class T>
    static void features(const B& backend, const P& p, const EyeInputs<T>& in,
                         ColumnsSpan<T> feature) {
        for (Index eye = 0; eye < 2; ++eye) {
            const auto [first, n] = detail::eye_columns(in, eye);
            feature.middleCols(first, n) = mlp_forward(
                backend, p.color, p.latent.middleCols(first, n), code(in, eye), nullptr);
        }
    }
    /// Accumulates the parameters' gradient from the features' cotangent.
    template <class B, class P, class T>
    static void features_vjp(const B& backend, const P& p, const EyeInputs<T>& in,
                             const ColumnsView<T>& g, P& grad) {
        for (Index eye = 0; eye < 2; ++eye) {
            const auto [first, n] = detail::eye_columns(in, eye);
            const Columns<T> latent = p.latent.middleCols(first, n);
            const VecX<T> frame = code(in, eye);
            MlpTrace<T> trace;
            mlp_forward(backend, p.color, latent, frame, &trace);
            Columns<T> g_latent;
            mlp_vjp(backend, p.color, {latent, frame, trace}, g.middleCols(first, n),
                    {grad.color, &g_latent});
            grad.latent.middleCols(first, n) += g_latent;
        }
    }

  private:
    template <class T>
    static VecX<T> code(const EyeInputs<T>& in, Index eye) {
        return encode_gaze(detail::checked_gaze(Vec3<T>(in.gaze.col(eye)))).col(0);
    }
};

/// Appearance by one code of 16 triplets per eye, which its gaze rotates: a network of the rotated
/// code and of a Gaussian's encoded position on the eyeball gives its colour. ST-ED decodes
/// pictures by convolutions; the position stands for the pixel.
struct RotatedCode {
    static constexpr bool reads_inputs = true;
    static constexpr int latent_size = 48; ///< 16 triplets
    static constexpr int frequencies = 6;  ///< octaves; positions in eyeball radii
    static constexpr int hidden = 128;     ///< width of the two hidden layers
    static constexpr int place_code = static_cast<int>(detail::encoded_size(3, frequencies));

    /// Trained parameters.
    template <class T>
    struct Parameters {
        Columns<T> latent; ///< 48 x 2: triplets at rest; left eye, then right
        Mlp<T> decoder;    ///< code of the position and latent of the eye to C
        template <class F, class... P>
        static void fields(F&& f, P&&... p) {
            f("latent", p.latent...);
            detail::nested_fields<Mlp<T>>("decoder_mlp", f, p.decoder...);
        }
    };
    /// Returns random codes, with colours about grey.
    template <class P>
    static P init(int channels, Index, const Random& random) {
        using T = typename decltype(P::latent)::Scalar;
        const MlpShape shape{{place_code + latent_size, hidden, hidden, channels}, latent_size};
        return {detail::random_latent<T>(latent_size, 2, random),
                detail::grey_mlp<decltype(P::decoder)>(shape, random.fork(1))};
    }
    /// Writes the features, C x P.
    template <class B, class P, class T>
    static void features(const B& backend, const P& p, const EyeInputs<T>& in,
                         ColumnsSpan<T> feature) {
        for (Index eye = 0; eye < 2; ++eye) {
            const auto [first, n] = detail::eye_columns(in, eye);
            feature.middleCols(first, n) = mlp_forward(backend, p.decoder, places(in, eye),
                                                       turned(p.latent, in, eye), nullptr);
        }
    }
    /// Accumulates the parameters' gradient from the features' cotangent.
    template <class B, class P, class T>
    static void features_vjp(const B& backend, const P& p, const EyeInputs<T>& in,
                             const ColumnsView<T>& g, P& grad) {
        for (Index eye = 0; eye < 2; ++eye) {
            const auto [first, n] = detail::eye_columns(in, eye);
            const Columns<T> x = places(in, eye);
            const VecX<T> frame = turned(p.latent, in, eye);
            MlpTrace<T> trace;
            mlp_forward(backend, p.decoder, x, frame, &trace);
            VecX<T> g_frame;
            mlp_vjp(backend, p.decoder, {x, frame, trace}, g.middleCols(first, n),
                    {grad.decoder, nullptr, &g_frame});
            Columns<T> g_latent = g_frame;
            detail::rotate_triplets<T>(detail::gaze_rotation(in, eye).transpose(), g_latent);
            grad.latent.col(eye) += g_latent.col(0);
        }
    }

    /// Returns the encoded positions of an eye's points, in units of their largest distance from
    /// the centre.
    template <class T>
    static Columns<T> places(const EyeInputs<T>& in, Index eye) {
        using std::sqrt;
        const auto [first, n] = detail::eye_columns(in, eye);
        T most(0);
        for (Index i = first; i < first + n; ++i) {
            const Vec3<T> x(in.position(0, i), in.position(1, i), in.position(2, i));
            const T square = dot(x, x);
            most = most < square ? square : most;
        }
        const T unit = T(1) / sqrt(most);
        return positional_encoding(in.position.middleCols(first, n) * unit, frequencies);
    }

  private:
    template <class T>
    static VecX<T> turned(const Columns<T>& latent, const EyeInputs<T>& in, Index eye) {
        Columns<T> x = latent.col(eye);
        detail::rotate_triplets<T>(detail::gaze_rotation(in, eye), x);
        return x.col(0);
    }
};
static_assert(EyeAppearance<RotatedFeatures> && EyeAppearance<ConditionedFeatures> &&
              EyeAppearance<RotatedCode>);

} // namespace rye
