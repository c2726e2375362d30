// SPDX-License-Identifier: Apache-2.0
#include "importers/colmap_model.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <optional>
#include <string_view>

#include <rye/core/error.hpp>
#include <rye/core/memory.hpp>
#include <rye/core/parse.hpp>
#include <rye/math/rotation.hpp>

#include "data/memory_limit.hpp"
#include "data/picture.hpp"

namespace rye::trainer {
namespace {

struct Model {
    int id;
    const char* name;
    std::size_t parameters;
};
/// Camera models; those that a BrownConrady lens covers come first.
constexpr std::array models{Model{0, "SIMPLE_PINHOLE", 3},
                            Model{1, "PINHOLE", 4},
                            Model{2, "SIMPLE_RADIAL", 4},
                            Model{3, "RADIAL", 5},
                            Model{4, "OPENCV", 8},
                            Model{5, "OPENCV_FISHEYE", 8},
                            Model{6, "FULL_OPENCV", 12},
                            Model{7, "FOV", 5},
                            Model{8, "SIMPLE_RADIAL_FISHEYE", 4},
                            Model{9, "RADIAL_FISHEYE", 5},
                            Model{10, "THIN_PRISM_FISHEYE", 12}};

void require_known(bool known, const std::string& model, const std::string& who) {
    require(known, who + ": model", "got ", model,
            ", expected SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL or OPENCV: "
            "`colmap image_undistorter` makes pinhole pictures of others");
}

/// Returns the camera for COLMAP's parameters.
Photograph camera_of(const Model& model, ImageSize size, const std::vector<double>& p,
                     const std::string& who) {
    require_known(model.id <= 4, model.name, who);
    for (std::size_t i = 0; i < p.size(); ++i)
        require(
            std::isfinite(p[i]), who + ": params", "number ", i, " is ",
            [&] { return std::to_string(p[i]); }, ", expected a finite number");
    const bool one_focal = model.id == 0 || model.id == 2 || model.id == 3;
    const std::size_t at = one_focal ? 1 : 2;
    Photograph photo;
    photo.camera.fx = p[0];
    photo.camera.fy = p[at - 1];
    photo.camera.cx = p[at];
    photo.camera.cy = p[at + 1];
    photo.camera.width = size.width;
    photo.camera.height = size.height;
    require(
        p[0] > 0 && p[at - 1] > 0, who + ": params", "got focal lengths ",
        [&] { return std::to_string(p[0]); }, " and ", [&] { return std::to_string(p[at - 1]); },
        ", expected > 0 [px]");
    const auto k = [&](std::size_t i) { return p.size() > at + 2 + i ? p[at + 2 + i] : 0.0; };
    photo.lens = {k(0), k(1), 0, k(2), k(3)};
    return photo;
}

ImageSize checked_size(double w, double h, const std::string& who) {
    require(w >= 1 && h >= 1 && w <= max_image_edge && h <= max_image_edge, who, "got ", w, " x ",
            h, " pixels, expected 1 to ", max_image_edge);
    return {static_cast<int>(w), static_cast<int>(h)};
}

Rigid<double> pose_of(const std::array<double, 7>& v, const std::string& who) {
    for (std::size_t i = 0; i < v.size(); ++i)
        require(
            std::isfinite(v[i]), who + ": pose", "number ", i, " is ",
            [&] { return std::to_string(v[i]); }, ", expected a finite number");
    const Quat<double> q(v[0], v[1], v[2], v[3]);
    require(
        std::abs(q.norm() - 1) < 1e-3, who + ": pose", "got a quaternion of length ",
        [&] { return std::to_string(q.norm()); }, ", expected 1");
    Rigid<double> pose;
    pose.rotation = quat_matrix(quat_normalized(q));
    pose.translation = Vec3<double>(v[4], v[5], v[6]);
    return pose;
}

// ---- binary ------------------------------------------------------------------------------------

/// Reader of successive little-endian values.
class Reader {
  public:
    Reader(ByteSpan bytes, const std::string& who) : who_(who), bytes_(bytes) {}

