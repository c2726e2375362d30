// SPDX-License-Identifier: Apache-2.0
/// rye/splat/rasterizer.hpp: Gaussians to images of features, alpha and depth, and back.
/// The derivative in a direction is `jvp` (splat/jvp.hpp). Results do not depend on the number of
/// threads: every (tile, Gaussian) pair owns its partial gradient, merged in the order of tiles.
/// A camera may have a lens that bends (geometry/distortion.hpp).
#pragma once

#include <cstdint>
#include <limits>
#include <string>
#include <type_traits>

#include <rye/backend/scalar.hpp>
#include <rye/splat/plain/kernels.hpp>

namespace rye {

// Defined in splat/jvp.hpp.
template <class T, Distortion D>
struct RasterTangents;
template <class T, Distortion D>
struct RasterJvpInput;
template <class T, Outputs O>
struct RasterJvp;

namespace detail {

template <class B, class T>
struct SplatJvp;

/// True for arguments of Rasterizer::forward among which one is missing: fewer than three, or a
/// backend and two more.
template <class... Arguments>
inline constexpr bool too_few_to_draw = sizeof...(Arguments) < 3;
template <Backend B, class Gaussians, class Camera>
inline constexpr bool too_few_to_draw<B, Gaussians, Camera> = true;

/// True for arguments whose camera and background have different scalars.
template <class... Arguments>
inline constexpr bool mixed_scalars = false;
template <class Gaussians, class T, class D, class U>
inline constexpr bool mixed_scalars<Gaussians, Pinhole<T, D>, VecX<U>> = !std::is_same_v<T, U>;
template <class B, class Gaussians, class T, class D, class U>
inline constexpr bool mixed_scalars<B, Gaussians, Pinhole<T, D>, VecX<U>> = !std::is_same_v<T, U>;

template <class T>
void take_column(const VecX<T>& column);
template <class Background>
concept IsColumn = requires(const Background& b) {
    take_column(b);
};

/// True for arguments whose background is no VecX: an expression, or a vector of fixed size.
template <class... Arguments>
inline constexpr bool background_is_no_column = false;
template <class Gaussians, class T, class D, class Background>
inline constexpr bool background_is_no_column<Gaussians, Pinhole<T, D>, Background> =
    !IsColumn<Background>;
template <class B, class Gaussians, class T, class D, class Background>
inline constexpr bool background_is_no_column<B, Gaussians, Pinhole<T, D>, Background> =
    !IsColumn<Background>;

/// True for arguments without a backend where there is no default one.
template <class... Arguments>
inline constexpr bool without_backend = false;
template <class Gaussians, class T, class D>
inline constexpr bool without_backend<Gaussians, Pinhole<T, D>, VecX<T>> =
    !Backend<DefaultBackend<T>>;

template <class... Arguments>
concept Undrawable = too_few_to_draw<Arguments...> || mixed_scalars<Arguments...> ||
    background_is_no_column<Arguments...> || without_backend<Arguments...>;

} // namespace detail

/// Draws Gaussians by the rules of A and differentiates the pictures, on any backend. The first
/// argument of each call is the backend. For backends with lanes include splat/lanes.hpp. With that
/// header, forward, forward_into and vjp may be called without a backend: on DefaultBackend, the
/// unit's best vectors and the default threads.
/// Gaussians are a GaussianView: a Gaussians<T> as it is, a range of its columns, or any memory.
template <AccuracyPolicy A = Balanced>
struct Rasterizer {
    A accuracy;

    /// Result type for scalars T.
    template <class T>
    using Drawn = Raster<T, A::outputs>;

    /// Returns the images of C channels, opacity and, by A::outputs, depth; `background` has C
    /// numbers. `scratch` keeps memory from call to call.
    template <Backend B, class T, Distortion D>
    Drawn<T> forward(const B& backend, const std::type_identity_t<GaussianView<T>>& g,
                     const Pinhole<T, D>& camera, const VecX<T>& background,
                     RasterScratch<T>* scratch = nullptr) const {
        Drawn<T> out;
        forward_into(backend, g, camera, background, out, scratch);
        return out;
    }

