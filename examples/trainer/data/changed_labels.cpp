// SPDX-License-Identifier: Apache-2.0
#include "data/changed_labels.hpp"

#include <array>
#include <span>

#include <rye/io/npz.hpp>
#include <rye/core/checksum.hpp>
#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/checksums.hpp"
#include "data/corrected_cameras.hpp"
#include "data/json.hpp"
#include "data/memory_limit.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

void write_bytes(const fs::path& path, ByteSpan bytes) {
    write_atomic(path, bytes, Durability::atomic_only);
}

/// Returns the numbers in the shape of an array; of 32 bits if it has 32.
NpyArray like(const NpyArray& array, const std::vector<double>& values) {
    if (array.kind != 'f' || array.item_size != 4) return npy_array<double>(array.shape, values);
    std::vector<float> narrow;
    for (const double x : values) narrow.push_back(static_cast<float>(x));
    return npy_array<float>(array.shape, narrow);
}

/// Replaces the numbers of an array, if the archive has it, by edit(numbers).
template <class F>
void edit(NpzArrays& arrays, const std::string& name, const std::string& who, F&& f) {
    const auto found = arrays.find(name);
    if (found == arrays.end()) return;
    std::vector<double> values = found->second.values<double>(who + ": " + name);
    f(values);
    found->second = like(found->second, values);
}

/// Motion of the world that takes the head from one pose to another.
struct HeadMotion {
    Mat3<double> rotation, last;
    Vec3<double> from, to;

    HeadMotion(const Vec<double, 6>& before, const Vec<double, 6>& after)
        : rotation(so3_exp(Vec3<double>(after.head<3>())) *
                   so3_exp(Vec3<double>(before.head<3>())).transpose()),
          last(so3_exp(Vec3<double>(after.head<3>()))),
          from(before.tail<3>()),
          to(after.tail<3>()) {}

    /// Moves points, three numbers each.
    void move(std::vector<double>& points) const {
        for (std::size_t i = 0; i + 2 < points.size(); i += 3) {
            Eigen::Map<Vec3<double>> x(points.data() + i);
            x = (rotation * (x - from) + to).eval();
        }
    }
};

/// The same for a motion that is known.
struct WorldMotion {
    Rigid<double> motion;
    void move(std::vector<double>& points) const {
        for (std::size_t i = 0; i + 2 < points.size(); i += 3) {
            Eigen::Map<Vec3<double>> x(points.data() + i);
            x = motion.apply(Vec3<double>(x));
        }
    }
};

/// Changes params.npz and returns the poses before and after.
HeadMotion change_params(const fs::path& file, const LabelChange& change) {
    const std::string who = file.string();
    NpzArrays arrays = read_npz(file, memory_limit());
    Vec<double, 6> before = Vec<double, 6>::Zero(), after = before;
    edit(arrays, "pose", who, [&](std::vector<double>& v) {
        require(v.size() == 6, who + ": pose",
                "got " + std::to_string(v.size()) + " numbers, expected 6");
        for (std::size_t i = 0; i < 6; ++i) {
            const auto k = static_cast<Index>(i);
            before[k] = v[i];
            v[i] += change.pose[k];
            after[k] = v[i];
        }
    });
    if (!change.expression.empty())
        edit(arrays, "exp_coeff", who, [&](std::vector<double>& v) {
            require(v.size() == change.expression.size(), who + ": exp_coeff",
                    "got " + std::to_string(v.size()) + " coefficients, expected " +
                        std::to_string(change.expression.size()));
            for (std::size_t i = 0; i < v.size(); ++i) v[i] += change.expression[i];
        });
    write_bytes(file, npz_bytes(arrays));
    return {before, after};
}

