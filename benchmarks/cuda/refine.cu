// SPDX-License-Identifier: Apache-2.0
// refine: benchmarks/refine on this device: seconds to a frame's gazes and head pose by
// Gauss-Newton steps with derivatives by forward mode, and by Adam with gradients by reverse mode,
// which stay on the device but for the unknowns' ten. 100,000 points of the face and 4,096 of the
// eyes, pictures of 512 x 512.
#include <rye/backend/cuda/device.hpp>

#include <cstdio>

#include <rye/avatar/trained.hpp>
#include <rye/train/cuda/label_drawing.hpp>

#include "../refine/methods.hpp"
#include "subject.hpp"

namespace {

using namespace rye;
using namespace rye::bench;

using E = TrainedEffects;
using Of = DeviceSubject<E>;
using Policy = DeviceDrawingPolicy<DeviceNetworks<3>, KernelChannels<3>, Balanced, 3>;
using Task = LabelTask<Drivers<float, E>>;

/// Huber's slope of a colour's residual.
struct HuberSlope {
    static constexpr const char* name = "Huber's slope";
    const float *picture, *truth;
    float noise, huber, alike;
    float* to;
    RYE_DEVICE void operator()(Index i) const {
        const float scaled = (picture[i] - truth[i]) / noise;
        const float bent = scaled < -huber ? -huber : scaled > huber ? huber : scaled;
        to[i] = 2.0F * bent / (noise * alike);
    }
};
/// Adds a gradient of three channels to one of all.
struct AddGradient {
    static constexpr const char* name = "gradient of colours";
    DeviceGaussians<const float> from;
    DeviceGaussians<float> to;
    bool first;
    RYE_DEVICE void operator()(Index i) const {
        one(from.mean, to.mean, i), one(from.rotation, to.rotation, i);
        one(from.scale, to.scale, i), one(from.opacity, to.opacity, i);
        one(from.feature, to.feature, i);
    }
    RYE_DEVICE void one(const DeviceColumns<const float>& a, const DeviceColumns<float>& b,
                        Index i) const {
        for (Index k = 0; k < b.rows; ++k) {
            float& sum = b.data[b.rows * i + k];
            sum = (first ? 0.0F : sum) + (k < a.rows ? a.data[a.rows * i + k] : 0.0F);
        }
    }
};

/// The gradient of the cost by reverse mode.
class ReverseCost {
  public:
    ReverseCost(const CudaQueue& queue, const Of& of, const Task& task, double noise)
        : queue_(queue),
          of_(of),
          task_(task),
          avatar_(CudaDevice{}, queue, {of.avatar, of.config, of.roles}),
          gradient_(CudaDevice{}, queue, avatar_.layout()),
          noise_(static_cast<float>(noise)) {
        const Index pixels = task.views[0].truth.cols();
        numbers_.reserve(queue, static_cast<std::size_t>(10 * pixels) + 3);
        truth_.reserve(queue, task.views.size() * static_cast<std::size_t>(3 * pixels));
        for (std::size_t v = 0; v < task.views.size(); ++v)
            device_.send(queue, truth_.data() + Index(v) * 3 * pixels, task.views[v].truth.data(),
                         static_cast<std::size_t>(3 * pixels) * sizeof(float));
    }
    VecX<double> operator()(const Drivers<float, E>& at) {
        avatar_.set_drivers(queue_, at);
        do avatar_.drive_into(queue_);
        while (!avatar_.finish(queue_));
        const DeviceGaussians<float>& cloud = avatar_.cloud();
        const DeviceGaussians<float>& sum = avatar_.g_cloud(queue_);
        colours_.reserve(queue_, cloud.count(), 3);
        part_.reserve(queue_, cloud.count(), 3);
        launch_each(device_, queue_, cloud.count(),
                    rye::detail::KeepColours{cloud, colours_.view()});
        const Index pixels = task_.views[0].truth.cols();
        float* const picture = numbers_.data();
        float* const slope = picture + 6 * pixels;
        float* const white = picture + 10 * pixels;
        device_.send(queue_, white, task_.views[0].background.data(), 3 * sizeof(float));
        const RefineSettings settings;
        for (std::size_t v = 0; v < task_.views.size(); ++v) {
            const DeviceImages images{{picture, 3, pixels}, {picture + 3 * pixels, 1, pixels}};
            do
                rasterizer_.forward_into(queue_, colours_.view(), task_.views[v].camera, white,
                                         images, frame_);
            while (!frame_.finish(queue_));
            launch_each(device_, queue_, 3 * pixels,
                        HuberSlope{picture, truth_.data() + Index(v) * 3 * pixels, noise_,
                                   static_cast<float>(settings.huber),
                                   static_cast<float>(settings.alike), slope});
            rasterizer_.vjp_into(queue_, colours_.view(), task_.views[v].camera, white,
                                 {DeviceColumns<const float>{slope, 3, pixels}}, part_.view(),
                                 frame_);
            launch_each(device_, queue_, cloud.count(), AddGradient{part_.view(), sum, v == 0});
        }
        gradient_.clear(queue_);
        avatar_.vjp_into(queue_, gradient_);
        Columns<float> kappa(2, 2);
        Vec<float, 6> pose;
        device_.fetch(queue_, kappa.data(), gradient_.of(avatar_.shapes().eyes.kappa).data,
                      4 * sizeof(float));
        device_.fetch(queue_, pose.data(), avatar_.g_pose(), 6 * sizeof(float));
        VecX<double> all(10); // a kappa is added to the angles of its eye's gaze
        all << kappa.reshaped().cast<double>(), pose.cast<double>();
        return all;
    }

  private:
    CudaDevice device_;
    CudaQueue queue_;
    const Of& of_;
    const Task& task_;
    DeviceTwoStream<E, CudaDevice, Policy::Networks> avatar_;
    Resident<TwoStream<float, E>, CudaDevice> gradient_;
    float noise_;
    DeviceRasterizer<Policy::Accuracy, CudaDevice, Policy::Channels> rasterizer_;
    DeviceFrame<CudaDevice> frame_;
    rye::detail::DeviceCloudBuffer colours_, part_;
    DeviceBuffer<float> numbers_, truth_;
};

} // namespace

int main() {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
        std::puts("cuda_refine: skipped, no device is there");
        return 0;
    }
    try {
        cudaStream_t stream;
        check_cuda(cudaStreamCreate(&stream), "stream");
        StreamMemory memory;
        const CudaQueue queue{stream, memory};
        DeviceSubjectSizes sizes;
        sizes.config.expression = 64;
        Of of(sizes);
        of.avatar.eyes.kappa = Columns<float>::Zero(2, 2);
        DeviceLabelDrawing<E, CudaDevice, Policy> drawing(CudaDevice{}, queue,
                                                          {of.avatar, of.config, of.roles});
        Task task{of.drivers, {}};
        drawing.drive(task.truth);
        photograph(drawing, head(2000, 3).cameras.front(),
                   Vec3<float>(of.avatar.eyes.centre.rowwise().mean()), task);
        task.mislabel();
        std::printf("3 pictures of %d x %d pixels, 10 unknowns\n\n", task.views[0].camera.width,
                    task.views[0].camera.height);
        ReverseCost cost(queue, of, task, noise_at_labels(drawing, task));
        return compare_methods(Serial{}, drawing, cost, task, 400) ? 0 : 1;
    } catch (const std::exception& e) {
        std::printf("failed: %s\n", e.what());
        return 1;
    }
}