    /// Returns the same on the default backend.
    template <class T, Distortion D, Backend B = DefaultBackend<T>>
    Drawn<T> forward(const std::type_identity_t<GaussianView<T>>& g, const Pinhole<T, D>& camera,
                     const VecX<T>& background, RasterScratch<T>* scratch = nullptr) const {
        return forward(B{}, g, camera, background, scratch);
    }
    /// Does not compile: says what is wrong with a call's arguments.
    template <class... Arguments>
        requires detail::Undrawable<Arguments...>
    Drawn<float> forward(const Arguments&...) const {
        static_assert(!detail::too_few_to_draw<Arguments...>,
                      "Rasterizer::forward: an argument is missing, expected "
                      "([backend,] Gaussians, camera, background)");
        static_assert(!detail::mixed_scalars<Arguments...>,
                      "Rasterizer::forward: camera and background have different scalars");
        static_assert(!detail::background_is_no_column<Arguments...>,
                      "Rasterizer::forward: the background is no VecX, expected VecX<T>(...) "
                      "around an expression or a vector of fixed size");
        static_assert(!detail::without_backend<Arguments...>,
                      "Rasterizer::forward: there is no default Backend, expected ScalarBackend{} "
                      "as the first argument, or #include <rye/splat/lanes.hpp>");
        return {};
    }
    template <class T, Distortion D, Backend B = DefaultBackend<T>>
    void forward_into(const std::type_identity_t<GaussianView<T>>& g, const Pinhole<T, D>& camera,
                      const VecX<T>& background, Drawn<T>& out,
                      RasterScratch<T>* scratch = nullptr) const {
        forward_into(B{}, g, camera, background, out, scratch);
    }

    /// Does what forward does, into the memory of an earlier result.
    template <Backend B, class T, Distortion D>
    void forward_into(const B& backend, const std::type_identity_t<GaussianView<T>>& g,
                      const Pinhole<T, D>& camera, const VecX<T>& background, Drawn<T>& out,
                      RasterScratch<T>* scratch = nullptr) const {
        RasterScratch<T> own;
        RasterScratch<T>& s = scratch != nullptr ? *scratch : own;
        check(g, camera, background);
        project_into(backend, g, camera, s);
        bin_and_sort(backend, SplatInput<A, T, D>{g, camera, accuracy}, s, out.trace);
        shape_image(out.feature, camera, g.channels());
        shape_image(out.alpha, camera, 1);
        if constexpr (A::outputs.depth) shape_image(out.depth, camera, 1);
        if constexpr (A::outputs.contributor) {
            check_countable<T>(out.trace.lists);
            shape_image(out.contributor, camera, 1);
        }
        out.trace.used.resize(static_cast<std::size_t>(out.trace.lists.tiles()));
        blend_into(backend, scene_of(g, camera, background, out.trace),
                   detail::DrawnTiles().part(0, out.trace.lists.tiles()), out, s);
    }

    /// Does the first step of forward_into: candidate and state of every Gaussian.
    template <Backend B, class T, Distortion D>
    void project_into(const B& backend, const std::type_identity_t<GaussianView<T>>& g,
                      const Pinhole<T, D>& camera, RasterScratch<T>& s) const {
        s.shape(g.count());
        const SplatInput<A, T, D> in{g, camera, accuracy};
        for_chunks(backend.threads, g.count(), 256, [&](Index b, Index e, Index) {
            detail::SplatKernels<B, T>::project(in, {b, e}, s);
        });
    }

    /// Does the last step of forward_into: draws tiles. The other pixels stay.
    template <Backend B, class T>
    void blend_into(const B& backend, const Scene<T>& scene, const detail::DrawnTiles& drawn,
                    Drawn<T>& out, RasterScratch<T>& s) const {
        for_tiles(backend, drawn.end - drawn.begin, [&](Index b, Index e) {
            detail::SplatKernels<B, T>::blend(
                scene, accuracy, drawn.part(drawn.begin + b, drawn.begin + e), out, s.workspaces);
        });
    }

