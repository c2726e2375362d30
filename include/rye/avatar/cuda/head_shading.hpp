// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/head_shading.hpp: lights that stay while the head turns
/// (avatar/head_shading.hpp) over a driven cloud in device memory, and the vjp to features, light,
/// normals and the head's rotation.
#pragma once

#include <cmath>
#include <string>

#include <rye/avatar/cuda/gazed_face.hpp>
#include <rye/avatar/head_shading.hpp>

namespace rye {

namespace detail {

/// Coefficients of one channel, as light.col(c) of the host's.
template <class T>
struct LightColumn {
    T* data; ///< 8
    RYE_HD T& operator()(int k) const { return data[k]; }
};

/// A frame's light in device memory.
struct DeviceLight {
    detail::LightChange<float> change;
    Vec3<float> eye_gain[2];
};

/// The gain of a normal in channel c.
RYE_HD inline float light_gain(const detail::LightChange<float>& change, int c,
                               const Vec3<float>& normal) {
    using std::exp;
    return exp(change.of[std::size_t(c)].at(normal));
}

} // namespace detail

/// The change of light in channel c, and the eyes' gains.
struct LightOfFrame {
    static constexpr const char* name = "light of a frame";
    const float* light;      ///< 8 x 3
    const float* eye_normal; ///< 3 x 2
    const detail::DeviceFrameState* frame;
    detail::DeviceLight* to;

    RYE_DEVICE void operator()(Index i) const {
        const int c = static_cast<int>(i);
        const Mat3<float> r = so3_exp(detail::column3(frame->pose.data(), 0));
        detail::turned_light(
            detail::log_light<float>(detail::LightColumn<const float>{light + 8 * c}), r,
            to->change.of[std::size_t(c)]);
        for (int eye = 0; eye < 2; ++eye)
            to->eye_gain[eye][c] =
                detail::light_gain(to->change, c, detail::column3(eye_normal, eye));
    }
};

namespace detail {

/// Multiplies the first three channels of Gaussian i.
struct ShadePoint {
    static constexpr const char* name = "shading";
    const float* normal; ///< 3 x N
    const DeviceLight* light;
    Index faces, left;            ///< Gaussians of the face, then of the left eye
    DeviceColumns<float> feature; ///< C x (N + P)

    RYE_HD float gain(Index i, int c) const {
        return i < faces ? light_gain(light->change, c, column3(normal, i))
                         : light->eye_gain[i < faces + left ? 0 : 1][c];
    }
    RYE_DEVICE void operator()(Index i) const {
        for (int c = 0; c < 3; ++c) feature.data[i * feature.rows + c] *= gain(i, c);
    }
};

/// The same of the points that gazes move, then of the eyes'.
struct ShadeGazedPoint {
    static constexpr const char* name = "shading by a gaze";
    GazedPoints points;
    ShadePoint shade;

    RYE_DEVICE void operator()(Index i) const {
        const Index places = points.count();
        const Index own = i < places ? points.at(i) : shade.faces + i - places;
        if (own >= 0) shade(own);
    }
};

/// Sums of a LogLight as a cotangent: its linear part, and the quadratic one, which is symmetric.
struct LightSums {
    static constexpr int each = 9;

    template <class Sums>
    RYE_HD static void add(const detail::LogLight<float>& g, int c, Sums& sum) {
        int at = each * c;
        for (int a = 0; a < 3; ++a) sum[std::size_t(at++)] += g.linear[a];
        for (int a = 0; a < 3; ++a)
            for (int b = a; b < 3; ++b) sum[std::size_t(at++)] += g.quadratic(a, b);
    }
    RYE_HD static detail::LogLight<float> of(const float* sum, int c) {
        detail::LogLight<float> g;
        int at = each * c;
        for (int a = 0; a < 3; ++a) g.linear[a] = sum[at++];
        for (int a = 0; a < 3; ++a)
            for (int b = a; b < 3; ++b) g.quadratic(a, b) = g.quadratic(b, a) = sum[at++];
        return g;
    }
};

/// Takes the cotangents of face point i to the colours before; adds its normal's; sums what the
/// light gets.
struct ShadeFaceVjp {
    static constexpr const char* name = "shading of the face, reverse";
    static constexpr int sums = 3 * LightSums::each;
    ShadePoint shade;       ///< its features as they were left
    DeviceColumns<float> g; ///< of the features, replaced
    float* g_normal;        ///< 3 x N, added to

