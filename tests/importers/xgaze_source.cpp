// SPDX-License-Identifier: Apache-2.0
// HDF5 files as h5py writes them: chunks of one row, compressed by LZF, and plain arrays.
#include "sources.hpp"

#include <rye/core/error.hpp>

#ifdef RYE_HDF5
#include <hdf5.h>

#include <cmath>
#include <cstdio>
#include <fstream>

#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "importers/face_geometry.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using V3 = Vec3<double>;
using RowMajor3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

constexpr double mm = 100; // of a unit of the capture

/// LZF without search: runs of one byte as copies of the byte before, the rest as literals.
std::vector<std::uint8_t> encoded_lzf(const std::vector<std::uint8_t>& data) {
    std::vector<std::uint8_t> out;
    std::size_t at = 0, literals = 0;
    const auto flush = [&] {
        while (literals > 0) {
            const std::size_t n = std::min<std::size_t>(literals, 32);
            out.push_back(static_cast<std::uint8_t>(n - 1));
            const auto from = data.begin() + static_cast<std::ptrdiff_t>(at - literals);
            out.insert(out.end(), from, from + static_cast<std::ptrdiff_t>(n));
            literals -= n;
        }
    };
    while (at < data.size()) {
        std::size_t run = 0;
        while (at > 0 && at + run < data.size() && run < 264 && data[at + run] == data[at - 1])
            ++run;
        if (run < 3) {
            ++at, ++literals;
            continue;
        }
        flush();
        const std::size_t length = run - 2;
        if (length < 7) {
            out.push_back(static_cast<std::uint8_t>(length << 5U));
        } else {
            out.push_back(7U << 5U);
            out.push_back(static_cast<std::uint8_t>(length - 7));
        }
        out.push_back(0); // one byte back
        at += run;
    }
    flush();
    return out;
}

class Writer {
  public:
    explicit Writer(const fs::path& path)
        : file_(H5Fcreate(path.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT)) {
        require(file_ >= 0, path.string(), "cannot be written");
    }
    ~Writer() { H5Fclose(file_); }
    Writer(const Writer&) = delete;
    Writer& operator=(const Writer&) = delete;

