// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/view_color.hpp: colours that depend on where a Gaussian is seen from
/// (avatar/view_color.hpp), over a driven cloud in device memory, and the vjp to coefficients,
/// means and the head's rotation.
#pragma once

#include <rye/avatar/cuda/gazed_face.hpp>
#include <rye/avatar/view_color.hpp>

namespace rye {

namespace detail {

/// Where a frame's camera and head lie in device memory.
template <EffectSet E>
struct DeviceSeenHead {
    const float* camera; ///< world, 3
    const DeviceFrameState* frame;

    RYE_DEVICE SeenHead<float> operator()() const {
        if constexpr (has_effect<E, HeadPose>)
            return {column3(camera, 0), frame->head.rotation};
        else
            return {column3(camera, 0), Mat3<float>::Identity()};
    }
};

/// Coefficients of a cloud, the face's Gaussians first.
template <class T>
struct CloudColors {
    T *face, *eyes;
    Index faces; ///< Gaussians of the face

    RYE_HD T* of(Index i, Index numbers) const {
        return i < faces ? face + numbers * i : eyes + numbers * (i - faces);
    }
};

/// Adds its colour to Gaussian i of a cloud.
template <EffectSet E, int degree>
struct ViewColorPoint {
    using Add = AddViewColor<float, degree>;
    static constexpr const char* name = Add::name;
    CloudColors<const float> colors;
    DeviceSeenHead<E> seen;
    const float* mean;            ///< 3 x all
    DeviceColumns<float> feature; ///< C x all
    float* plain;                 ///< their first three channels before, 3 x all
    bool fresh;                   ///< true to set `plain`, false to begin with it

    RYE_DEVICE void operator()(Index i) const {
        float* const own = feature.data + i * feature.rows;
        for (int c = 0; c < 3; ++c) {
            if (fresh)
                plain[3 * i + c] = own[c];
            else
                own[c] = plain[3 * i + c];
        }
        Add{nullptr, nullptr, mean, seen(), feature.rows, feature.data}.add(
            i, colors.of(i, Add::numbers));
    }
};

/// Keeps the colours of points whose features a gaze replaced, then of the eyes', before those by
/// the view.
struct KeepPlainColors {
    static constexpr const char* name = "colours before those by the view";
    GazedPoints points;
    Index faces;
    DeviceColumns<float> feature;
    float* plain;

    RYE_DEVICE void operator()(Index i) const {
        const Index places = points.count();
        const Index own = i < places ? points.at(i) : faces + i - places;
        if (own < 0) return;
        for (int c = 0; c < 3; ++c) plain[3 * own + c] = feature.data[own * feature.rows + c];
    }
};

/// Adds the cotangents of Gaussian i's mean and coefficients; sums that of the head's rotation.
template <EffectSet E, int degree>
struct ViewColorPointVjp {
    using Add = AddViewColorVjp<float, degree>;
    static constexpr const char* name = Add::name;
    static constexpr int sums = Add::sums;
    CloudColors<const float> colors;
    CloudColors<float> g_colors;
    DeviceSeenHead<E> seen;
    const float* mean;
    DeviceColumns<float> g_feature;
    float* g_mean;

    template <class Sums>
    RYE_DEVICE void operator()(Index i, Sums& sum) const {
        constexpr Index numbers = view_color_numbers(degree);
        Add{mean, seen(), g_feature.rows, g_feature.data, g_mean}.add(i, colors.of(i, numbers),
                                                                      g_colors.of(i, numbers), sum);
    }
};

} // namespace detail

/// Colours by the view of an avatar on a device. Without coefficients it launches and holds
/// nothing. E has ViewColor.
template <EffectSet E, class Device>
class DeviceViewColors {
  public:
    /// `host` must stay where it is; of `all` Gaussians the first `faces` are the face's. `seen`:
    /// where each frame's camera and head will lie. Throws an Error for another number of columns.
    DeviceViewColors(const Device& device, const CudaQueue& queue, const ViewColors<float>& host,
                     Index faces, Index all, const detail::DeviceSeenHead<E>& seen)
        : device_(device),
          host_(&host),
          faces_(faces),
          all_(all),
          seen_(seen),
          sums_(device) {
        if (!any()) return;
        require(host.face.cols() == faces && host.eyes.cols() == all - faces &&
                    host.eyes.rows() == host.face.rows(),
                "DeviceViewColors", "there are ", host.face.cols(), " and ", host.eyes.cols(),
                " columns of coefficients, expected ", faces, " and ", all - faces);
        plain_.reserve(queue, 3 * static_cast<std::size_t>(all) + 1);
        numbers_.reserve(queue, 9);
    }

    bool any() const { return host_->any(); }

    /// Adds the colours of a driven cloud.
    template <class Of>
    void color_into(const CudaQueue& queue, const Of& of, const DeviceGaussians<float>& cloud) {
        add(queue, of, cloud, true);
    }
    /// The same of a cloud where a gaze replaced the features of these points and of the eyes;
    /// all others still have what the last call gave.
    template <class Of>
    void color_again(const CudaQueue& queue, const Of& of, const DeviceGaussians<float>& cloud,
                     const detail::GazedPoints& points) {
        if (!any()) return;
        launch_each(device_, queue, points.count() + all_ - faces_,
                    detail::KeepPlainColors{points, faces_, cloud.feature, plain_.data()});
        add(queue, of, cloud, false);
    }
    /// Adds the gradients of the coefficients to `to` and those of the means to `g`, given those of
    /// its features.
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of& of, const To& to,
                  const DeviceGaussians<float>& cloud, const DeviceGaussians<float>& g) {
        if (!any()) return;
        detail::with_view_degree(host_->face.rows(), [&](auto degree) {
            sums_.launch(queue, all_,
                         detail::ViewColorPointVjp<E, degree()>{
                             colors(of),
                             {to(host_->face).data, to(host_->eyes).data, faces_},
                             seen_,
                             cloud.mean.data,
                             g.feature,
                             g.mean.data},
                         {numbers_.data()});
        });
    }
    /// The cotangent of the head's rotation after vjp_into, 9 numbers; null without coefficients.
    const float* g_rotation() const { return any() ? numbers_.data() : nullptr; }
    /// Memory that is held [bytes].
    std::size_t bytes() const { return plain_.bytes() + numbers_.bytes() + sums_.bytes(); }

  private:
    template <class Of>
    detail::CloudColors<const float> colors(const Of& of) const {
        return {of(host_->face).data, of(host_->eyes).data, faces_};
    }
    template <class Of>
    void add(const CudaQueue& queue, const Of& of, const DeviceGaussians<float>& cloud,
             bool fresh) {
        if (!any()) return;
        detail::with_view_degree(host_->face.rows(), [&](auto degree) {
            launch_each(device_, queue, all_,
                        detail::ViewColorPoint<E, degree()>{colors(of), seen_, cloud.mean.data,
                                                            cloud.feature, plain_.data(), fresh});
        });
    }

    Device device_;
    const ViewColors<float>* host_;
    Index faces_, all_;
    detail::DeviceSeenHead<E> seen_;
    DeviceSums<Device> sums_;
    DeviceBuffer<float> plain_, numbers_;
};

} // namespace rye