    template <class T, Distortion D>
    static Scene<T> scene_of(const std::type_identity_t<GaussianView<T>>& g,
                             const Pinhole<T, D>& camera, const VecX<T>& background,
                             const RasterTrace<T>& trace) {
        return {trace, g, background, camera.cx, camera.cy, camera.width, camera.height};
    }

    /// Returns the gradients of everything in `g` for the cotangents of the images: `g_feature`,
    /// C x pixels, and, unless null, `g_alpha` and `g_depth`, 1 x pixels. The background's is
    /// background_vjp. Arguments are those of the forward call that returned `raster`.
    template <Backend B, class T, Distortion D>
    Gaussians<T> vjp(const B& backend, const std::type_identity_t<GaussianView<T>>& g,
                     const Pinhole<T, D>& camera, const VecX<T>& background,
                     const Drawn<T>& raster, const Columns<T>& g_feature,
                     const std::type_identity_t<Columns<T>>* g_alpha = nullptr,
                     const std::type_identity_t<Columns<T>>* g_depth = nullptr,
                     RasterScratch<T>* scratch = nullptr) const {
        Gaussians<T> out(g.count(), g.channels());
        vjp_into(backend, g, camera, background, raster,
                 RasterCotangent<T>{g_feature, g_alpha, g_depth}, out, scratch);
        return out;
    }

    /// Returns the same on the default backend.
    template <class T, Distortion D, Backend B = DefaultBackend<T>>
    Gaussians<T> vjp(const std::type_identity_t<GaussianView<T>>& g, const Pinhole<T, D>& camera,
                     const VecX<T>& background, const Drawn<T>& raster,
                     const Columns<T>& g_feature) const {
        return vjp(B{}, g, camera, background, raster, g_feature);
    }

    /// Does what vjp does, into the memory of an earlier result.
    template <Backend B, class T, Distortion D>
    void vjp_into(const B& backend, const std::type_identity_t<GaussianView<T>>& g,
                  const Pinhole<T, D>& camera, const VecX<T>& background, const Drawn<T>& raster,
                  const RasterCotangent<T>& cotangent, Gaussians<T>& out,
                  RasterScratch<T>* scratch = nullptr) const {
        RasterScratch<T> own;
        RasterScratch<T>& s = scratch != nullptr ? *scratch : own;
        check(g, camera, background);
        check_cotangent(g, camera, cotangent);
        const RasterTrace<T>& trace = raster.trace;
        s.slots.shape(trace.lists.entries(), g.channels());
        const Scene<T> scene = scene_of(g, camera, background, trace);
        for_tiles(backend, trace.lists.tiles(), [&](Index b, Index e) {
            detail::SplatKernels<B, T>::blend_vjp(scene, accuracy, cotangent, {b, e}, s);
        });
        out.resize(g.count(), g.channels());
        const SplatInput<A, T, D> in{g, camera, accuracy};
        for_chunks(backend.threads, g.count(), 256, [&](Index b, Index e, Index) {
            detail::SplatKernels<B, T>::project_vjp(in, trace, {b, e}, s, out);
        });
    }

    /// Returns the render and its derivative in the direction of the tangents. Needs splat/jvp.hpp.
    template <Backend B, class T, Distortion D>
    RasterJvp<T, A::outputs> jvp(const B& backend, const std::type_identity_t<GaussianView<T>>& g,
                                 const RasterTangents<T, D>& tangents,
                                 const Pinhole<T, D>& camera, const VecX<T>& background) const {
        RasterJvp<T, A::outputs> out;
        jvp_into(backend, g, tangents, camera, background, out);
        return out;
    }

    /// Does what jvp does, into the memory of an earlier result.
    template <Backend B, class T, Distortion D>
    void jvp_into(const B& backend, const std::type_identity_t<GaussianView<T>>& g,
                  const RasterTangents<T, D>& tangents, const Pinhole<T, D>& camera,
                  const VecX<T>& background,
                  RasterJvp<T, A::outputs>& out, RasterScratch<T>* scratch = nullptr) const {
        RasterScratch<T> own;
        check(g, camera, background);
        detail::SplatJvp<B, T>::run(*this, backend,
                                    RasterJvpInput<T, D>{g, tangents, camera, background}, out,
                                    scratch != nullptr ? *scratch : own);
    }

