// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <chrono>
#include <optional>

#include <rye/avatar/gaze_at.hpp>
#include <rye/avatar/idle_head.hpp>
#include <rye/io/avatar_file.hpp>
#include <rye/interactive/player.hpp>
#include <rye/rig/gaze.hpp>

#include "drawing/playable.hpp"
#include "drawing/variant_list.hpp"
#include "drawing/variants.hpp"
#include "viewing/viewed.hpp"

namespace rye::trainer {
namespace {

using Clock = std::chrono::steady_clock;

double ms_since(Clock::time_point begin) {
    return std::chrono::duration<double, std::milli>(Clock::now() - begin).count();
}

/// Player of one accuracy.
class Player {
  public:
    virtual ~Player() = default;
    virtual ViewedPicture draw(const ViewWish& wish, const VecX<float>& background) = 0;
};

template <AccuracyPolicy A>
class PlayerOf : public Player {
  public:
    explicit PlayerOf(const PlayableAvatar<float>& playable) : player_(train_backend(), playable) {}
    ViewedPicture draw(const ViewWish& wish, const VecX<float>& background) override {
        const Clock::time_point begin = Clock::now();
        const Image<float>& picture = player_.draw(wish.drivers, wish.camera, background);
        const double ms = ms_since(begin);
        return {picture, ms, player_.work().gaussians, player_.work().pixels};
    }

  private:
    AvatarPlayer<TrainBackend, float, FeaturesOnly<A>> player_;
};

template <class T>
std::vector<double> list_of(const T& values) {
    std::vector<double> list;
    for (Index i = 0; i < values.size(); ++i) list.push_back(static_cast<double>(values.data()[i]));
    return list;
}

/// A head: of an .avatar file, or of a run, whose state also draws other variants and on a device.
class ViewedHead : public ViewedScene {
  public:
    explicit ViewedHead(PlayableAvatar<float> playable)
        : playable_(std::move(playable)),
          size_(box_middle(playable_.avatar.face.position), playable_.neutral, playable_.camera) {}
    ViewedHead(PlayableAvatar<float> playable, TrainState state, DeviceWish wish)
        : ViewedHead(std::move(playable)) {
        state_ = std::move(state);
        AvatarDrawer drawer(*state_, wish);
        if (!drawer.on_device()) return;
        device_.emplace(drawer);
        accuracies_.insert(accuracies_.begin(), "device");
        usual_ = "device";
    }

    nlohmann::json description() const override {
        const HeadPlace<float> place = head_place(playable_);
        const Drivers<float>& d = playable_.neutral;
        const Pinhole<float>& c = playable_.camera;
        std::vector<double> gaze, motion;
        for (const Vec3<float>& g : d.gaze)
            for (const double angle : list_of(pitch_yaw(g))) gaze.push_back(angle);
        for (Index row = 0; row < 3; ++row) {
            for (Index k = 0; k < 3; ++k)
                motion.push_back(static_cast<double>(c.camera_from_world.rotation(row, k)));
            motion.push_back(static_cast<double>(c.camera_from_world.translation[row]));
        }
        motion.insert(motion.end(), {0, 0, 0, 1});
        return {{"name", playable_.name},
                {"gaussians",
                 playable_.avatar.face.position.cols() + playable_.avatar.eyes.position.cols()},
                {"names", playable_.expression_names},
                {"expression", list_of(d.expression)},
                {"low", list_of(playable_.ranges.expression_low)},
                {"high", list_of(playable_.ranges.expression_high)},
                {"gaze", gaze},
                {"gazeLow", list_of(playable_.ranges.gaze_low)},
                {"gazeHigh", list_of(playable_.ranges.gaze_high)},
                {"pose", list_of(d.pose)},
                {"scale", d.scale},
                {"eyes", list_of(playable_.avatar.eyes.centre)},
                {"head", list_of(place.middle)},
                {"radius", place.radius},
                {"motion", motion},
                {"lens", {c.fx, c.fy, c.cx, c.cy}},
                {"width", c.width},
                {"height", c.height}};
    }
    const std::vector<std::string>& accuracies() const override { return accuracies_; }
    const std::string& usual() const override { return usual_; }
    std::vector<std::string> effects() const override {
        std::vector<std::string> names;
        if (!state_ || state_->compared) return names;
        for_variants([&]<class V>() { names.emplace_back(V::name); });
        return names;
    }
    ViewWish first() const override { return {playable_.neutral, playable_.camera, usual_, ""}; }