    void numbers(const char* name, std::vector<hsize_t> shape, const std::vector<double>& values) {
        const hid_t space = H5Screate_simple(static_cast<int>(shape.size()), shape.data(), nullptr);
        const hid_t set =
            H5Dcreate2(file_, name, H5T_IEEE_F64LE, space, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
        H5Dwrite(set, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data());
        H5Dclose(set);
        H5Sclose(space);
    }
    /// Rows of bytes, each a chunk compressed by LZF.
    void bytes(const char* name, std::vector<hsize_t> shape,
               const std::vector<std::vector<std::uint8_t>>& rows) {
        const hid_t space = H5Screate_simple(static_cast<int>(shape.size()), shape.data(), nullptr);
        std::vector<hsize_t> chunk = shape;
        chunk[0] = 1;
        const hid_t properties = H5Pcreate(H5P_DATASET_CREATE);
        H5Pset_chunk(properties, static_cast<int>(chunk.size()), chunk.data());
        const std::array<unsigned, 3> values{4, 261, static_cast<unsigned>(rows.front().size())};
        H5Pset_filter(properties, 32000, H5Z_FLAG_OPTIONAL, values.size(), values.data());
        const hid_t set =
            H5Dcreate2(file_, name, H5T_STD_U8LE, space, H5P_DEFAULT, properties, H5P_DEFAULT);
        require(set >= 0, name, "cannot be made");
        for (std::size_t i = 0; i < rows.size(); ++i) {
            std::vector<hsize_t> at(shape.size(), 0);
            at[0] = i;
            const std::vector<std::uint8_t> packed = encoded_lzf(rows[i]);
            // What does not shrink is stored as it is, marked in the filter mask.
            const bool shrinks = packed.size() < rows[i].size();
            const std::vector<std::uint8_t>& data = shrinks ? packed : rows[i];
            require(H5Dwrite_chunk(set, H5P_DEFAULT, shrinks ? 0U : 1U, at.data(), data.size(),
                                   data.data()) >= 0,
                    name, "cannot be written");
        }
        H5Dclose(set);
        H5Pclose(properties);
        H5Sclose(space);
    }

  private:
    hid_t file_;
};

/// All arrays of a file, row by row.
struct Rows {
    std::vector<double> cam, frame, landmarks, rotation, translation, intrinsic, gaze, codes, head;
    std::vector<std::vector<std::uint8_t>> patch, head_mask, left, right;
};

void add_matrix(std::vector<double>& to, const Mat3<double>& m) {
    const RowMajor3 rows = m;
    to.insert(to.end(), rows.data(), rows.data() + 9);
}

std::vector<std::uint8_t> bgr(const Image8& rgb) {
    std::vector<std::uint8_t> out = rgb.values;
    for (std::size_t i = 0; i + 2 < out.size(); i += 3) std::swap(out[i], out[i + 2]);
    return out;
}

/// The picture that `to` sees from the same place; black where `from` has no pixel.
Image8 turned(const Image8& picture, const Pinhole<double>& from, const Pinhole<double>& to) {
    Image8 out{to.width, to.height, 3,
               std::vector<std::uint8_t>(static_cast<std::size_t>(3 * to.width * to.height))};
    for (int y = 0; y < to.height; ++y)
        for (int x = 0; x < to.width; ++x) {
            const V3 p = from.project_point(from.centre() + to.ray(Vec2<double>(x + 0.5, y + 0.5)));
            if (!(p.z() > 0 && p.x() >= 0 && p.y() >= 0 && p.x() < from.width &&
                  p.y() < from.height))
                continue;
            const auto at = static_cast<std::size_t>(
                3 * (static_cast<int>(p.y()) * from.width + static_cast<int>(p.x())));
            for (std::size_t c = 0; c < 3; ++c) // the background is not black, as in a room
                out.values[static_cast<std::size_t>(3 * (y * to.width + x)) + c] =
                    std::max<std::uint8_t>(picture.values[at + c], 12);
        }
    return out;
}

std::string matrix_xml(const char* name, int rows, int cols, const double* values) {
    std::string text = std::string("<") + name + " type_id=\"opencv-matrix\">\n  <rows>" +
                       std::to_string(rows) + "</rows>\n  <cols>" + std::to_string(cols) +
                       "</cols>\n  <dt>d</dt>\n  <data>\n   ";
    char digits[40];
    for (int i = 0; i < rows * cols; ++i) {
        std::snprintf(digits, sizeof digits, " %.17g", values[i]);
        text += digits;
    }
    return text + "</data></" + name + ">\n";
}

void write_calibration(const Pinhole<double>& c, const fs::path& path) {
    const RowMajor3 r = c.camera_from_world.rotation;
    const V3 t = mm * c.camera_from_world.translation;
    const std::array<double, 9> k{13200, 0, 3000, 0, 13200, 2000, 0, 0, 1};
    const std::array<double, 5> d{0.26, 1.48, -0.001, 0.001, -14.9};
    fs::create_directories(path.parent_path());
    std::ofstream(path) << "<?xml version=\"1.0\"?>\n<opencv_storage>\n"
                        << matrix_xml("Camera_Matrix", 3, 3, k.data())
                        << matrix_xml("Distortion_Coefficients", 1, 5, d.data())
                        << matrix_xml("cam_rotation", 3, 3, r.data())
                        << matrix_xml("cam_translation", 3, 1, t.data()) << "</opencv_storage>\n";
}

/// Camera of the patch in the place of a camera, as the normalisation has it, in the true world.
Pinhole<double> normalized_camera(const Pinhole<double>& real, const V3& face, const V3& head_x,
                                  int side) {
    const V3 forward = normalized(V3(face - real.centre()));
    const V3 down = normalized(cross(forward, head_x));
    const V3 right = normalized(cross(down, forward));
    Pinhole<double> c = real;
    c.width = c.height = side;
    c.fx = c.fy = 960.0 * side / 448 * (mm * (face - real.centre()).norm()) / 300;
    c.cx = c.cy = 0.5 * side + 0.5;
    c.camera_from_world.rotation << right.transpose(), down.transpose(), forward.transpose();
    c.camera_from_world.translation = -(c.camera_from_world.rotation * real.centre());
    return c;
}

void add_landmarks(std::vector<double>& to, const Columns<double>& points,
                   const Pinhole<double>& c) {
    for (Index i = 0; i < 68; ++i) {
        const V3 p = c.project_point(points.col(i));
        to.push_back(p.x() - 0.5); // OpenCV's pixels
        to.push_back(p.y() - 0.5);
    }
}

} // namespace

