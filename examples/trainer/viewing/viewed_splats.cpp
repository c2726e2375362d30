// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <chrono>
#include <cmath>

#include <rye/io/splats.hpp>
#include <rye/gaussian/activate.hpp>
#include <rye/geometry/check_camera.hpp>

#include "data/memory_limit.hpp"
#include "model/types.hpp"
#include "viewing/viewed.hpp"

namespace rye::trainer {
namespace {

using Clock = std::chrono::steady_clock;

/// Share of the means that lie within the radius of a scene.
constexpr double inside = 0.9;
constexpr float field = 0.6f; ///< of view [rad]
constexpr int side = 512;

/// Returns the value below which this share of a row's values lie.
float quantile(const Columns<float>& a, Index row, double share) {
    std::vector<float> values(static_cast<std::size_t>(a.cols()));
    for (Index i = 0; i < a.cols(); ++i) values[static_cast<std::size_t>(i)] = a(row, i);
    const auto at = values.begin() +
                    static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
    std::nth_element(values.begin(), at, values.end());
    return *at;
}

class ViewedSplats : public ViewedScene {
  public:
    ViewedSplats(std::string name, GaussianCloud<float> cloud)
        : name_(std::move(name)),
          cloud_(std::move(cloud)) {
        require(cloud_.count() > 0, name_, "has no Gaussians, expected at least one");
        for (Index k = 0; k < 3; ++k) middle_[k] = quantile(cloud_.mean, k, 0.5);
        Columns<float> apart(1, cloud_.count());
        for (Index i = 0; i < cloud_.count(); ++i)
            apart(0, i) = (cloud_.mean.col(i) - middle_).norm();
        radius_ = std::max(quantile(apart, 0, inside), 1e-6f);
        // From before an upright subject, whose up is -y and front -z.
        const float away = 1.2f * radius_ / std::tan(0.5f * field);
        camera_ = look_at<float>(Vec3<float>(middle_ - away * Vec3<float>::UnitZ()), middle_,
                                 Vec3<float>(0, -1, 0), field, {side, side});
    }

    nlohmann::json description() const override {
        const Pinhole<float>& c = camera_;
        std::vector<float> motion;
        for (Index row = 0; row < 3; ++row) {
            for (Index k = 0; k < 3; ++k) motion.push_back(c.camera_from_world.rotation(row, k));
            motion.push_back(c.camera_from_world.translation[row]);
        }
        motion.insert(motion.end(), {0, 0, 0, 1});
        const std::vector<float> none, four(4), six(6);
        return {{"still", true},
                {"name", name_},
                {"gaussians", cloud_.count()},
                {"names", std::vector<std::string>()},
                {"expression", none},
                {"low", none},
                {"high", none},
                {"gaze", four},
                {"gazeLow", four},
                {"gazeHigh", four},
                {"pose", six},
                {"scale", 1},
                {"eyes", six},
                {"head", {middle_[0], middle_[1], middle_[2]}},
                {"radius", radius_},
                {"motion", motion},
                {"lens", {c.fx, c.fy, c.cx, c.cy}},
                {"width", c.width},
                {"height", c.height}};
    }
    const std::vector<std::string>& accuracies() const override { return accuracies_; }
    const std::string& usual() const override { return accuracies_.front(); }
    ViewWish first() const override { return {{}, camera_, usual(), ""}; }

    ViewedPicture draw(const ViewWish& wish) override {
        check_camera("rye view", wish.camera);
        if (wish.accuracy == "3dgs") return drawn(Compatible3dgs{}, wish);
        if (wish.accuracy == "fast") return drawn(Fast{}, wish);
        if (wish.accuracy == "balanced") return drawn(Balanced{}, wish);
        require(wish.accuracy == "tight", "accuracy", "got ", wish.accuracy,
                ", expected 3dgs, fast, balanced or tight");
        return drawn(Tight{}, wish);
    }
    std::vector<ViewedPrice> prices(const ViewWish& wish) override {
        return prices_of(*this, wish, accuracies_);
    }

  private:
    template <AccuracyPolicy A>
    ViewedPicture drawn(A, const ViewWish& wish) const {
        const Clock::time_point begin = Clock::now();
        const Gaussians<float> g = activate(cloud_, wish.camera.centre());
        Rasterizer<FeaturesOnly<A>> rasterizer;
        rasterizer.accuracy.max_memory = memory_limit();
        const VecX<float> white = VecX<float>::Ones(3);
        ViewedPicture p;
        p.picture = rasterizer.forward(train_backend(), g, wish.camera, white).feature;
        p.ms = std::chrono::duration<double, std::milli>(Clock::now() - begin).count();
        p.gaussians = cloud_.count();
        p.pixels = static_cast<Index>(p.picture.width) * p.picture.height;
        return p;
    }

    std::string name_;
    GaussianCloud<float> cloud_;
    Vec3<float> middle_;
    float radius_ = 1;
    Pinhole<float> camera_;
    std::vector<std::string> accuracies_{"3dgs", "fast", "balanced", "tight"};
};

} // namespace

std::unique_ptr<ViewedScene> viewed_splats(const std::filesystem::path& file) {
    return std::make_unique<ViewedSplats>(file.filename().string(),
                                          read_splats<float>(file, memory_limit()));
}

} // namespace rye::trainer