    template <class Sums>
    RYE_DEVICE void operator()(Index i, Sums& sum) const {
        const Vec3<float> normal = column3(shade.normal, i);
        Vec3<float> own(0.0F, 0.0F, 0.0F);
        for (int c = 0; c < 3; ++c) {
            const Index at = i * g.rows + c;
            const float after = g.data[at], g_log = after * shade.feature.data[at];
            own += g_log * shade.light->change.of[std::size_t(c)].slope(normal);
            detail::LogLight<float> part;
            part.add(g_log, normal);
            LightSums::add(part, c, sum);
            g.data[at] = after * shade.gain(i, c);
        }
        add_column<3>(own, g_normal, i);
    }
};

/// The same of eye point i, of both eyes; sums the cotangents of the logarithms of their gains.
struct ShadeEyesVjp {
    static constexpr const char* name = "shading of the eyes, reverse";
    static constexpr int sums = 6;
    ShadePoint shade;
    DeviceColumns<float> g;

    template <class Sums>
    RYE_DEVICE void operator()(Index i, Sums& sum) const {
        const int eye = i < shade.left ? 0 : 1;
        for (int c = 0; c < 3; ++c) {
            const Index point = shade.faces + i, at = point * g.rows + c;
            const float after = g.data[at];
            sum[std::size_t(3 * eye + c)] += after * shade.feature.data[at];
            g.data[at] = after * shade.gain(point, c);
        }
    }
};

/// Gradients of light and of the eyes' normals, and the cotangent of the head's axis-angle.
struct LightVjpKernel {
    static constexpr const char* name = "light of a frame, reverse";
    static constexpr int threads = 32, blocks = 1;
    struct Shared {
        float g_r[3][9];
        float g_normal[2][3][3]; ///< of an eye, by a channel
    };
    LightOfFrame of;
    const float *face, *eyes;               ///< sums
    float *g_light, *g_eye_normal, *g_pose; ///< added to

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        block.each_thread([&](int t) {
            if (t < 3) channel(t, shared);
        });
        block.each_thread([&](int t) {
            if (t != 0) return;
            for (int eye = 0; eye < 2; ++eye) {
                Vec3<float> g(0.0F, 0.0F, 0.0F);
                for (int c = 0; c < 3; ++c) g += column3(shared.g_normal[eye][c], 0);
                add_column<3>(g, g_eye_normal, eye);
            }
            Mat3<float> g_r = Mat3<float>::Zero();
            for (int c = 0; c < 3; ++c)
                for (int k = 0; k < 9; ++k) g_r.data()[k] += shared.g_r[c][k];
            const Vec3<float> g = so3_exp_vjp(column3(of.frame->pose.data(), 0), g_r);
            for (int k = 0; k < 3; ++k) g_pose[k] += g[k];
        });
    }

  private:
    RYE_DEVICE void channel(int c, Shared& shared) const {
        detail::LogLight<float> sum = LightSums::of(face, c);
        for (int eye = 0; eye < 2; ++eye) {
            const Vec3<float> normal = column3(of.eye_normal, eye);
            const float g_log = eyes[3 * eye + c];
            put_column<3>(g_log * of.to->change.of[std::size_t(c)].slope(normal),
                          shared.g_normal[eye][c], 0);
            sum.add(g_log, normal);
        }
        const Mat3<float> g_r = detail::turned_light_vjp<float>(
            detail::log_light<float>(LightColumn<const float>{of.light + 8 * c}),
            so3_exp(column3(of.frame->pose.data(), 0)), sum, LightColumn<float>{g_light + 8 * c});
        for (int k = 0; k < 9; ++k) shared.g_r[c][k] = g_r.data()[k];
    }
};

/// A cloud as its shading reads it: Gaussians of the face, of the left eye, of all.
struct ShadedCounts {
    Index faces, left, all;
};

} // namespace detail