void write_xgaze_source(const TrueScene& truth, const fs::path& file, const fs::path& calibration,
                        XgazeFields fields) {
    const Capture& c = truth.tracked;
    const bool gazenerf = fields == XgazeFields::gazenerf;
    const int side = c.width;
    Rows rows;
    for (int f = 0; f < c.frame_count(); ++f) {
        const CaptureFrame& frame = c.frames[static_cast<std::size_t>(f)];
        const Columns<double> points = true_landmarks(c, frame.id);
        const Mat3<double> head = so3_exp(V3(frame.pose.head<3>()));
        const V3 at = frame.pose.tail<3>();
        const V3 eyes = points.middleCols(36, 12).rowwise().mean(),
                 mouth = points.middleCols(48, 20).rowwise().mean();
        const V3 face = 0.5 * (eyes + mouth);
        const V3 gaze = normalized(V3(frame.eyes[0].optical + frame.eyes[1].optical));
        for (int k = 0; k < c.camera_count(); ++k) {
            const Pinhole<double>& real = c.camera(f, k);
            const Image8 picture = to_8bit(c.image(f, k));
            rows.cam.push_back(k);
            rows.frame.push_back(f == 1 ? 255 : f); // numbers of frames wrap in these files
            if (gazenerf) {
                Pinhole<double> camera = real;
                camera.camera_from_world.rotation = real.camera_from_world.rotation * head;
                camera.camera_from_world.translation = real.camera_from_world.apply(at);
                add_matrix(rows.rotation, camera.camera_from_world.rotation);
                for (int d = 0; d < 3; ++d)
                    rows.translation.push_back(camera.camera_from_world.translation[d]);
                Mat3<double> in = Mat3<double>::Identity();
                in(0, 0) = real.fx;
                in(1, 1) = real.fy;
                in(0, 2) = real.cx - 0.5;
                in(1, 2) = real.cy - 0.5;
                add_matrix(rows.intrinsic, in);
                add_landmarks(rows.landmarks, points, real);
                // The head's axes of ETH-XGaze: y down, z inwards.
                const V3 v(gaze.x(), -gaze.y(), -gaze.z());
                rows.gaze.push_back(std::asin(v.y()));
                rows.gaze.push_back(std::atan2(-v.x(), -v.z()));
                // 100 codes of the identity, 79 of the expression, and others.
                for (std::size_t i = 0; i < 306; ++i) {
                    const std::size_t e = i - 100;
                    const bool expression = i >= 100 && i < 179;
                    const bool has = expression && e < frame.expression.size();
                    rows.codes.push_back(has          ? static_cast<double>(frame.expression[e])
                                         : expression ? 0
                                                      : 7);
                }
                rows.patch.push_back(bgr(picture));
                rows.head_mask.push_back(to_8bit(c.mask(f, k)).values);
                const Image<float> labels = c.eye_mask(f, k);
                for (Index e = 0; e < 2; ++e) {
                    std::vector<std::uint8_t> mask;
                    for (Index i = 0; i < labels.size(); ++i)
                        mask.push_back(labels.pixels(e, i) > 0 ? 255 : 0);
                    (e == 0 ? rows.left : rows.right).push_back(mask);
                }
            } else {
                const Pinhole<double> camera = normalized_camera(real, face, head.col(0), side);
                add_matrix(rows.rotation, camera.camera_from_world.rotation *
                                              real.camera_from_world.rotation.transpose());
                add_landmarks(rows.landmarks, points, camera);
                const V3 v = -(camera.camera_from_world.rotation * (head * gaze));
                const Vec2<double> angles = pitch_yaw(v);
                rows.gaze.push_back(angles[0]);
                rows.gaze.push_back(angles[1]);
                rows.patch.push_back(bgr(turned(picture, real, camera)));
                if (f == 0) {
                    char name[24];
                    std::snprintf(name, sizeof name, "cam%02d.xml", k);
                    write_calibration(real, calibration / name);
                }
            }
        }
    }
    if (!gazenerf) // ETH-XGaze makes room for more patches than it writes
        for (int i = 0; i < 3; ++i) {
            rows.cam.push_back(0);
            rows.frame.push_back(0);
            rows.landmarks.insert(rows.landmarks.end(), 136, 0);
            rows.rotation.insert(rows.rotation.end(), 9, 0);
            rows.gaze.insert(rows.gaze.end(), 2, 0);
            rows.patch.emplace_back(static_cast<std::size_t>(3 * side * side), std::uint8_t(0));
        }
    const hsize_t n = rows.cam.size(), s = static_cast<hsize_t>(side);
    Writer out(file);
    out.numbers("cam_index", {n, 1}, rows.cam);
    out.numbers("frame_index", {n, 1}, rows.frame);
    out.numbers("facial_landmarks", {n, 68, 2}, rows.landmarks);
    out.bytes("face_patch", {n, s, s, 3}, rows.patch);
    if (!gazenerf) {
        out.numbers("face_mat_norm", {n, 3, 3}, rows.rotation);
        out.numbers("face_gaze", {n, 2}, rows.gaze);
        return;
    }
    out.numbers("w2c_Rmat", {n, 3, 3}, rows.rotation);
    out.numbers("w2c_Tvec", {n, 3}, rows.translation);
    out.numbers("inmat", {n, 3, 3}, rows.intrinsic);
    out.numbers("pitchyaw_head", {n, 2}, rows.gaze);
    out.numbers("latent_codes", {n, 306}, rows.codes);
    out.bytes("head_mask", {n, s, s}, rows.head_mask);
    out.bytes("left_eye_mask", {n, s, s}, rows.left);
    out.bytes("right_eye_mask", {n, s, s}, rows.right);
}

} // namespace rye::trainer

#else

namespace rye::trainer {

void write_xgaze_source(const TrueScene&, const std::filesystem::path& file,
                        const std::filesystem::path&, XgazeFields) {
    throw Error(file.string() + ": written by libhdf5, which was absent when this was built");
}

} // namespace rye::trainer

#endif