void change_gaze(const fs::path& file, const LabelChange& change, const HeadMotion& motion,
                 HeadPoints points) {
    const std::string who = file.string();
    NpzArrays arrays = read_npz(file, memory_limit());
    for (std::size_t e = 0; e < 2; ++e) {
        const std::string side = e == 0 ? "left" : "right";
        const auto vector_of = [&](std::vector<double>& v, const std::string& name) {
            require(v.size() == 3, who + ": " + name,
                    "got " + std::to_string(v.size()) + " numbers, expected 3");
            return Eigen::Map<Vec3<double>>(v.data());
        };
        Vec3<double> gaze = Vec3<double>::UnitZ();
        for (const std::string& name : {"gaze_" + side, "visual_" + side})
            edit(arrays, name, who, [&](std::vector<double>& v) {
                auto axis = vector_of(v, name);
                const Vec2<double> angles = pitch_yaw(Vec3<double>(axis));
                if (!change.gaze[e].isZero(0))
                    axis = gaze_vector(angles[0] + change.gaze[e][0], angles[1] + change.gaze[e][1]);
                if (name.starts_with("gaze")) gaze = axis;
            });
        edit(arrays, "gaze_" + side + "_world", who, [&](std::vector<double>& v) {
            vector_of(v, "gaze_" + side + "_world") = motion.last * gaze;
        });
        edit(arrays, "eye_center_" + side, who, [&](std::vector<double>& v) {
            if (points == HeadPoints::moved) motion.move(v);
            if (change.centre[e]) vector_of(v, "eye_center_" + side) = *change.centre[e];
        });
        if (const std::string name = "eye_center_" + side; change.centre[e] && !arrays.contains(name))
            arrays[name] = npy_array<double>({3}, std::span<const double>(change.centre[e]->data(), 3));
    }
    if (change.sizes) {
        const char* names[] = {"eye_radius", "limbus_radius", "iris_plane"};
        for (Index k = 0; k < 3; ++k) {
            const std::array<double, 2> both{(*change.sizes)[0][k], (*change.sizes)[1][k]};
            arrays[names[k]] = npy_array<double>({2}, both);
        }
    }
    write_bytes(file, npz_bytes(arrays));
}

/// Replaces the numbers of a camera in the frames in which it has exactly the wrong ones.
void change_cameras(const fs::path& from, const fs::path& to, const CorrectedCamera& camera) {
    const std::string name = "camera_" + camera.camera + ".npz";
    for (const fs::directory_entry& frame : fs::directory_iterator(from / "cameras")) {
        if (!fs::exists(frame.path() / name)) continue;
        if (!same_numbers(read_capture_camera(frame.path() / name), camera.wrong)) continue;
        const fs::path file = to / "cameras" / frame.path().filename() / name;
        const std::string who = file.string();
        NpzArrays arrays = read_npz(file, memory_limit());
        const Pinhole<double>& right = camera.right;
        edit(arrays, "intrinsic", who, [&](std::vector<double>& k) {
            k[0] = right.fx, k[2] = right.cx, k[4] = right.fy, k[5] = right.cy;
        });
        edit(arrays, "extrinsic", who, [&](std::vector<double>& m) {
            Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> extrinsic(m.data());
            extrinsic << right.camera_from_world.rotation, right.camera_from_world.translation;
        });
        write_bytes(file, npz_bytes(arrays));
    }
}

/// Moves the points of a file.
template <class Motion>
void change_points(const fs::path& file, const Motion& motion) {
    const NpyArray array = read_npy(file);
    std::vector<double> values = array.values<double>(file.string());
    motion.move(values);
    write_bytes(file, npy_bytes(like(array, values)));
}

/// Updates the checksums of the changed arrays, if capture.json states any.
void restate_checksums(const fs::path& folder, const std::vector<std::string>& changed) {
    const fs::path file = folder / "capture.json";
    if (!fs::exists(file)) return;
    Json json = parse_json_text<Json>(as_text(read_file(file, max_json_bytes)), file.string());
    if (!json.is_object() || !json.contains("checksums") || !json.at("checksums").is_object())
        return;
    const bool checked = json.contains("checksum");
    for (const std::string& name : changed)
        if (json.at("checksums").contains(name))
            json["checksums"][name] = checksum_text(crc32(read_file(folder / name)));
    const std::string text = checked ? checked_text(json, 1) : json.dump(1) + "\n";
    write_bytes(file, as_bytes(text));
}

