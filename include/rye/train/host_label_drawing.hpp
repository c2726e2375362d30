// SPDX-License-Identifier: Apache-2.0
/// rye/train/host_label_drawing.hpp: LabelDrawing by a backend of the host.
#pragma once

#include <functional>
#include <limits>
#include <string>
#include <vector>

#include <rye/interactive/drive_cache.hpp>
#include <rye/splat/jvp.hpp>
#include <rye/train/label_drawing.hpp>

namespace rye {

/// LabelDrawing by a backend: DriveCache recomputes only what a driver moves; pictures' derivatives
/// are by forward mode of the rasterizer.
template <Backend B, Real T, RefinedEffects E, AccuracyPolicy A = FeaturesOnly<Balanced>>
class HostLabelDrawing {
  public:
    using Number = T;
    using Labels = Drivers<T, E>;

    /// Keeps references: the avatar, which must not change, its configuration and roles must
    /// outlive the drawing.
    HostLabelDrawing(const B& backend, const TwoStream<T, E>& avatar,
                     std::reference_wrapper<const AvatarConfig> config,
                     std::reference_wrapper<const LandmarkRoles> roles,
                     const Rasterizer<A>& rasterizer = {})
        : backend_(backend),
          cache_(backend, avatar, config, roles),
          width_(config.get().expression),
          rasterizer_(rasterizer) {}

    Index expression_width() const { return width_; }

    void drive(const Labels& labels) { gaussians_ = colours(cache_.update(labels)); }
    void differentiate(const Labels& labels, const std::vector<Labels>& moved, double apart) {
        drive(labels);
        tangents_.clear();
        for (const Labels& m : moved) {
            tangents_.push_back(colours(cache_.update(m)));
            Gaussians<T>::fields([&](const std::string&, auto& to,
                                     const auto& from) { to = (to - from) * T(1 / apart); },
                                 tangents_.back(), gaussians_);
        }
    }
    const Columns<T>& picture(const LabelView<T>& view) {
        rasterizer_.forward_into(backend_, gaussians_, view.camera, VecX<T>(view.background),
                                 raster_, &scratch_);
        if (raster_.trace.non_finite > 0) // which would draw nothing
            raster_.feature.pixels.setConstant(std::numeric_limits<T>::quiet_NaN());
        return raster_.feature.pixels;
    }
    Columns<T> jacobian(const LabelView<T>& view, const std::vector<Index>& pixels) {
        Columns<T> j(3 * static_cast<Index>(pixels.size()), static_cast<Index>(tangents_.size()));
        const VecX<T> background = view.background;
        for (std::size_t k = 0; k < tangents_.size(); ++k) {
            const RasterTangents<T> direction{.gaussians = &tangents_[k], .camera = nullptr};
            rasterizer_.jvp_into(backend_, gaussians_, direction, view.camera, background, drawn_,
                                 &scratch_);
            for (std::size_t i = 0; i < pixels.size(); ++i)
                j.template block<3, 1>(3 * static_cast<Index>(i), static_cast<Index>(k)) =
                    drawn_.feature.col(pixels[i]);
        }
        return j;
    }
    Columns<double> sums(const LabelView<T>& view, const WeighedColours& colours) {
        const Columns<T> j = jacobian(view, colours.pixels);
        const Index n = j.cols();
        constexpr Index chunk = 1024; // pixels
        return sum_chunks(backend_.threads, colours.scale.cols(), chunk,
                          Columns<double>(Columns<double>::Zero(n + 1, n + 1)),
                          [&](Index b, Index e) -> Columns<double> {
                              Columns<double> rows(3 * (e - b), n + 1);
                              rows.leftCols(n) =
                                  j.middleRows(3 * b, 3 * (e - b)).template cast<double>();
                              const auto of = [&](const Columns<double>& all) {
                                  return all.middleCols(b, e - b).reshaped();
                              };
                              rows.leftCols(n).array().colwise() *= of(colours.scale).array();
                              rows.col(n) = of(colours.residual);
                              return rows.transpose() * rows;
                          });
    }

  private:
    /// Returns the Gaussians with their first three features.
    static Gaussians<T> colours(const Gaussians<T>& g) {
        Gaussians<T> c;
        c.mean = g.mean;
        c.rotation = g.rotation;
        c.scale = g.scale;
        c.opacity = g.opacity;
        c.feature = g.feature.topRows(3);
        return c;
    }

    B backend_;
    DriveCache<B, T, E> cache_;
    Index width_;
    Rasterizer<A> rasterizer_;
    Gaussians<T> gaussians_;             ///< of the labels, of 3 channels
    std::vector<Gaussians<T>> tangents_; ///< by unknown
    RasterJvp<T, A::outputs> drawn_;
    Raster<T, A::outputs> raster_;
    RasterScratch<T> scratch_;
};

} // namespace rye