    template <class T>
    T take(const char* what) {
        const ByteSpan part = slice(bytes_, at_, sizeof(T), who_, what);
        T value;
        std::memcpy(&value, part.data(), sizeof value);
        at_ += sizeof value;
        return value;
    }
    std::string name() {
        const std::string_view rest = as_text(bytes_).substr(at_);
        const std::size_t length = rest.find('\0');
        require(length != std::string_view::npos && length > 0 && length < 4096, who_,
                "the name of a picture does not end, expected a zero after it");
        at_ += length + 1;
        return std::string(rest.substr(0, length));
    }
    void skip(std::uint64_t count, std::uint64_t item, const char* what) {
        const std::uint64_t size = checked_product(count, item, who_);
        slice(bytes_, at_, size, who_, what);
        at_ += static_cast<std::size_t>(size);
    }
    /// Reads a number of records, each of at least `least` bytes.
    std::uint64_t count(std::uint64_t least, const char* what) {
        const auto n = take<std::uint64_t>(what);
        require(n <= (bytes_.size() - at_) / least, who_, what, ": got ", n, ", expected at most ",
                (bytes_.size() - at_) / least, " in a file of ", bytes_.size(), " bytes");
        return n;
    }
    const std::string& who() const { return who_; }

  private:
    std::string who_;
    ByteSpan bytes_;
    std::size_t at_ = 0;
};

ColmapCameras binary_cameras(ByteSpan bytes, const std::string& file) {
    Reader in(bytes, file);
    ColmapCameras cameras;
    const std::uint64_t n = in.count(24, "the number of cameras");
    for (std::uint64_t i = 0; i < n; ++i) {
        const auto id = in.take<std::uint32_t>("a camera");
        const std::string who = in.who() + ": camera " + std::to_string(id);
        const auto number = in.take<std::int32_t>("a camera's model");
        require_known(number >= 0 && number < static_cast<int>(models.size()),
                      std::to_string(number), who);
        const Model& model = models[static_cast<std::size_t>(number)];
        const auto w = in.take<std::uint64_t>("a camera's width");
        const auto h = in.take<std::uint64_t>("a camera's height");
        std::vector<double> p(model.parameters);
        for (double& x : p) x = in.take<double>("a camera's parameters");
        const ImageSize size = checked_size(static_cast<double>(w), static_cast<double>(h), who);
        cameras[id] = camera_of(model, size, p, who);
    }
    return cameras;
}

std::vector<ColmapPicture> binary_pictures(ByteSpan bytes, const std::string& who) {
    Reader in(bytes, who);
    std::vector<ColmapPicture> pictures;
    const std::uint64_t n = in.count(73, "the number of pictures");
    for (std::uint64_t i = 0; i < n; ++i) {
        const auto id = in.take<std::uint32_t>("a picture");
        std::array<double, 7> v{};
        for (double& x : v) x = in.take<double>("a picture's pose");
        ColmapPicture p;
        p.camera = in.take<std::uint32_t>("a picture's camera");
        p.name = in.name();
        p.camera_from_world = pose_of(v, in.who() + ": image " + std::to_string(id));
        in.skip(in.take<std::uint64_t>("a picture's points"), 24, "a picture's points");
        pictures.push_back(std::move(p));
    }
    return pictures;
}

// ---- text --------------------------------------------------------------------------------------

struct Line {
    std::string who; ///< file and number of the line
    std::vector<std::string> words;
};

/// Returns the lines without comments; in images.txt every second one has points, and may be empty.
std::vector<Line> lines_of(ByteSpan bytes, const std::string& who) {
    constexpr std::string_view spaces = " \t\r\v\f";
    std::string_view rest = as_text(bytes);
    std::vector<Line> lines;
    std::uint64_t memory = 0; // of lists that have grown to twice their length
    for (int number = 1; !rest.empty(); ++number) {
        std::string_view text = rest.substr(0, rest.find('\n'));
        rest.remove_prefix(std::min(text.size() + 1, rest.size()));
        if (text.starts_with('#')) continue;
        Line line{who + ": line " + std::to_string(number), {}};
        memory += 2 * sizeof(Line) + line.who.size();
        require_memory(memory, memory_limit(), line.who, "the lines to here");
        for (;;) {
            text.remove_prefix(std::min(text.find_first_not_of(spaces), text.size()));
            if (text.empty()) break;
            const std::string_view word = text.substr(0, text.find_first_of(spaces));
            text.remove_prefix(word.size());
            memory += 2 * sizeof(std::string) + word.size();
            require_memory(memory, memory_limit(), line.who, "the lines to here");
            line.words.emplace_back(word);
        }
        lines.push_back(std::move(line));
    }
    return lines;
}

double number_of(const Line& line, std::size_t i, const char* field) {
    require(i < line.words.size(), line.who + ": " + field, "is missing");
    const std::optional<double> x = parse_double(line.words[i]);
    require(x.has_value() && std::isfinite(*x), line.who + ": " + field, "got '", line.words[i],
            "', expected a finite number");
    return *x;
}

std::uint32_t id_of(const Line& line, std::size_t i, const char* field) {
    const double x = number_of(line, i, field);
    require(x >= 0 && x < 4e9 && std::floor(x) == x, line.who + ": " + field, "got '",
            line.words[i], "', expected a whole number from 0 on");
    return static_cast<std::uint32_t>(x);
}

ColmapCameras text_cameras(ByteSpan bytes, const std::string& who) {
    ColmapCameras cameras;
    for (const Line& line : lines_of(bytes, who)) {
        if (line.words.empty()) continue;
        const std::uint32_t id = id_of(line, 0, "CAMERA_ID");
        const std::string name = line.words.size() > 1 ? line.words[1] : "";
        const auto* model = std::find_if(models.begin(), models.end(),
                                         [&](const Model& m) { return name == m.name; });
        require_known(model != models.end(), "'" + name + "'", line.who);
        require(line.words.size() == 4 + model->parameters, line.who + ": PARAMS", "got ",
                line.words.size() - std::min<std::size_t>(4, line.words.size()),
                " numbers, expected ", model->parameters, " of ", name);
        const ImageSize size =
            checked_size(number_of(line, 2, "WIDTH"), number_of(line, 3, "HEIGHT"), line.who);
        std::vector<double> p;
        for (std::size_t i = 4; i < line.words.size(); ++i)
            p.push_back(number_of(line, i, "PARAMS"));
        cameras[id] = camera_of(*model, size, p, line.who);
    }
    return cameras;
}

std::vector<ColmapPicture> text_pictures(ByteSpan bytes, const std::string& who) {
    const std::vector<Line> lines = lines_of(bytes, who);
    std::vector<ColmapPicture> pictures;
    for (std::size_t i = 0; i < lines.size(); i += 2) {
        const Line& line = lines[i];
        if (line.words.empty()) continue; // empty line at the end
        id_of(line, 0, "IMAGE_ID");
        std::array<double, 7> v{};
        constexpr std::array names{"QW", "QX", "QY", "QZ", "TX", "TY", "TZ"};
        for (std::size_t k = 0; k < 7; ++k) v[k] = number_of(line, 1 + k, names[k]);
        ColmapPicture p;
        p.camera = id_of(line, 8, "CAMERA_ID");
        require(line.words.size() > 9, line.who + ": NAME", "is missing");
        p.name = line.words[9];
        for (std::size_t k = 10; k < line.words.size(); ++k) p.name += " " + line.words[k];
        p.camera_from_world = pose_of(v, line.who);
        pictures.push_back(std::move(p));
    }
    return pictures;
}

} // namespace

ColmapCameras parse_colmap_cameras(ByteSpan bytes, ColmapFormat format, const std::string& who) {
    return format == ColmapFormat::binary ? binary_cameras(bytes, who) : text_cameras(bytes, who);
}

std::vector<ColmapPicture> parse_colmap_pictures(ByteSpan bytes, ColmapFormat format,
                                                 const std::string& who) {
    return format == ColmapFormat::binary ? binary_pictures(bytes, who) : text_pictures(bytes, who);
}

} // namespace rye::trainer