bool is_below(const fs::path& path, const fs::path& folder) {
    const fs::path from = fs::weakly_canonical(path).lexically_relative(fs::weakly_canonical(folder));
    return !from.empty() && *from.begin() != "..";
}

} // namespace

LabelChange change_between(const CaptureFrame& before, const CaptureFrame& after) {
    LabelChange change;
    change.frame = before.id;
    change.pose = after.pose - before.pose;
    for (std::size_t e = 0; e < 2; ++e) {
        change.gaze[e] = pitch_yaw(after.eyes[e].optical) - pitch_yaw(before.eyes[e].optical);
        if (after.eyes[e].centre && after.eyes[e].centre != before.eyes[e].centre)
            change.centre[e] = after.eyes[e].centre;
    }
    if (!before.has_centres && after.has_centres) {
        const auto sizes = [](const CaptureEye& eye) {
            return Vec3<double>(eye.radius.value(), eye.limbus_radius.value(),
                                eye.iris_plane.value());
        };
        change.sizes = {sizes(after.eyes[0]), sizes(after.eyes[1])};
    }
    for (std::size_t k = 0; k < after.expression.size(); ++k)
        change.expression.push_back(static_cast<double>(after.expression[k]) -
                                    static_cast<double>(before.expression[k]));
    return change;
}

void check_new_capture(const fs::path& from, const fs::path& out) {
    require(!out.empty(), "--out", "is missing, expected the folder of the new capture");
    require(!fs::exists(out) || (fs::is_directory(out) && fs::is_empty(out)), out.string(),
            "exists already, expected a new or empty folder");
    require(!is_below(out, from), out.string(),
            "lies in the capture that it is made of, " + from.string());
}

void write_changed_capture(const fs::path& from, const fs::path& out,
                           const std::vector<LabelChange>& changes, HeadPoints points,
                           const BesideLabels& beside) {
    check_new_capture(from, out);
    fs::path parts = out;
    if (!parts.has_filename()) parts = parts.parent_path();
    parts += ".partial";
    fs::remove_all(parts);
    try {
        fs::create_directories(parts);
        fs::copy(from, parts, fs::copy_options::recursive);
        std::vector<std::string> changed;
        for (const LabelChange& change : changes) {
            const std::string folder = "params/" + change.frame + "/";
            const HeadMotion motion = change_params(parts / (folder + "params.npz"), change);
            if (fs::exists(parts / (folder + "gaze.npz")))
                change_gaze(parts / (folder + "gaze.npz"), change, motion, points);
            const bool with_head = points == HeadPoints::moved && !change.pose.isZero(0);
            if (!with_head && !change.points) continue;
            for (const char* name : {"lmk_3d.npy", "vertices.npy"}) {
                if (!fs::exists(parts / (folder + name))) continue;
                if (with_head)
                    change_points(parts / (folder + name), motion);
                else
                    change_points(parts / (folder + name), WorldMotion{*change.points});
                changed.push_back(folder + name);
            }
        }
        restate_checksums(parts, changed);
        for (const CorrectedCamera& camera : beside.cameras) change_cameras(from, parts, camera);
        for (const auto& [name, record] : beside.records) {
            const std::string text = checked_text(record, 1);
            write_bytes(parts / name, as_bytes(text));
        }
        read_capture(parts); // throws for any fault
        if (fs::exists(out)) fs::remove(out);
        fs::rename(parts, out);
    } catch (...) {
        std::error_code none;
        fs::remove_all(parts, none);
        throw;
    }
}

} // namespace rye::trainer
