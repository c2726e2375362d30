// SPDX-License-Identifier: Apache-2.0
/// viewing/viewed.hpp: what `rye view` shows, drawn picture by picture as its page asks.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <rye/avatar/playable.hpp>

#include "data/json.hpp"
#include "device/choice.hpp"
#include "model/run.hpp"

namespace rye::trainer {

/// Picture that is wanted.
struct ViewWish {
    Drivers<float> drivers; ///< of a head
    Pinhole<float> camera;
    std::string accuracy; ///< one of ViewedScene::accuracies
    std::string effects;  ///< a variant's name, or effects; empty: all
};

/// Picture, and what it took.
struct ViewedPicture {
    Image<float> picture;
    double ms = 0;
    Index gaussians = 0; ///< that moved
    Index pixels = 0;    ///< that were computed
};

/// The price of an accuracy in the view of a wish.
struct ViewedPrice {
    std::string accuracy;
    double ms = 0;             ///< of a picture from a new camera, median of some
    double most = 0, mean = 0; ///< difference of a channel from the last accuracy of the list
};

class ViewedScene {
  public:
    virtual ~ViewedScene() = default;
    /// Returns what the page is told: the fields of worker.js' `opened`, and `still` for a scene
    /// without a head.
    virtual nlohmann::json description() const = 0;
    /// Names, the most accurate last.
    virtual const std::vector<std::string>& accuracies() const = 0;
    /// Accuracy that pictures have at first.
    virtual const std::string& usual() const = 0;
    /// Names of effects for a wish; empty if all are always drawn.
    virtual std::vector<std::string> effects() const { return {}; }
    /// Returns the wish of the first picture.
    virtual ViewWish first() const = 0;
    /// Moves the eyes as they live by themselves after so many seconds, 0 to 3600.
    virtual void add_life(double, Drivers<float>&) {}
    /// Turns both eyes to a point of the world.
    virtual void look_to(const Vec3<float>&, Drivers<float>&) {}
    /// Throws an Error for drivers, a camera or names that do not suit the scene.
    virtual ViewedPicture draw(const ViewWish& wish) = 0;
    virtual std::vector<ViewedPrice> prices(const ViewWish& wish) = 0;
};

/// Draws at each of these accuracies and compares the pictures.
std::vector<ViewedPrice> prices_of(ViewedScene& scene, ViewWish wish,
                                   const std::vector<std::string>& accuracies);

/// Returns a trained head, drawn on a device or the CPU, whose neutral drivers and first camera are
/// those of this frame and camera.
std::unique_ptr<ViewedScene> viewed_run(TrainState state, const Capture& capture, int frame,
                                        int camera, DeviceWish wish);
/// Returns the head of an .avatar file; throws an Error as read_avatar.
std::unique_ptr<ViewedScene> viewed_avatar(const std::filesystem::path& file);
/// Returns a splat file's Gaussians; throws an Error as read_splats, and if there are none.
std::unique_ptr<ViewedScene> viewed_splats(const std::filesystem::path& file);

} // namespace rye::trainer
