// SPDX-License-Identifier: Apache-2.0
#include "tiny_capture.hpp"

#include <cmath>
#include <cstdint>
#include <fstream>
#include <span>

#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/picture.hpp"

namespace rye::trainer {

TinyCapture::TinyCapture(const std::filesystem::path& where) : folder(where) {
    for (int f = 0; f < frames; ++f) write_frame(f);
}

Columns<double> TinyCapture::head_points() {
    Columns<double> p(3, 68);
    const auto arc = [&](int first, int n, double x0, double x1, auto&& yz) {
        for (int i = 0; i < n; ++i) {
            const double s = n == 1 ? 0 : static_cast<double>(i) / (n - 1);
            const Vec2<double> rest = yz(s);
            p.col(first + i) << x0 + s * (x1 - x0), rest[0], rest[1];
        }
    };
    const auto bow = [](double s) { return 4 * s * (1 - s); };
    arc(0, 17, -0.75, 0.75,
        [&](double s) { return Vec2<double>(0.3 - bow(s), 0.2 + 0.6 * bow(s)); });
    arc(17, 5, -0.6, -0.15, [&](double s) { return Vec2<double>(0.55, 1 + 0.05 * bow(s)); });
    arc(22, 5, 0.15, 0.6, [&](double s) { return Vec2<double>(0.55, 1 + 0.05 * bow(s)); });
    arc(27, 4, 0, 0, [](double s) { return Vec2<double>(0.35 - 0.35 * s, 1.05 + 0.25 * s); });
    arc(31, 5, -0.15, 0.15, [](double) { return Vec2<double>(-0.1, 1.15); });
    for (const int first : {36, 42}) {
        const double middle = first == 36 ? -0.32 : 0.32;
        arc(first, 4, middle - 0.14, middle + 0.14,
            [&](double s) { return Vec2<double>(0.33 + 0.06 * bow(s), 0.93); });
        arc(first + 4, 2, middle + 0.05, middle - 0.05,
            [](double) { return Vec2<double>(0.28, 0.93); });
    }
    arc(48, 12, -0.25, 0.25, [&](double s) { return Vec2<double>(-0.35 + 0.1 * bow(s), 1.1); });
    arc(60, 8, -0.2, 0.2, [&](double s) { return Vec2<double>(-0.35 - 0.1 * bow(s), 1.1); });
    return p;
}

Vec<double, 6> TinyCapture::pose(int f) {
    Vec<double, 6> p;
    p << 0.02 * f, 0.05 * f - 0.07, 0.01, 0.02 * f, -0.03, 0.01;
    return p;
}

Vec3<double> TinyCapture::to_world(int f, const Vec3<double>& head) {
    const Vec<double, 6> p = pose(f);
    return so3_exp(Vec3<double>(p.head<3>())) * head + p.tail<3>();
}

Pinhole<double> TinyCapture::pinhole(int c) {
    const double yaw = 0.5 * (c - 1);
    const Vec3<double> target(0, 0, 0.6), up(0, 1, 0);
    const Vec3<double> eye = target + 10 * gaze_vector(0.1, yaw);
    return look_at<double>(eye, target, up, 0.25, {size, size});
}

void TinyCapture::replace(const std::filesystem::path& file, const std::string& name,
                          const NpyArray& array) {
    NpzArrays arrays = read_npz(file);
    arrays[name] = array;
    write_npz(file, arrays);
}

void TinyCapture::edit_all(const std::string& file, const std::string& name,
                           const Edit& edit) const {
    for (int f = 0; f < frames; ++f) {
        if (file != "camera")
            edit_one(params(f, file), name, edit);
        else
            for (int c = 0; c < cameras; ++c) edit_one(camera_file(f, c), name, edit);
    }
}

void TinyCapture::edit_one(const std::filesystem::path& file, const std::string& name,
                           const Edit& edit) {
    const bool npz = file.extension() == ".npz";
    const NpyArray old = npz ? read_npz(file).at(name) : read_npy(file);
    std::vector<double> values = old.values<double>(name);
    edit(values);
    if (npz)
        set(file, name, old.shape, values);
    else
        write_npy(file, npy_array<double>(old.shape, values));
}

void TinyCapture::set_expressions() const {
    for (int f = 0; f < frames; ++f)
        set<float>(params(f, "params.npz"), "exp_coeff", {1, 3},
                   {0.2f * static_cast<float>(f), 0.5f, -0.1f});
}

void TinyCapture::write_text(const std::string& name, const std::string& text) const {
    std::ofstream(folder / name) << text;
}

void TinyCapture::write_frame(int f) const {
    const std::filesystem::path file = params(f, "params.npz");
    for (const char* part : {"images", "cameras", "params"})
        std::filesystem::create_directories(folder / part / frame(f));
    const Vec<double, 6> p = pose(f);
    const std::vector<float> weights{0.1f * static_cast<float>(f), 0.5f}, one{1};
    write_npz(file, {{"pose", npy_array<double>({1, 6}, std::span(p.data(), 6))},
                     {"exp_coeff", npy_array<float>({1, 2}, weights)},
                     {"scale", npy_array<float>({1, 1}, one)}});
    const Columns<double> head = head_points();
    Columns<double> world(3, 68);
    for (Index i = 0; i < 68; ++i) {
        const Vec3<double> x = to_world(f, head.col(i));
        world.col(i) << x[0], x[1], x[2];
    }
    write_npy(params(f, "lmk_3d.npy"), npy_array<float>(Columns<float>(world.cast<float>())));
    write_npy(params(f, "vertices.npy"), npy_array<double>(Columns<double>(world.leftCols(5))));
    write_gaze(f);
    for (int c = 0; c < cameras; ++c) write_view(f, c, world);
}

void TinyCapture::write_gaze(int f) const {
    NpzArrays gaze;
    const auto put = [&](const std::string& name, const Vec3<double>& v) {
        gaze[name] = npy_array<double>({3}, std::span(v.data(), 3));
    };
    const auto put_pair = [&](const std::string& name, double a, double b) {
        const std::vector<double> pair{a, b};
        gaze[name] = npy_array<double>({2}, pair);
    };
    for (int e = 0; e < 2; ++e) {
        const std::string side = e == 0 ? "left" : "right";
        const double x = e == 0 ? 0.32 : -0.32, kappa = e == 0 ? 5 : -5, yaw = 0.1 * f;
        const Vec3<double> visual = gaze_vector(0.05, yaw);
        const Vec3<double> optical =
            gaze_vector(0.05 - 1.5 / 57.29577951308232, yaw + kappa / 57.29577951308232);
        put("gaze_" + side, optical);
        put("gaze_" + side + "_world",
            to_world(f, optical) - to_world(f, Vec3<double>(0, 0, 0)));
        put("visual_" + side, visual);
        put("eye_center_" + side, to_world(f, Vec3<double>(x, 0.33, 0.8)));
        put_pair("kappa_" + side, kappa, -1.5);
    }
    put_pair("eye_radius", 0.15, 0.15);
    put_pair("limbus_radius", 0.06, 0.06);
    put_pair("iris_plane", 0.14, 0.14);
    write_npz(params(f, "gaze.npz"), gaze);
}

void TinyCapture::write_view(int f, int c, const Columns<double>& world) const {
    const Pinhole<double> camera = pinhole(c);
    const std::vector<double> k{camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1};
    Eigen::Matrix<double, 3, 4, Eigen::RowMajor> m;
    m << camera.camera_from_world.rotation, camera.camera_from_world.translation;
    write_npz(
        camera_file(f, c),
        {{"intrinsic", npy_array<double>({3, 3}, k)},
         {"extrinsic", npy_array<double>({3, 4}, std::span<const double>(m.data(), 12))}});
    const auto project = [&](const Vec3<double>& x) {
        return Vec2<double>(camera.project_point(x).head<2>());
    };
    const Vec2<double> middle = project(world.rowwise().mean());
    double radius = 0;
    for (Index i = 0; i < 68; ++i)
        radius = std::max(radius, (project(world.col(i)) - middle).norm() + 1.5);
    Image8 rgb{size, size, 3, {}}, mask{size, size, 1, {}}, eyes{size, size, 1, {}};
    for (int y = 0; y < size; ++y)
        for (int x = 0; x < size; ++x) {
            const Vec2<double> at(x + 0.5, y + 0.5);
            const bool inside = (at - middle).norm() < radius;
            std::uint8_t label = 0;
            for (int e = 0; e < 2; ++e) {
                const Vec3<double> lids =
                    world.middleCols(e == 0 ? 42 : 36, 6).rowwise().mean();
                if ((at - project(lids)).norm() < 2) label = e == 0 ? 85 : 170;
            }
            const int shade = inside ? 100 + 10 * f + c : 0;
            for (const int channel : {0, 1, 2})
                rgb.values.push_back(static_cast<std::uint8_t>(shade + (inside ? channel : 0)));
            mask.values.push_back(inside ? 255 : 0);
            eyes.values.push_back(label);
        }
    write_png(image(f, c), rgb);
    write_png(image(f, c, "mask"), mask);
    write_png(image(f, c, "eye_mask"), eyes);
}

void TinyCapture::remove(const std::filesystem::path& file, const std::string& name) {
    NpzArrays arrays = read_npz(file);
    arrays.erase(name);
    write_npz(file, arrays);
}

std::vector<double> TinyCapture::get(const std::filesystem::path& file, const std::string& name) {
    return read_npz(file).at(name).values<double>(name);
}

std::filesystem::path TinyCapture::image(int f, int c, const std::string& stem) const {
    return folder / "images" / frame(f) / (stem + "_" + camera_id(c) + ".png");
}

std::filesystem::path TinyCapture::camera_file(int f, int c) const {
    return folder / "cameras" / frame(f) / ("camera_" + camera_id(c) + ".npz");
}

std::filesystem::path TinyCapture::params(int f, const std::string& file) const {
    return folder / "params" / frame(f) / file;
}

} // namespace rye::trainer
