// SPDX-License-Identifier: Apache-2.0
/// viewing/view_page.hpp: answers of `rye view` to its page: the page's files, the scene, its
/// pictures, and news of a training.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "viewing/loopback.hpp"
#include "viewing/viewed.hpp"

namespace rye::trainer {

/// A source of drivers beside the page. Changes drivers; returns false if it has nothing to say
/// now.
using LiveDriver = std::function<bool(Drivers<float>&)>;

class ViewPage {
  public:
    /// Shows a scene in the place of the one before; the page keeps its drivers and camera where
    /// both have the same description.
    void show(std::unique_ptr<ViewedScene> scene);
    /// Words on the picture, such as a training's losses; while there is no scene, why.
    void say(std::string words) { words_ = std::move(words); }
    void drive(LiveDriver live) { live_ = std::move(live); }
    bool has_scene() const { return scene_ != nullptr; }
    /// Returns the names of the head's coefficients, if they have any.
    std::vector<std::string> expression_names() const {
        return scene_->description().at("names").get<std::vector<std::string>>();
    }
    /// Returns the number of the head's coefficients.
    int expressions() const { return static_cast<int>(wish_.drivers.expression.size()); }

    /// Answers:
    ///   GET  "", style.css, camera.js, page.js   the page
    ///   GET  opened      the scene's description, or {"waiting": words}
    ///   POST draw        {gaze, expression, pose, motion, width, height, accuracy, effects, idle},
    ///   each
    ///                    optional: the picture as JPEG; times and work in the header X-Rye. idle:
    ///                    seconds that the eyes have lived by themselves, in this picture alone
    ///   POST aim         {point, pose, expression}: {"aimed": angles [rad] at which the eyes of
    ///                    such a head look at a point of the world}
    ///   POST prices      what each accuracy costs in the last picture
    ///   GET  news        {scene, live, words}
    /// Throws an Error for fields of another kind or out of bounds.
    WebAnswer answer(const WebRequest& request);

  private:
    WebAnswer picture(const std::string& body);
    WebAnswer aimed(const std::string& body);
    ViewedScene& scene();

    std::unique_ptr<ViewedScene> scene_;
    ViewWish wish_;
    LiveDriver live_;
    std::string words_;
    int number_ = 0; ///< of the scene
};

} // namespace rye::trainer