/// The shading of an avatar on a device. Without parameters it launches and holds nothing.
template <class Device>
class DeviceHeadShading {
  public:
    /// `host` must stay where it is. Throws an Error for another number of normals.
    DeviceHeadShading(const Device& device, const CudaQueue& queue, const Shading<float>& host,
                      const detail::ShadedCounts& counts)
        : device_(device),
          host_(&host),
          counts_(counts),
          sums_(device) {
        if (!host.any()) return;
        require(host.normal.cols() == counts.faces, "DeviceHeadShading", "there are ",
                host.normal.cols(), " normals, expected ", counts.faces);
        light_.reserve(queue, 1);
        numbers_.reserve(queue,
                         std::size_t(detail::ShadeFaceVjp::sums + detail::ShadeEyesVjp::sums));
    }

    /// Multiplies the features of the driven cloud, C x (N + P).
    template <class Of>
    void shade_into(const CudaQueue& queue, const Of& of, const detail::DeviceFrameState* frame,
                    const DeviceColumns<float>& feature) {
        if (!host_->any()) return;
        launch_each(device_, queue, 3, light_at(of, frame));
        launch_each(device_, queue, counts_.all, shade(of, feature));
    }
    /// The same of points whose features a gaze replaced, and of the eyes', by the light of the
    /// last shade_into, which no gaze changes.
    template <class Of>
    void shade_into(const CudaQueue& queue, const Of& of, const DeviceColumns<float>& feature,
                    const detail::GazedPoints& points) {
        if (!host_->any()) return;
        launch_each(device_, queue, points.count() + counts_.all - counts_.faces,
                    detail::ShadeGazedPoint{points, shade(of, feature)});
    }
    /// Features as shade_into left them, and their cotangents.
    struct Pass {
        const detail::DeviceFrameState* frame;
        DeviceColumns<float> feature, g; ///< g: replaced by that of the features before
        float* g_pose;                   ///< 3, added to
    };
    /// Adds the parameters' gradients and the cotangent of the head's axis-angle.
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of& of, const To& to, const Pass& pass) {
        if (!host_->any()) return;
        const detail::ShadePoint points = shade(of, pass.feature);
        float *const face = numbers_.data(), *const eyes = face + detail::ShadeFaceVjp::sums;
        sums_.launch(queue, counts_.faces,
                     detail::ShadeFaceVjp{points, pass.g, to(host_->normal).data}, {face});
        sums_.launch(queue, counts_.all - counts_.faces, detail::ShadeEyesVjp{points, pass.g},
                     {eyes});
        device_.launch(
            queue, 1,
            detail::LightVjpKernel{light_at(of, pass.frame), face, eyes, to(host_->light).data,
                                   to(host_->eye_normal).data, pass.g_pose});
    }
    /// Memory that is held [bytes].
    std::size_t bytes() const { return light_.bytes() + numbers_.bytes() + sums_.bytes(); }

  private:
    template <class Of>
    LightOfFrame light_at(const Of& of, const detail::DeviceFrameState* frame) const {
        return {of(host_->light).data, of(host_->eye_normal).data, frame, light_.data()};
    }
    template <class Of>
    detail::ShadePoint shade(const Of& of, const DeviceColumns<float>& feature) const {
        return {of(host_->normal).data, light_.data(), counts_.faces, counts_.left, feature};
    }

    Device device_;
    const Shading<float>* host_;
    detail::ShadedCounts counts_;
    DeviceSums<Device> sums_;
    DeviceBuffer<detail::DeviceLight> light_;
    DeviceBuffer<float> numbers_; ///< sums of the face, of the eyes
};

} // namespace rye