    void add_life(double seconds, Drivers<float>& d) override {
        constexpr double range = 0.5; // as the page has it
        if (!idle_) idle_.emplace(IdleSettings{}, 1, longest_life);
        add_idle(
            idle_->at(seconds),
            rye::lid_coefficients(playable_.expression_names, playable_.ranges.expression_high),
            range, d);
    }

    void look_to(const Vec3<float>& point, Drivers<float>& d) override {
        constexpr float range = 1.22F; // as the page has it
        const GazeTarget<float> target = target_in_head(head_placement(d), {point});
        const AimedEyes<float> aimed =
            gazes_at(train_backend(), playable_.avatar.eyes, playable_.config, d, target, range);
        for (std::size_t e = 0; e < 2; ++e) d.gaze[e] = aimed[e].visual;
    }

    ViewedPicture draw(const ViewWish& wish) override {
        const std::string who = "rye view";
        check_drivers(who, playable_.config, wish.drivers);
        check_camera(who, wish.camera);
        const DrawnFrame frame{wish.drivers, wish.camera,
                               size_.dilation(trained_dilation, wish.drivers, wish.camera)};
        if (!wish.effects.empty()) {
            if (!variant_ || wish.effects != effects_) {
                require(state_.has_value(), "effects", "got ", wish.effects,
                        ", but a file is drawn with all effects, expected the folder of a run");
                variant_.emplace(*state_, std::vector<DrawnFrame>{frame}, wish.effects, "effects",
                                 1.0 / 255);
                effects_ = wish.effects;
            }
            return whole([&] { return variant_->picture(frame); });
        }
        variant_.reset();
        if (wish.accuracy == "device" && device_)
            return whole([&] { return device_->picture(frame); });
        return player(wish.accuracy).draw(wish, playable_.background);
    }
    std::vector<ViewedPrice> prices(const ViewWish& wish) override {
        ViewWish all = wish;
        all.effects.clear();
        return prices_of(*this, all, accuracies_);
    }

  private:
    template <class F>
    static void for_variants(F&& f) {
        [&]<class... V>(Variants<V...>) { (f.template operator()<V>(), ...); }(AvatarVariants{});
    }
    template <class F>
    ViewedPicture whole(F&& picture) const {
        const Clock::time_point begin = Clock::now();
        ViewedPicture p{picture(), 0, 0, 0};
        p.ms = ms_since(begin);
        p.gaussians = playable_.avatar.face.position.cols() + playable_.avatar.eyes.position.cols();
        p.pixels = static_cast<Index>(p.picture.width) * p.picture.height;
        return p;
    }
    Player& player(const std::string& accuracy) {
        const auto of = [&]<class A>(std::size_t place, A) -> Player& {
            if (!players_[place]) players_[place] = std::make_unique<PlayerOf<A>>(playable_);
            return *players_[place];
        };
        if (accuracy == "fast") return of(0, Fast{});
        if (accuracy == "balanced") return of(1, Balanced{});
        require(accuracy == "tight", "accuracy", "got ", accuracy,
                ", expected fast, balanced or tight");
        return of(2, Tight{});
    }

    static constexpr double longest_life = 3600;

    PlayableAvatar<float> playable_;
    TrainedSize<float> size_;
    std::optional<IdleEyes> idle_;
    std::optional<TrainState> state_;
    std::optional<FrameDrawer> device_, variant_;
    std::string effects_; ///< of variant_
    std::array<std::unique_ptr<Player>, 3> players_;
    std::vector<std::string> accuracies_{"fast", "balanced", "tight"};
    std::string usual_ = "balanced";
};

} // namespace

std::unique_ptr<ViewedScene> viewed_avatar(const std::filesystem::path& file) {
    return std::make_unique<ViewedHead>(read_avatar<float>(file));
}

std::unique_ptr<ViewedScene> viewed_run(TrainState state, const Capture& capture, int frame,
                                        int camera, DeviceWish wish) {
    PlayableAvatar<float> playable = playable_avatar(state, capture, frame, camera);
    return std::make_unique<ViewedHead>(std::move(playable), std::move(state), wish);
}

} // namespace rye::trainer
