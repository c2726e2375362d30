// SPDX-License-Identifier: Apache-2.0
#include "viewing/view_page.hpp"

#include <algorithm>
#include <cmath>

#include <rye/core/error.hpp>
#include <rye/rig/gaze.hpp>

#include "data/json_fields.hpp"
#include "data/picture_codecs.hpp"
#include "viewing/page_files.hpp"

namespace rye::trainer {
namespace {

constexpr int least_side = 16, most_side = 2048, jpeg_quality = 95;
constexpr double largest_number = 1e9, most_life = 3600;

/// Returns the numbers of a field, which has `count` of them; empty if there is no such field.
template <class T = float>
std::vector<T> numbers_of(const nlohmann::json& request, const char* key, Index count,
                          const std::string& who = "draw") {
    if (!request.contains(key)) return {};
    const nlohmann::json& list = json_list(request, key, who, "a list of numbers");
    const std::string field = who + ": " + key;
    require(list.size() == static_cast<std::size_t>(count), field, "got ", list.size(),
            " numbers, expected ", count);
    std::vector<T> numbers;
    for (const nlohmann::json& x : list) {
        numbers.push_back(static_cast<T>(json_number(x, field)));
        require(std::abs(static_cast<double>(numbers.back())) <= largest_number, field, "got ",
                numbers.back(), ", expected at most 1e9");
    }
    return numbers;
}

nlohmann::json object_of(const std::string& body, const std::string& who) {
    nlohmann::json request = parse_json_text(body, who);
    require(
        request.is_object(), who, "got ", [&] { return json_excerpt(request); },
        ", expected an object");
    return request;
}

int side_of(const nlohmann::json& request, const char* key, int otherwise) {
    const double x = json_number(request, key, otherwise, "draw");
    require(x >= least_side && x <= most_side && x == std::floor(x), std::string("draw: ") + key,
            "got ", x, ", expected ", least_side, " to ", most_side, " pixels");
    return static_cast<int>(x);
}

/// Changes a wish as a request asks.
void change(ViewWish& w, const nlohmann::json& request) {
    Drivers<float>& d = w.drivers;
    // In double, as of every other source: the same angles are the same bits.
    const std::vector<double> gaze = numbers_of<double>(request, "gaze", 4);
    const std::vector<float> pose = numbers_of(request, "pose", 6),
                             motion = numbers_of(request, "motion", 16),
                             expression = numbers_of(request, "expression", d.expression.size());
    if (!gaze.empty())
        for (std::size_t e = 0; e < 2; ++e) {
            for (std::size_t k = 0; k < 2; ++k)
                require(std::abs(gaze[2 * e + k]) <= 1.57, "draw: gaze", "got ", gaze[2 * e + k],
                        " rad, expected at most 1.57 either way");
            d.gaze[e] = gaze_vector(gaze[2 * e], gaze[2 * e + 1]).cast<float>();
        }
    if (!pose.empty()) d.pose = Eigen::Map<const Vec<float, 6>>(pose.data());
    if (!expression.empty())
        d.expression = Eigen::Map<const VecX<float>>(expression.data(), d.expression.size());
    Pinhole<float>& c = w.camera;
    if (!motion.empty())
        for (Index row = 0; row < 3; ++row) {
            for (Index k = 0; k < 3; ++k)
                c.camera_from_world.rotation(row, k) =
                    motion[static_cast<std::size_t>(4 * row + k)];
            c.camera_from_world.translation[row] = motion[static_cast<std::size_t>(4 * row + 3)];
        }
    const int width = side_of(request, "width", c.width),
              height = side_of(request, "height", c.height);
    const float x = static_cast<float>(width) / static_cast<float>(c.width),
                y = static_cast<float>(height) / static_cast<float>(c.height);
    c.fx *= x, c.cx *= x, c.fy *= y, c.cy *= y;
    c.width = width, c.height = height;
    w.accuracy = json_text(request, "accuracy", w.accuracy, "draw");
    w.effects = json_text(request, "effects", w.effects, "draw");
}

WebAnswer json_answer(const nlohmann::json& json) {
    return {200, "application/json", json.dump(), {}};
}

} // namespace

void ViewPage::show(std::unique_ptr<ViewedScene> scene) {
    const bool same =
        scene_ && scene_->description().at("names") == scene->description().at("names");
    scene_ = std::move(scene);
    if (!same) wish_ = scene_->first();
    ++number_;
}

ViewedScene& ViewPage::scene() {
    require(scene_ != nullptr, "rye view", words_.empty() ? "there is no picture yet" : words_);
    return *scene_;
}

WebAnswer ViewPage::picture(const std::string& body) {
    ViewedScene& shown = scene();
    const nlohmann::json request = object_of(body, "draw");
    ViewWish wish = wish_;
    change(wish, request);
    ViewWish moved = wish;
    const double life = json_number(request, "idle", -1, "draw");
    require(life <= most_life, "draw: idle", "got ", life, " s, expected at most ", most_life);
    if (live_)
        live_(moved.drivers);
    else if (life >= 0)
        shown.add_life(life, moved.drivers);
    const ViewedPicture p = shown.draw(moved);
    wish_ = wish; // what can be drawn is kept
    const Bytes jpeg = encode_jpeg(to_8bit(p.picture), jpeg_quality, "rye view");
    const nlohmann::json told{{"ms", p.ms},
                              {"work", {{"gaussians", p.gaussians}, {"pixels", p.pixels}}}};
    return {200, "image/jpeg", std::string(as_text(jpeg)), {{"X-Rye", told.dump()}}};
}

WebAnswer ViewPage::aimed(const std::string& body) {
    ViewedScene& shown = scene();
    const nlohmann::json request = object_of(body, "aim");
    const std::vector<float> point = numbers_of(request, "point", 3, "aim"),
                             pose = numbers_of(request, "pose", 6, "aim");
    require(!point.empty(), "aim: point", "got none, expected 3 numbers");
    Drivers<float> d = wish_.drivers;
    const std::vector<float> expression =
        numbers_of(request, "expression", d.expression.size(), "aim");
    if (!pose.empty()) d.pose = Eigen::Map<const Vec<float, 6>>(pose.data());
    if (!expression.empty())
        d.expression = Eigen::Map<const VecX<float>>(expression.data(), d.expression.size());
    shown.look_to(Vec3<float>(point[0], point[1], point[2]), d);
    nlohmann::json angles = nlohmann::json::array();
    for (const Vec3<float>& gaze : d.gaze) {
        const Vec2<float> a = pitch_yaw(gaze);
        require(std::isfinite(a[0]) && std::isfinite(a[1]), "aim: point",
                "got the middle of an eye, expected one outside of the eyes");
        angles.insert(angles.end(), {a[0], a[1]});
    }
    return json_answer({{"aimed", angles}});
}

WebAnswer ViewPage::answer(const WebRequest& r) {
    const std::pair<std::string_view, const char*> files[]{{"", "text/html"},
                                                           {"style.css", "text/css"},
                                                           {"camera.js", "text/javascript"},
                                                           {"page.js", "text/javascript"}};
    for (const auto& [name, type] : files) {
        if (r.path != name) continue;
        std::string text(page_file(name.empty() ? "index.html" : name));
        if (name == "page.js") text = std::string(page_file("view.js")) + text;
        return {200,
                std::string(type) + "; charset=utf-8",
                std::move(text),
                {{"Content-Security-Policy", "default-src 'self'; img-src 'self' data: blob:"}}};
    }
    if (r.path == "news") {
        Drivers<float> unused = wish_.drivers;
        return json_answer(
            {{"scene", number_}, {"live", live_ && scene_ && live_(unused)}, {"words", words_}});
    }
    if (r.path == "opened") {
        if (!scene_)
            return json_answer({{"scene", number_},
                                {"waiting", words_.empty() ? "there is no picture yet" : words_}});
        nlohmann::json opened = scene_->description();
        opened["scene"] = number_;
        opened["accuracies"] = scene_->accuracies();
        opened["accuracy"] = scene_->usual();
        opened["effects"] = scene_->effects();
        wish_ = scene_->first();
        return json_answer(opened);
    }
    if (r.path == "draw" && r.method == "POST") return picture(r.body);
    if (r.path == "aim" && r.method == "POST") return aimed(r.body);
    if (r.path == "prices" && r.method == "POST") {
        nlohmann::json list = nlohmann::json::array();
        ViewWish wish = wish_;
        if (live_) live_(wish.drivers);
        for (const ViewedPrice& p : scene().prices(wish))
            list.push_back(
                {{"accuracy", p.accuracy}, {"ms", p.ms}, {"most", p.most}, {"mean", p.mean}});
        return json_answer(list);
    }
    return {404, "text/plain; charset=utf-8", "nothing is here\n", {}};
}

} // namespace rye::trainer
