// SPDX-License-Identifier: Apache-2.0
#include "importers/video_pictures.hpp"

#include <algorithm>
#include <cmath>

#include <rye/core/error.hpp>

#include "importers/face_geometry.hpp"
#include "importers/face_mesh.hpp"

namespace rye::trainer {
namespace {

/// Half the side of a head with its hair, over the longer side of its landmarks.
constexpr double half_head = 0.8;
constexpr int smallest_size = 64;
/// The mask's confidence that is outside and inside.
constexpr double outside = 0.3, inside = 0.7;

/// Means of the pixels of a picture that a square's pixels cover; 0 beyond the picture. `share`
/// becomes the covered share of each pixel, 0 to 1.
Image8 resampled(const Image8& from, const VideoSquare& square, std::vector<double>& share) {
    const int n = square.size, channels = from.channels;
    const double step = square.side / n;
    Image8 out{n, n, channels, {}};
    out.values.resize(static_cast<std::size_t>(n) * static_cast<std::size_t>(n) *
                      static_cast<std::size_t>(channels));
    share.assign(static_cast<std::size_t>(n) * static_cast<std::size_t>(n), 0);
    for (int y = 0; y < n; ++y)
        for (int x = 0; x < n; ++x) {
            const double left = square.left + x * step, top = square.top + y * step;
            const double right = left + step, bottom = top + step;
            std::array<double, 4> sum{};
            double area = 0;
            for (int v = std::max(0, static_cast<int>(std::floor(top)));
                 v < std::min(static_cast<double>(from.height), bottom); ++v)
                for (int u = std::max(0, static_cast<int>(std::floor(left)));
                     u < std::min(static_cast<double>(from.width), right); ++u) {
                    const double part = (std::min(right, u + 1.0) - std::max(left, double(u))) *
                                        (std::min(bottom, v + 1.0) - std::max(top, double(v)));
                    const std::size_t at =
                        (static_cast<std::size_t>(v) * static_cast<std::size_t>(from.width) +
                         static_cast<std::size_t>(u)) *
                        static_cast<std::size_t>(channels);
                    for (std::size_t c = 0; c < static_cast<std::size_t>(channels); ++c)
                        sum[c] += part * from.values[at + c];
                    area += part;
                }
            const std::size_t at =
                static_cast<std::size_t>(y) * static_cast<std::size_t>(n) + static_cast<std::size_t>(x);
            share[at] = area / (step * step);
            if (area <= 0) continue;
            for (std::size_t c = 0; c < static_cast<std::size_t>(channels); ++c)
                out.values[at * static_cast<std::size_t>(channels) + c] =
                    static_cast<std::uint8_t>(std::lround(sum[c] / area));
        }
    return out;
}

/// Returns the camera that sees the square of the picture.
Pinhole<double> camera_of(const Pinhole<double>& whole, const VideoSquare& square) {
    const double zoom = square.size / square.side;
    Pinhole<double> c = whole;
    c.fx *= zoom;
    c.fy *= zoom;
    c.cx = (c.cx - square.left) * zoom;
    c.cy = (c.cy - square.top) * zoom;
    c.width = c.height = square.size;
    return c;
}

/// Eye masks: the polygons of the lids where they were seen, as far away as the head has them, unless
/// the nose hides them.
Image8 eyes_of(const TrackedPicture& p, const VideoPose& pose, const Pinhole<double>& whole,
               const Pinhole<double>& camera) {
    constexpr std::uint8_t nose = 1;
    LabelledMesh mesh;
    std::vector<Vec3<double>> points;
    for (std::size_t e = 0; e < 2; ++e) {
        const auto first = static_cast<int>(points.size());
        Vec3<double> middle = Vec3<double>::Zero();
        double area = 0;
        for (std::size_t k = 0; k < 16; ++k) {
            const Index i = face_lids[e][k], next = face_lids[e][(k + 1) % 16];
            const Vec3<double> world = pose.landmarks.col(i);
            const double depth = whole.camera_from_world.apply(world).z();
            const Vec2<double> seen = p.landmarks.col(i).head<2>(),
                               then = p.landmarks.col(next).head<2>();
            const Vec3<double> at((seen.x() - whole.cx) / whole.fx * depth,
                                  (seen.y() - whole.cy) / whole.fy * depth, depth);
            points.push_back(whole.camera_from_world.inverse().apply(at));
            middle += points.back() / 16;
            area += 0.5 * (seen.x() * then.y() - seen.y() * then.x());
        }
        points.push_back(middle);
        if (area <= 0) continue; // seen from behind
        for (int k = 0; k < 16; ++k) {
            mesh.faces.push_back({first + 16, first + k, first + (k + 1) % 16});
            mesh.labels.push_back(eye_mask_value(static_cast<int>(e)));
        }
    }
    // Flanks of the nose, by iBUG's numbers.
    for (const Face& f : {Face{27, 28, 39}, Face{28, 29, 39}, Face{29, 31, 39}, Face{29, 30, 31},
                          Face{27, 28, 42}, Face{28, 29, 42}, Face{29, 35, 42}, Face{29, 30, 35}}) {
        Face moved = f;
        for (auto& corner : moved) {
            points.push_back(pose.landmarks.col(face_ibug[static_cast<std::size_t>(corner)]));
            corner = static_cast<int>(points.size()) - 1;
        }
        mesh.faces.push_back(moved);
        mesh.labels.push_back(nose);
    }
    mesh.vertices.resize(3, static_cast<Index>(points.size()));
    for (std::size_t i = 0; i < points.size(); ++i)
        mesh.vertices.col(static_cast<Index>(i)) = points[i];
    Image8 eyes = draw_labels(mesh, camera);
    for (std::uint8_t& value : eyes.values)
        if (value == nose || value == 255) value = 0;
    return eyes;
}

} // namespace

BelowNeck::BelowNeck(const Rigid<double>& world_from_head, const Vec3<double>& chin,
                     const Pinhole<double>& camera)
    : from_head_(world_from_head), camera_(camera) {
    constexpr double neck_below_chin = 0.3; // [dm]
    height_ = from_head_.inverse().apply(chin).y() - neck_below_chin;
    depth_ = camera.camera_from_world.apply(from_head_.translation).z();
}

bool BelowNeck::operator()(double u, double v) const {
    const Vec3<double> at((u - camera_.cx) / camera_.fx * depth_,
                          (v - camera_.cy) / camera_.fy * depth_, depth_);
    return from_head_.inverse().apply(camera_.camera_from_world.inverse().apply(at)).y() < height_;
}

VideoSquare square_of(const Tracks& tracks, const std::vector<int>& pictures, int size) {
    Vec2<double> low = Vec2<double>::Constant(1e9), high = -low;
    for (const int i : pictures) {
        const auto face = tracks.pictures[static_cast<std::size_t>(i)].landmarks.topRows<2>();
        const Vec2<double> a = face.rowwise().minCoeff(), b = face.rowwise().maxCoeff();
        const Vec2<double> reach = Vec2<double>::Constant(half_head * (b - a).maxCoeff());
        low = low.cwiseMin(Vec2<double>(0.5 * (a + b) - reach));
        high = high.cwiseMax(Vec2<double>(0.5 * (a + b) + reach));
    }
    VideoSquare s;
    s.side = std::ceil((high - low).maxCoeff());
    s.left = std::floor(0.5 * (low.x() + high.x() - s.side));
    s.top = std::floor(0.5 * (low.y() + high.y() - s.side));
    s.size = std::min(size, static_cast<int>(s.side)) / 2 * 2;
    require(s.size >= smallest_size, "rye import video", "the head has ", s.size,
            " pixels, expected ", smallest_size, " or more: film it from nearer");
    return s;
}

ImportView view_of(const Tracks& tracks, const VideoHead& head, const VideoPose& pose,
                   const VideoSquare& square) {
    const TrackedPicture& p = tracks.pictures[static_cast<std::size_t>(pose.picture)];
    const auto read = [&](const std::filesystem::path& file, int channels) {
        Image8 image = read_image8(file, channels);
        require(image.width == tracks.width && image.height == tracks.height, file.string(), "is ",
                image.width, " x ", image.height, " pixels, expected ", tracks.width, " x ",
                tracks.height, " as in tracks.jsonl");
        return image;
    };
    ImportView view;
    view.camera = "00";
    view.pinhole = camera_of(head.camera, square);
    std::vector<double> share;
    view.picture = resampled(read(p.picture, 3), square, share);
    view.mask = resampled(read(p.mask, 1), square, share);
    view.visible = plain_image(square.size, square.size, 255);
    const BelowNeck below(pose.world_from_head, pose.landmarks.col(face_ibug[ibug_chin]), view.pinhole);
    for (std::size_t i = 0; i < view.mask.values.size(); ++i) {
        const double u = static_cast<double>(i % static_cast<std::size_t>(square.size)) + 0.5,
                     v = static_cast<double>(i / static_cast<std::size_t>(square.size)) + 0.5;
        const bool shown = share[i] > 0.999 && !below(u, v);
        const double sure = (view.mask.values[i] / 255.0 - outside) / (inside - outside);
        view.mask.values[i] = static_cast<std::uint8_t>(
            std::lround(shown ? 255 * std::clamp(sure, 0.0, 1.0) : 0));
        if (!shown) view.visible.values[i] = 0;
    }
    view.eyes = eyes_of(p, pose, head.camera, view.pinhole);
    clip_to_mask(view.eyes, view.mask);
    return view;
}

} // namespace rye::trainer
