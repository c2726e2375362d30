// SPDX-License-Identifier: Apache-2.0
/// tests/programs/tiny_capture.hpp: a small, valid capture on disk for a test to damage.
/// Four frames of a turning head in front of three cameras, 48 x 48 pixels.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include <rye/io/npz.hpp>
#include <rye/geometry/camera.hpp>

namespace rye::trainer {

struct TinyCapture {
    static constexpr int frames = 4, cameras = 3, size = 48;
    std::filesystem::path folder;

    explicit TinyCapture(const std::filesystem::path& where);

    std::filesystem::path image(int f, int c, const std::string& stem = "image") const;
    std::filesystem::path camera_file(int f, int c) const;
    std::filesystem::path params(int f, const std::string& file) const;
    static std::string frame(int f) { return "000" + std::to_string(f); }
    static std::string camera_id(int c) { return "c" + std::to_string(c); }

    /// Replaces one array of an npz.
    template <class T>
    static void set(const std::filesystem::path& file, const std::string& name,
                    std::vector<Index> shape, const std::vector<T>& values) {
        replace(file, name, npy_array<T>(std::move(shape), values));
    }
    static void replace(const std::filesystem::path& file, const std::string& name,
                        const NpyArray& array);
    static void remove(const std::filesystem::path& file, const std::string& name);
    static std::vector<double> get(const std::filesystem::path& file, const std::string& name);
    using Edit = std::function<void(std::vector<double>&)>;
    /// Calls edit(values) for one array in every frame (and camera) and writes it back as float64.
    void edit_all(const std::string& file, const std::string& name, const Edit& edit) const;
    static void edit_one(const std::filesystem::path& file, const std::string& name,
                         const Edit& edit);
    void write_text(const std::string& name, const std::string& text) const;
    /// Writes expressions of three coefficients, as many as tiny_state() has.
    void set_expressions() const;

    /// 68 landmarks in the head's frame, in the order of iBUG [dm].
    static Columns<double> head_points();
    static Vec<double, 6> pose(int f);
    static Vec3<double> to_world(int f, const Vec3<double>& head);
    static Pinhole<double> pinhole(int c);

  private:
    void write_frame(int f) const;
    void write_gaze(int f) const;
    /// The head is a disc around its landmarks, an eye a small one around its lids.
    void write_view(int f, int c, const Columns<double>& world) const;
};

} // namespace rye::trainer