  private:
    /// Calls f(begin, end) for runs of tiles.
    template <Backend B, class F>
    static void for_tiles(const B& backend, Index tiles, F&& f) {
        for_chunks(backend.threads, tiles, 1, [&](Index b, Index e, Index) { f(b, e); });
    }

    template <class T, Distortion D>
    void check(const GaussianView<T>& g, const Pinhole<T, D>& camera,
               const VecX<T>& background) const {
        static_assert(!D::distorts || A::order == BlendOrder::by_centre,
                      "rasterizer: blending by peak needs the straight rays of a pinhole");
        require(background.size() == g.channels(), "rasterizer", "got a background of ",
                background.size(), " channels, expected ", g.channels());
        require(camera.width >= 0 && camera.height >= 0, "rasterizer", "got an image of ",
                camera.width, " x ", camera.height, " pixels, expected no negative size");
        const std::int64_t pixels = static_cast<std::int64_t>(camera.width) * camera.height;
        require(pixels <= std::numeric_limits<Index>::max(), "rasterizer", "got an image of ",
                pixels, " pixels, expected at most ", std::numeric_limits<Index>::max());
        require(camera.near_depth > T(0), "rasterizer",
                "got a near depth that is not positive, expected a positive one");
        detail::check_alpha_min<real_t<T>>(accuracy);
        const std::int64_t count = g.count();  // Index may have 32 bits
        require(count < std::int64_t(no_member), "rasterizer", "got ", count,
                " Gaussians, expected fewer than 2^32 - 1");
    }

    template <class T, Distortion D>
    static void check_cotangent(const GaussianView<T>& g, const Pinhole<T, D>& camera,
                                const RasterCotangent<T>& c) {
        const Index pixels = static_cast<Index>(camera.width) * camera.height;
        const auto check_shape = [&](const char* name, const Columns<T>* a, Index rows) {
            if (a == nullptr) return;
            require(a->rows() == rows && a->cols() == pixels, "rasterizer", "cotangent of ", name,
                    " is ", a->rows(), " x ", a->cols(), ", image is ", rows, " x ", pixels);
        };
        if (!A::outputs.depth && c.depth != nullptr)
            throw Error("rasterizer: got a cotangent of depth, expected none: the policy's "
                        "outputs have no depth");
        check_shape("feature", &c.feature, g.channels());
        check_shape("alpha", c.alpha, 1);
        check_shape("depth", c.depth, 1);
    }

    /// Throws Error if a tile has more entries than T counts: until it is drawn, a contributor is
    /// an entry of its tile in a number of the pixels' type.
    template <class T>
    static void check_countable(const TileLists& lists) {
        constexpr std::int64_t most = std::int64_t(1) << std::numeric_limits<real_t<T>>::digits;
        for (std::size_t t = 0; t + 1 < lists.begin.size(); ++t)
            if (lists.begin[t + 1] - lists.begin[t] > most)
                throw Error("rasterizer: got " +
                            std::to_string(lists.begin[t + 1] - lists.begin[t]) +
                            " Gaussians in one tile, expected at most " + std::to_string(most) +
                            " where contributors are drawn");
    }

    template <class X, class T, Distortion D>
    static void shape_image(Image<X>& image, const Pinhole<T, D>& camera, Index channels) {
        image.width = camera.width;
        image.height = camera.height;
        image.pixels.resize(channels, image.size());
    }
};

/// Returns the gradient of the background: what reaches it, weighted by the transmittance.
template <class T, Outputs O>
VecX<T> background_vjp(const Raster<T, O>& raster, const Columns<T>& g_feature) {
    VecX<T> g = VecX<T>::Zero(g_feature.rows());
    for (Index p = 0; p < g_feature.cols(); ++p)
        for (Index c = 0; c < g.size(); ++c)
            g[c] += g_feature(c, p) * (T(1) - raster.alpha.pixels(0, p));
    return g;
}

} // namespace rye
