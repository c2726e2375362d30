// SPDX-License-Identifier: Apache-2.0
#include "data/corrected_cameras.hpp"

#include <span>

#include <nlohmann/json.hpp>

#include <rye/io/atomic_file.hpp>

#include "data/checksums.hpp"
#include "data/json_fields.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
using RowMajor = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;

/// Returns {"intrinsic": [fx, fy, cx, cy], "extrinsic": 12 numbers of 3 rows}.
Json json_of(const Pinhole<double>& c) {
    RowMajor extrinsic;
    extrinsic << c.camera_from_world.rotation, c.camera_from_world.translation;
    return {{"intrinsic", {c.fx, c.fy, c.cx, c.cy}},
            {"extrinsic", std::vector<double>(extrinsic.data(), extrinsic.data() + 12)}};
}

std::vector<double> numbers(const Json& object, const char* key, std::size_t count,
                            const std::string& who) {
    const std::string expected = "a list of " + std::to_string(count) + " numbers";
    const Json& list = json_list(object, key, who, expected.c_str());
    require(list.size() == count, who + ": " + key, "got ", list.size(), " values, expected ",
            expected);
    std::vector<double> all;
    for (const Json& x : list) all.push_back(json_number(x, who + ": " + key));
    return all;
}

Pinhole<double> camera_of(const Json& json, const std::string& who) {
    const std::vector<double> k = numbers(json, "intrinsic", 4, who),
                              m = numbers(json, "extrinsic", 12, who);
    require(k[0] > 0 && k[1] > 0, who + ": intrinsic", "got focal lengths ", k[0], " and ", k[1],
            ", expected > 0");
    const Eigen::Map<const RowMajor> extrinsic(m.data());
    Pinhole<double> c;
    c.fx = k[0], c.fy = k[1], c.cx = k[2], c.cy = k[3];
    c.camera_from_world.rotation = extrinsic.leftCols<3>();
    c.camera_from_world.translation = extrinsic.col(3);
    const Mat3<double>& r = c.camera_from_world.rotation;
    const double skewed = (r * r.transpose() - Mat3<double>::Identity()).cwiseAbs().maxCoeff();
    require(skewed < 1e-3, who + ": extrinsic",
            "its 3 x 3 part is no rotation: R R^T differs from the identity by ", skewed);
    return c;
}

} // namespace

bool same_numbers(const Pinhole<double>& a, const Pinhole<double>& b) {
    return a.fx == b.fx && a.fy == b.fy && a.cx == b.cx && a.cy == b.cy &&
           a.camera_from_world.rotation == b.camera_from_world.rotation &&
           a.camera_from_world.translation == b.camera_from_world.translation;
}

int take_corrected(Capture& capture, const std::vector<CorrectedCamera>& corrected) {
    const auto cameras = static_cast<std::size_t>(capture.camera_count());
    int taken = 0;
    for (const CorrectedCamera& c : corrected)
        for (std::size_t k = 0; k < cameras; ++k) {
            if (capture.camera_ids[k] != c.camera) continue;
            bool any = false;
            for (std::size_t v = k; v < capture.views.size(); v += cameras) {
                Pinhole<double>& camera = capture.views[v].camera;
                if (!capture.views[v].present || !same_numbers(camera, c.wrong)) continue;
                camera.fx = c.right.fx, camera.fy = c.right.fy;
                camera.cx = c.right.cx, camera.cy = c.right.cy;
                camera.camera_from_world = c.right.camera_from_world;
                any = true;
            }
            if (!any) continue;
            capture.corrected_cameras.push_back(c);
            ++taken;
        }
    return taken;
}

void save_corrected_cameras(const fs::path& run, const std::vector<CorrectedCamera>& corrected) {
    const fs::path path = corrected_cameras_path(run);
    if (corrected.empty()) {
        std::error_code ignored;
        fs::remove(path, ignored); // of an earlier run
        return;
    }
    Json cameras = Json::array();
    for (const CorrectedCamera& c : corrected)
        cameras.push_back(
            {{"camera", c.camera}, {"wrong", json_of(c.wrong)}, {"right", json_of(c.right)}});
    const std::string text = checked_text({{"cameras", cameras}}, 1);
    write_atomic(path, std::as_bytes(std::span(text)));
}

std::vector<CorrectedCamera> load_corrected_cameras(const fs::path& run) {
    const fs::path path = corrected_cameras_path(run);
    if (!fs::exists(path)) return {};
    return parse_corrected_cameras(as_text(read_file(path, max_json_bytes)), path.string());
}

std::vector<CorrectedCamera> parse_corrected_cameras(std::string_view text,
                                                     const std::string& who) {
    const Json json = parse_checked_json(text, who);
    std::vector<CorrectedCamera> all;
    for (const Json& c : json_list(json, "cameras", who, "a list of cameras")) {
        require(c.is_object(), who + ": cameras", "got ", [&] { return json_excerpt(c); },
                ", expected an object");
        const std::string name = json_text(c, "camera", "", who), of = who + ": camera " + name;
        for (const char* key : {"camera", "wrong", "right"})
            require(c.contains(key), of + ": " + key, "is missing");
        all.push_back({name, camera_of(c.at("wrong"), of + ": wrong"),
                       camera_of(c.at("right"), of + ": right")});
    }
    return all;
}

} // namespace rye::trainer
