// SPDX-License-Identifier: Apache-2.0
#include "importers/face_geometry.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include <rye/backend/scalar.hpp>
#include <rye/core/error.hpp>
#include <rye/geometry/mesh_raster.hpp>

#include "data/capture.hpp"
#include "data/threads.hpp"

namespace rye::trainer {
namespace {

std::size_t pixel_of(const Image8& image, int x, int y) {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(image.width) +
           static_cast<std::size_t>(x);
}

/// Returns the corners of the hull of points, counter-clockwise with y down (Andrew's monotone
/// chain).
std::vector<Vec2<double>> convex_hull(const Columns<double>& points) {
    std::vector<Vec2<double>> p;
    for (Index i = 0; i < points.cols(); ++i) p.emplace_back(points(0, i), points(1, i));
    std::sort(p.begin(), p.end(), [](const Vec2<double>& a, const Vec2<double>& b) {
        return a.x() < b.x() || (a.x() == b.x() && a.y() < b.y());
    });
    const auto turn = [](const Vec2<double>& a, const Vec2<double>& b, const Vec2<double>& c) {
        return (b.x() - a.x()) * (c.y() - a.y()) - (b.y() - a.y()) * (c.x() - a.x());
    };
    std::vector<Vec2<double>> hull;
    for (int side = 0; side < 2; ++side) {
        const std::size_t begin = hull.size();
        for (const Vec2<double>& q : p) {
            while (hull.size() >= begin + 2 && turn(hull[hull.size() - 2], hull.back(), q) <= 0)
                hull.pop_back();
            hull.push_back(q);
        }
        if (!hull.empty()) hull.pop_back();
        std::reverse(p.begin(), p.end());
    }
    return hull;
}

} // namespace

Sphere fit_sphere(const Columns<double>& points) {
    // About the mean, so that the normal equations stay well-conditioned far from the origin.
    const Vec3<double> mean = points.rowwise().mean();
    Mat<double, 4, 4> a = Mat<double, 4, 4>::Zero();
    Vec<double, 4> b = Vec<double, 4>::Zero();
    for (Index i = 0; i < points.cols(); ++i) {
        const Vec3<double> x = points.col(i) - mean;
        Vec<double, 4> row;
        row << 2 * x, 1;
        a += row * row.transpose();
        b += x.squaredNorm() * row;
    }
    const Vec<double, 4> s = a.ldlt().solve(b);
    const Vec3<double> c = s.head<3>();
    Sphere sphere{c + mean, std::sqrt(std::max(0.0, s[3] + c.squaredNorm())), 0};
    for (Index i = 0; i < points.cols(); ++i) {
        const double off = (points.col(i) - sphere.centre).norm() - sphere.radius;
        sphere.error += off * off / static_cast<double>(points.cols());
    }
    sphere.error = std::sqrt(sphere.error);
    return sphere;
}

NearestPoint nearest_to_lines(const Columns<double>& origins, const Columns<double>& directions) {
    Mat3<double> a = Mat3<double>::Zero();
    Vec3<double> b = Vec3<double>::Zero();
    const auto across = [&](Index i) {
        const Vec3<double> d = directions.col(i);
        return Mat3<double>(Mat3<double>::Identity() - d * d.transpose());
    };
    for (Index i = 0; i < origins.cols(); ++i) {
        const Mat3<double> m = across(i);
        a += m;
        b += m * origins.col(i);
    }
    NearestPoint nearest{a.ldlt().solve(b), 0};
    for (Index i = 0; i < origins.cols(); ++i)
        nearest.error += (across(i) * (nearest.point - origins.col(i))).squaredNorm() /
                         static_cast<double>(origins.cols());
    nearest.error = std::sqrt(nearest.error);
    return nearest;
}

Image8 plain_image(int width, int height, std::uint8_t value) {
    const std::size_t count = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
    return {width, height, 1, std::vector<std::uint8_t>(count, value)};
}

Image8 draw_labels(const LabelledMesh& mesh, const Pinhole<double>& camera) {
    RYE_ASSERT(mesh.labels.size() == mesh.faces.size(), "draw_labels: not one label per face");
    MeshRasterSettings settings;
    settings.culling = Culling::none;
    settings.silhouette.max_faces = 0;
    const Columns<double> none(0, mesh.vertices.cols());
    const MeshRaster<double> raster = rasterize_mesh<double>(
        ScalarBackend{Serial{}}, {mesh.vertices, mesh.faces, none}, camera, settings);
    Image8 image = plain_image(camera.width, camera.height, 255);
    for (std::size_t i = 0; i < raster.face.size(); ++i)
        if (raster.face[i] >= 0)
            image.values[i] = mesh.labels[static_cast<std::size_t>(raster.face[i])];
    return image;
}

Image8 lid_eye_mask(const Columns<double>& landmarks, const Pinhole<double>& camera) {
    constexpr std::uint8_t nose = 1;
    LabelledMesh mesh;
    mesh.vertices = landmarks;
    for (int e = 0; e < 2; ++e) {
        // The lids are clockwise in the image of a camera that they face, counter-clockwise
        // otherwise.
        const std::array<int, 6> lids = eye_landmarks(e);
        double area = 0;
        bool in_front = true;
        std::array<Vec2<double>, 6> at;
        for (std::size_t k = 0; k < 6; ++k) {
            const Vec3<double> p = camera.project_point(landmarks.col(lids[k]));
            in_front = in_front && p.z() > 0;
            at[k] = p.head<2>();
        }
        for (std::size_t k = 0; k < 6; ++k) {
            const Vec2<double>&p = at[k], &q = at[(k + 1) % 6];
            area += 0.5 * (p.x() * q.y() - p.y() * q.x());
        }
        if (!in_front || area <= 0) continue;
        for (int k = 1; k + 1 < 6; ++k) {
            mesh.faces.push_back({lids[0], lids[static_cast<std::size_t>(k)],
                                  lids[static_cast<std::size_t>(k + 1)]});
            mesh.labels.push_back(eye_mask_value(e));
        }
    }
    // Flanks of the nose, between its ridge (27 to 30), its wings and the inner corners of the
    // eyes.
    for (const Face& f : {Face{27, 28, 39}, Face{28, 29, 39}, Face{29, 31, 39}, Face{29, 30, 31},
                          Face{27, 28, 42}, Face{28, 29, 42}, Face{29, 35, 42}, Face{29, 30, 35}}) {
        mesh.faces.push_back(f);
        mesh.labels.push_back(nose);
    }
    Image8 image = draw_labels(mesh, camera);
    for (std::uint8_t& value : image.values)
        if (value == nose || value == 255) value = 0;
    return image;
}

Image8 hull_mask(const Columns<double>& points, ImageSize size) {
    const std::vector<Vec2<double>> hull = convex_hull(points);
    Image8 image = plain_image(size.width, size.height, 0);
    if (hull.size() < 3) return image;
    for (int y = 0; y < size.height; ++y) {
        // Span of the hull in this row.
        double left = size.width, right = 0;
        const double row = y + 0.5;
        for (std::size_t i = 0; i < hull.size(); ++i) {
            const Vec2<double>&a = hull[i], &b = hull[(i + 1) % hull.size()];
            if ((a.y() <= row) == (b.y() <= row)) continue;
            const double x = a.x() + (b.x() - a.x()) * (row - a.y()) / (b.y() - a.y());
            left = std::min(left, x);
            right = std::max(right, x);
        }
        const int first = std::max(0, static_cast<int>(std::ceil(std::max(left, 0.0) - 0.5)));
        for (int x = first; x < size.width && x + 0.5 <= right; ++x)
            image.values[pixel_of(image, x, y)] = 255;
    }
    return image;
}

void clip_to_mask(Image8& eyes, const Image8& mask) {
    for (std::size_t i = 0; i < eyes.values.size() && i < mask.values.size(); ++i)
        if (mask.values[i] < 128) eyes.values[i] = 0;
}

Straightened straightened(const Image8& picture, const Pinhole<double>& camera,
                          const BrownConrady<double>& lens) {
    const int w = picture.width, h = picture.height, channels = picture.channels;
    Straightened out{{w, h, channels, std::vector<std::uint8_t>(picture.values.size())},
                     plain_image(w, h, 0)};
    const double fold = lens.fold();
    program_threads().run(h, [&](Index row) {
        const int y = static_cast<int>(row);
        for (int x = 0; x < w; ++x) {
            const Vec2<double> s((x + 0.5 - camera.cx) / camera.fx,
                                 (y + 0.5 - camera.cy) / camera.fy);
            const Distorted<double> bent = lens.distort(s);
            if (!within_lens(s, bent.slope, fold)) continue;
            const double u = camera.fx * bent.at[0] + camera.cx - 0.5,
                         v = camera.fy * bent.at[1] + camera.cy - 0.5;
            if (!(u >= -0.5 && v >= -0.5 && u <= w - 0.5 && v <= h - 0.5)) continue;
            const double cu = std::clamp(u, 0.0, w - 1.0), cv = std::clamp(v, 0.0, h - 1.0);
            const int x0 = std::min(static_cast<int>(cu), std::max(w - 2, 0)),
                      y0 = std::min(static_cast<int>(cv), std::max(h - 2, 0));
            const int x1 = std::min(x0 + 1, w - 1), y1 = std::min(y0 + 1, h - 1);
            const double ax = cu - x0, ay = cv - y0;
            for (int c = 0; c < channels; ++c) {
                const auto at = [&](int px, int py) {
                    return static_cast<double>(
                        picture
                            .values[pixel_of(picture, px, py) * static_cast<std::size_t>(channels) +
                                    static_cast<std::size_t>(c)]);
                };
                const double value = (1 - ay) * ((1 - ax) * at(x0, y0) + ax * at(x1, y0)) +
                                     ay * ((1 - ax) * at(x0, y1) + ax * at(x1, y1));
                out.picture.values[pixel_of(picture, x, y) * static_cast<std::size_t>(channels) +
                                   static_cast<std::size_t>(c)] =
                    static_cast<std::uint8_t>(std::lround(value));
            }
            out.visible.values[pixel_of(out.visible, x, y)] = 255;
        }
    });
    return out;
}

} // namespace rye::trainer
