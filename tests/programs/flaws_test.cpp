// SPDX-License-Identifier: Apache-2.0
// rye flaw: each error alone has the size that was asked for, and touches the files that it should.
// Root mean squares of n normal numbers lie within 4.5 / sqrt(2 n) of the size, by far.
#include "data/flaws.hpp"

#include <cmath>
#include <cstdint>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "../support/hostile.hpp"
#include "command_line.hpp"
#include "data/capture.hpp"
#include "data/checksums.hpp"
#include "data/json.hpp"
#include "data/picture.hpp"
#include "data/threads.hpp"
#include "data/validate.hpp"
#include "tiny_capture.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

constexpr double degree = 3.14159265358979323846 / 180;
constexpr int seeds = 24;

using Set = std::function<void(FlawOptions&)>;

FlawReport flaw(const fs::path& capture, const fs::path& out, std::uint64_t seed, const Set& set) {
    FlawOptions o;
    o.capture = capture;
    o.out = out;
    o.seed = seed;
    set(o);
    return write_flawed(o);
}

/// The bytes of all files of a folder by their path.
std::map<std::string, Bytes> contents(const fs::path& folder) {
    std::map<std::string, Bytes> all;
    for (const auto& entry : fs::recursive_directory_iterator(folder))
        if (entry.is_regular_file())
            all[entry.path().lexically_relative(folder).generic_string()] = read_file(entry.path());
    return all;
}

/// Names, without frame and camera, of files that are not the same in both; flaws.json apart.
std::set<std::string> changed(const fs::path& a, const fs::path& b,
                              const std::string& in_frame = "") {
    const auto one = contents(a), other = contents(b);
    std::set<std::string> names, all;
    for (const auto* list : {&one, &other})
        for (const auto& [name, bytes] : *list) all.insert(name);
    for (const std::string& name : all) {
        if (name == "flaws.json" || name.find("/" + in_frame) == std::string::npos) continue;
        const bool same =
            one.contains(name) && other.contains(name) && one.at(name) == other.at(name);
        const std::string file = fs::path(name).filename().string();
        if (!same)
            names.insert(file.find("_c") == std::string::npos ? file
                                                              : file.substr(0, file.find("_c")));
    }
    return names;
}

/// Differences of numbers that should be normal, of standard deviation `size`.
void check_normal(const std::vector<double>& x, double size) {
    double sum = 0, squares = 0;
    for (const double v : x) sum += v, squares += v * v;
    const double n = static_cast<double>(x.size());
    INFO("numbers: ", x.size(), ", asked: ", size, ", rms: ", std::sqrt(squares / n));
    CHECK(std::abs(std::sqrt(squares / n) / size - 1) < 4.5 / std::sqrt(2 * n));
    CHECK(std::abs(sum / n) < 4.5 * size / std::sqrt(n));
}

/// Appends the numbers by which a flawed capture differs from the other.
using Measure = std::function<void(const Capture&, const Capture&, std::vector<double>&)>;

/// Writes one flaw with several seeds into all frames, and compares size and changed files.
void check_alone(const TinyCapture& tiny, const Set& set, double size,
                 const std::set<std::string>& files, const Measure& measure) {
    const TemporaryFolder outs;
    const Capture before = read_capture(tiny.folder);
    std::vector<double> differences;
    for (int seed = 0; seed < seeds; ++seed) {
        const fs::path out = outs.path / std::to_string(seed);
        flaw(tiny.folder, out, static_cast<std::uint64_t>(seed), [&](FlawOptions& o) {
            o.labels = FlawedFrames::all;
            set(o);
        });
        measure(before, read_valid_capture(out), differences);
        CHECK(changed(tiny.folder, out) == files);
    }
    check_normal(differences, size);
}

void append(std::vector<double>& to, const Vec3<double>& v, double factor) {
    for (const int k : {0, 1, 2}) to.push_back(factor * v[k]);
}

/// Measures each frame and each of its eyes.
Measure of_eyes(
    const std::function<void(const CaptureEye&, const CaptureEye&, std::vector<double>&)>& f,
    int eyes = 2) {
    return [=](const Capture& a, const Capture& b, std::vector<double>& out) {
        for (std::size_t i = 0; i < a.frames.size(); ++i)
            for (std::size_t e = 0; e < static_cast<std::size_t>(eyes); ++e)
                f(a.frames[i].eyes[e], b.frames[i].eyes[e], out);
    };
}

void gaze_difference(const CaptureEye& a, const CaptureEye& b, std::vector<double>& out) {
    const Vec2<double> before = pitch_yaw(a.optical), now = pitch_yaw(b.optical);
    for (const int k : {0, 1}) out.push_back((now[k] - before[k]) / degree);
}

Measure of_frames(
    const std::function<void(const CaptureFrame&, const CaptureFrame&, std::vector<double>&)>& f) {
    return [=](const Capture& a, const Capture& b, std::vector<double>& out) {
        for (std::size_t i = 0; i < a.frames.size(); ++i) f(a.frames[i], b.frames[i], out);
    };
}

/// Measures each camera, which must be the same in all frames.
Measure of_cameras(const std::function<void(const Pinhole<double>&, const Pinhole<double>&,
                                            std::vector<double>&)>& f) {
    return [=](const Capture& a, const Capture& b, std::vector<double>& out) {
        for (int c = 0; c < a.camera_count(); ++c) {
            f(a.camera(0, c), b.camera(0, c), out);
            CHECK(b.camera(1, c).fx == b.camera(0, c).fx);
            CHECK(b.camera(1, c).camera_from_world.rotation ==
                  b.camera(0, c).camera_from_world.rotation);
            CHECK(b.camera(1, c).camera_from_world.translation ==
                  b.camera(0, c).camera_from_world.translation);
        }
    };
}

double linear(double v) {
    const double s = v / 255;
    return s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4);
}

/// Log of the light of a pixel against the light before, times 100.
double light_change(const Image8& before, const Image8& now, int x, int y, int channel) {
    const auto at = static_cast<std::size_t>(3 * (y * before.width + x) + channel);
    return 100 * std::log(linear(now.values[at]) / linear(before.values[at]));
}

/// Mean squared distance of a channel's light from its middle, which a blur of s px raises by 2
/// s^2.
double moment(const Image8& image, bool light) {
    const int step = image.channels;
    double total = 0, mx = 0, my = 0, squares = 0;
    for (int y = 0; y < image.height; ++y)
        for (int x = 0; x < image.width; ++x) {
            const double v = image.values[static_cast<std::size_t>(step * (y * image.width + x))];
            const double w = light ? linear(v) : v;
            total += w, mx += w * x, my += w * y, squares += w * (x * x + y * y);
        }
    mx /= total, my /= total;
    return squares / total - mx * mx - my * my;
}

} // namespace

TEST_CASE("flaw: gazes") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    check_alone(
        tiny, [](FlawOptions& o) { o.sizes[Flaw::gaze_common] = 4; }, 4, {"gaze.npz"},
        of_eyes(gaze_difference, 1));
    check_alone(
        tiny, [](FlawOptions& o) { o.sizes[Flaw::gaze_single] = 2; }, 2, {"gaze.npz"},
        of_eyes(gaze_difference));
    check_alone(
        tiny, [](FlawOptions& o) { o.sizes[Flaw::centres] = 1.2; }, 1.2, {"gaze.npz"},
        of_eyes([](const CaptureEye& a, const CaptureEye& b, std::vector<double>& out) {
            append(out, *b.centre - *a.centre, 100);
            CHECK(a.optical == b.optical);
        }));
    // Both eyes alike; visual axes and kappa go with them, and directions in the world.
    flaw(tiny.folder, folder.path / "out", 1,
         [](FlawOptions& o) { o.sizes[Flaw::gaze_common] = 5; });
    const Capture before = read_capture(tiny.folder), now = read_capture(folder.path / "out");
    for (std::size_t f = 0; f < 3; ++f) {
        std::vector<double> left, right, visual;
        gaze_difference(before.frames[f].eyes[0], now.frames[f].eyes[0], left);
        gaze_difference(before.frames[f].eyes[1], now.frames[f].eyes[1], right);
        for (std::size_t k = 0; k < 2; ++k) {
            CHECK(left[k] == doctest::Approx(right[k]).epsilon(1e-9));
            const double v = (pitch_yaw(*now.frames[f].eyes[0].visual) -
                              pitch_yaw(*before.frames[f].eyes[0].visual))[static_cast<Index>(k)] /
                             degree;
            CHECK(v == doctest::Approx(left[k]).epsilon(1e-9));
        }
        const Mat3<double> turn = so3_exp(Vec3<double>(now.frames[f].pose.head<3>()));
        CHECK((turn * now.frames[f].eyes[0].optical - *now.frames[f].eyes[0].optical_world).norm() <
              1e-12);
    }
    CHECK(changed(tiny.folder, folder.path / "out", "0003/").empty()); // the test frame
    CHECK(changed(tiny.folder, folder.path / "out", "0000/") == std::set<std::string>{"gaze.npz"});
}

TEST_CASE("flaw: expression, pose and landmarks") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    int coefficients = 0, off = 0;
    check_alone(
        tiny,
        [](FlawOptions& o) {
            o.sizes[Flaw::expression] = 0.06;
            o.expression_share = 0.5;
        },
        0.06, {"params.npz"},
        of_frames([&](const CaptureFrame& a, const CaptureFrame& b, std::vector<double>& out) {
            CHECK(a.pose == b.pose);
            for (std::size_t i = 0; i < a.expression.size(); ++i) {
                ++coefficients;
                if (a.expression[i] == b.expression[i]) continue;
                ++off;
                out.push_back(static_cast<double>(b.expression[i]) -
                              static_cast<double>(a.expression[i]));
            }
        }));
    CHECK(coefficients == 8 * seeds);
    CHECK(std::abs(static_cast<double>(off) / coefficients - 0.5) <
          4.5 * 0.5 / std::sqrt(static_cast<double>(coefficients)));
    // A rotation takes the directions in the world with it.
    check_alone(
        tiny, [](FlawOptions& o) { o.sizes[Flaw::pose_rotation] = 0.6; }, 0.6,
        {"gaze.npz", "params.npz"},
        of_frames([](const CaptureFrame& a, const CaptureFrame& b, std::vector<double>& out) {
            const Mat3<double> before = so3_exp(Vec3<double>(a.pose.head<3>()));
            const Mat3<double> now = so3_exp(Vec3<double>(b.pose.head<3>()));
            append(out, so3_log(Mat3<double>(now * before.transpose())), 1 / degree);
            CHECK(a.pose.tail<3>() == b.pose.tail<3>());
            CHECK(a.eyes[0].optical == b.eyes[0].optical);
            CHECK((now * b.eyes[0].optical - *b.eyes[0].optical_world).norm() < 1e-12);
        }));
    check_alone(
        tiny, [](FlawOptions& o) { o.sizes[Flaw::pose_position] = 1; }, 1, {"params.npz"},
        of_frames([](const CaptureFrame& a, const CaptureFrame& b, std::vector<double>& out) {
            append(out, b.pose.tail<3>() - a.pose.tail<3>(), 100);
            CHECK(a.pose.head<3>() == b.pose.head<3>());
        }));
    check_alone(
        tiny, [](FlawOptions& o) { o.sizes[Flaw::landmarks] = 1.5; }, 1.5,
        {"lmk_3d.npy", "vertices.npy"},
        of_frames([](const CaptureFrame& a, const CaptureFrame& b, std::vector<double>& out) {
            for (Index i = 0; i < a.landmarks.cols(); ++i)
                append(out, b.landmarks.col(i) - a.landmarks.col(i), 100);
            for (Index i = 0; i < a.vertices.cols(); ++i)
                append(out, b.vertices.col(i) - a.vertices.col(i), 100);
        }));
}

TEST_CASE("flaw: cameras") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    using Camera = Pinhole<double>;
    check_alone(
        tiny, [](FlawOptions& o) { o.sizes[Flaw::camera_rotation] = 0.2; }, 0.2, {"camera"},
        of_cameras([](const Camera& a, const Camera& b, std::vector<double>& out) {
            append(out,
                   so3_log(Mat3<double>(b.camera_from_world.rotation *
                                        a.camera_from_world.rotation.transpose())),
                   1 / degree);
            CHECK((a.centre() - b.centre()).norm() < 1e-12);
        }));
    check_alone(
        tiny, [](FlawOptions& o) { o.sizes[Flaw::camera_position] = 5; }, 5, {"camera"},
        of_cameras([](const Camera& a, const Camera& b, std::vector<double>& out) {
            append(out, b.centre() - a.centre(), 100);
            CHECK((a.camera_from_world.rotation - b.camera_from_world.rotation).norm() == 0);
        }));
    check_alone(
        tiny, [](FlawOptions& o) { o.sizes[Flaw::focal] = 3; }, 3, {"camera"},
        of_cameras([](const Camera& a, const Camera& b, std::vector<double>& out) {
            out.push_back(100 * std::log(b.fx / a.fx));
            CHECK(b.fy / a.fy == doctest::Approx(b.fx / a.fx).epsilon(1e-12));
            CHECK(a.cx == b.cx);
        }));
}

TEST_CASE("flaw: light") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    const int middle = TinyCapture::size / 2;
    // Light of each frame, camera and channel, or of some that stand for all.
    const auto light = [&](int frames, int cameras, int channels, int x, int y) {
        return [=](const Capture& a, const Capture& b, std::vector<double>& out) {
            for (int f = 0; f < frames; ++f)
                for (int c = 0; c < cameras; ++c)
                    for (int k = 0; k < channels; ++k)
                        out.push_back(light_change(read_image8(a.view(f, c).image, 3),
                                                   read_image8(b.view(f, c).image, 3), x, y, k));
        };
    };
    check_alone(
        tiny, [](FlawOptions& o) { o.sizes[Flaw::gain] = 12; }, 12, {"image"},
        light(1, 3, 1, middle, middle));
    check_alone(
        tiny, [](FlawOptions& o) { o.sizes[Flaw::white_balance] = 8; }, 8, {"image"},
        light(1, 3, 3, middle, middle));
    check_alone(
        tiny, [](FlawOptions& o) { o.sizes[Flaw::exposure] = 12; }, 12, {"image"},
        light(4, 1, 1, middle, middle));
    check_alone(
        tiny, [](FlawOptions& o) { o.sizes[Flaw::noise] = 5; }, 5, {"image"},
        [&](const Capture& a, const Capture& b, std::vector<double>& out) {
            const Image8 before = read_image8(a.view(0, 0).image, 3);
            const Image8 now = read_image8(b.view(0, 0).image, 3);
            for (std::size_t i = 0; i < now.values.size(); ++i)
                if (before.values[i] > 0) // else numbers below 0 are lost
                    out.push_back(double(now.values[i]) - double(before.values[i]));
        });
    // Corners lose light: the logarithm goes with the squared distance from the middle.
    const TemporaryFolder outs;
    double squares = 0;
    for (int seed = 0; seed < seeds; ++seed) {
        const fs::path out = outs.path / std::to_string(seed);
        const FlawReport report = flaw(tiny.folder, out, static_cast<std::uint64_t>(seed),
                                       [](FlawOptions& o) { o.sizes[Flaw::vignetting] = 60; });
        double asked = 0;
        for (int c = 0; c < 3; ++c) {
            const Image8 a = read_image8(tiny.image(0, c)),
                         b = read_image8(out / "images" / "0000" /
                                         ("image_c" + std::to_string(c) + ".png"));
            const int x = middle + 10;
            const double away = (10.5 * 10.5 + 0.25) / (2.0 * middle * middle);
            const double lost = -light_change(a, b, x, middle, 0) / away;
            CHECK(lost > -8); // rounding of stored values
            asked += lost * lost;
        }
        CHECK(std::sqrt(asked / 3) ==
              doctest::Approx(report.sums[Flaw::vignetting].rms()).epsilon(0.3));
        squares += asked;
    }
    const double n = 3.0 * seeds;
    CHECK(std::abs(std::sqrt(squares / n) / 60 - 1) < 0.05 + 4.5 / std::sqrt(2 * n));
}

TEST_CASE("flaw: blur, masks, JPEG") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    const auto out = [&](const char* name) { return folder.path / name; };
    const auto file = [&](const char* name, const char* stem, const char* suffix = ".png") {
        return folder.path / name / "images" / "0001" / (std::string(stem) + "_c1" + suffix);
    };
    flaw(tiny.folder, out("blur"), 0, [](FlawOptions& o) { o.sizes[Flaw::blur] = 1.5; });
    CHECK(changed(tiny.folder, out("blur")) == std::set<std::string>{"image"});
    CHECK(moment(read_image8(file("blur", "image")), true) -
              moment(read_image8(tiny.image(1, 1)), true) ==
          doctest::Approx(2 * 1.5 * 1.5).epsilon(0.1));

    flaw(tiny.folder, out("soft"), 0, [](FlawOptions& o) { o.sizes[Flaw::soft_masks] = 2; });
    CHECK(changed(tiny.folder, out("soft")) == std::set<std::string>{"mask"});
    CHECK(changed(tiny.folder, out("soft"), "0003/").empty());
    CHECK(moment(read_image8(file("soft", "mask")), false) -
              moment(read_image8(tiny.image(1, 1, "mask")), false) ==
          doctest::Approx(2 * 2 * 2).epsilon(0.1));

    // Pixels that change sides, a pixel of the outline: the mean of |normal|, sqrt(2 / pi).
    double crossed = 0, outline = 0, displacement = 0;
    for (int seed = 0; seed < seeds; ++seed) {
        const fs::path to = out(("wrong" + std::to_string(seed)).c_str());
        const FlawReport report = flaw(tiny.folder, to, static_cast<std::uint64_t>(seed),
                                       [](FlawOptions& o) { o.sizes[Flaw::wrong_masks] = 2; });
        CHECK(changed(tiny.folder, to) == std::set<std::string>{"mask"});
        displacement += report.sums[Flaw::wrong_masks].rms() / seeds;
        const Image8 a = read_image8(tiny.image(0, 0, "mask"));
        const Image8 b = read_image8(to / "images" / "0000" / "mask_c0.png");
        double area = 0;
        for (std::size_t i = 0; i < a.values.size(); ++i) {
            crossed += std::abs(double(a.values[i]) - double(b.values[i])) / 255;
            area += a.values[i] / 255.0;
        }
        outline += 2 * std::sqrt(3.14159265 * area); // of a disc
    }
    CHECK(displacement == doctest::Approx(2).epsilon(0.1));
    CHECK(crossed / outline == doctest::Approx(2 * std::sqrt(2 / 3.14159265)).epsilon(0.15));

    const FlawReport grown = flaw(tiny.folder, out("grown"), 0,
                                  [](FlawOptions& o) { o.sizes[Flaw::eye_mask_dilation] = 2; });
    CHECK(changed(tiny.folder, out("grown")) == std::set<std::string>{"eye_mask"});
    CHECK(changed(tiny.folder, out("grown"), "0003/").empty());
    const Image8 eyes = read_image8(tiny.image(1, 1, "eye_mask")),
                 more = read_image8(file("grown", "eye_mask"));
    int added = 0;
    for (int y = 0; y < eyes.height; ++y)
        for (int x = 0; x < eyes.width; ++x) {
            int least = 1000;
            for (int v = 0; v < eyes.height; ++v)
                for (int u = 0; u < eyes.width; ++u)
                    if (eyes.values[static_cast<std::size_t>(v * eyes.width + u)] != 0)
                        least = std::min(least, (u - x) * (u - x) + (v - y) * (v - y));
            const int now = more.values[static_cast<std::size_t>(y * eyes.width + x)];
            CHECK((now != 0) == (least <= 4));
            CHECK(now % 85 == 0);
            added += now != 0 && least > 0 ? 1 : 0;
        }
    CHECK(added > 10);
    CHECK(grown.sums[Flaw::eye_mask_dilation].count >= added);

    double before = 0;
    for (const int quality : {90, 10}) {
        const std::string name = "jpeg" + std::to_string(quality);
        const FlawReport report = flaw(tiny.folder, out(name.c_str()), 0,
                                       [&](FlawOptions& o) { o.sizes[Flaw::jpeg] = quality; });
        CHECK(changed(tiny.folder, out(name.c_str())) == std::set<std::string>{"image"});
        CHECK(!fs::exists(file(name.c_str(), "image")));
        const Image8 a = read_image8(tiny.image(1, 1)),
                     b = read_image8(file(name.c_str(), "image", ".jpg"), 3);
        double squares = 0;
        for (std::size_t i = 0; i < a.values.size(); ++i)
            squares += std::pow(double(a.values[i]) - double(b.values[i]), 2);
        const double rms = std::sqrt(squares / static_cast<double>(a.values.size()));
        CHECK(rms > before);
        CHECK(report.sums[Flaw::jpeg].rms() == doctest::Approx(rms).epsilon(0.5));
        before = rms;
    }
}

TEST_CASE("flaw: pictures over black stay black outside their masks, and are cut out by new ones") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    tiny.write_text("capture.json", R"({"train_frames": ["0000", "0001", "0002"],
        "test_frames": ["0003"], "conventions": {"image": "8-bit, over black"}})");
    flaw(tiny.folder, folder.path / "noisy", 0, [](FlawOptions& o) {
        o.sizes[Flaw::noise] = 20;
        o.sizes[Flaw::blur] = 2;
    });
    const Image8 mask = read_image8(tiny.image(1, 1, "mask"));
    const Image8 now = read_image8(folder.path / "noisy" / "images" / "0001" / "image_c1.png");
    for (std::size_t i = 0; i < mask.values.size(); ++i)
        if (mask.values[i] == 0) CHECK(now.values[3 * i] == 0);
    flaw(tiny.folder, folder.path / "soft", 0,
         [](FlawOptions& o) { o.sizes[Flaw::soft_masks] = 2; });
    CHECK(changed(tiny.folder, folder.path / "soft") == std::set<std::string>{"image", "mask"});
    CHECK(changed(tiny.folder, folder.path / "soft", "0003/").empty());
    const Image8 a = read_image8(tiny.image(1, 1));
    const Image8 cut = read_image8(folder.path / "soft" / "images" / "0001" / "image_c1.png");
    const Image8 soft = read_image8(folder.path / "soft" / "images" / "0001" / "mask_c1.png");
    for (std::size_t i = 0; i < soft.values.size(); ++i)
        CHECK(std::abs(cut.values[3 * i] - a.values[3 * i] * soft.values[i] / 255.0) <= 0.51);
}

TEST_CASE("flaw: views and cameras that are left out") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    int left_out = 0;
    for (int seed = 0; seed < seeds; ++seed) {
        const fs::path out = folder.path / std::to_string(seed);
        const FlawReport report = flaw(tiny.folder, out, static_cast<std::uint64_t>(seed),
                                       [](FlawOptions& o) { o.sizes[Flaw::drop_views] = 0.25; });
        const Capture c = read_valid_capture(out);
        int present = 0;
        for (int f = 0; f < 3; ++f)
            for (int k = 0; k < 3; ++k) present += c.view(f, k).present ? 1 : 0;
        CHECK(report.views_left_out == 9 - present);
        CHECK(report.views == 12 - report.views_left_out);
        CHECK(contents(out).size() == 1 + contents(tiny.folder).size() -
                                          4 * static_cast<std::size_t>(report.views_left_out));
        CHECK(changed(tiny.folder, out, "0003/").empty());
        left_out += report.views_left_out;
    }
    const double n = 9.0 * seeds;
    CHECK(std::abs(left_out / n - 0.25) < 4.5 * std::sqrt(0.25 * 0.75 / n));
    // All of them but one a frame.
    flaw(tiny.folder, folder.path / "most", 0,
         [](FlawOptions& o) { o.sizes[Flaw::drop_views] = 1; });
    const Capture most = read_valid_capture(folder.path / "most");
    CHECK(most.camera_count() == 3);
    CHECK(judge(most, {}).text() == "usable");

    tiny.write_text("capture.json", R"({"train_frames": ["0000", "0001", "0002"],
        "test_frames": ["0003"], "camera_ids": ["c0", "c1", "c2"], "cameras": [{"id": "c0"},
        {"id": "c1"}, {"id": "c2"}], "checksum": "old"})");
    flaw(tiny.folder, folder.path / "one", 0, [](FlawOptions& o) { o.one_camera = "c1"; });
    const Capture one = read_valid_capture(folder.path / "one");
    CHECK(one.camera_ids == std::vector<std::string>{"c1"});
    CHECK(one.frame_count() == 4);
    const auto json = read_json(folder.path / "one" / "capture.json");
    CHECK(json.at("cameras").size() == 1);
    CHECK(changed_files(folder.path / "one").empty());
    CHECK(read_json(folder.path / "one" / "flaws.json").at("flaws").at("one-camera").at("camera") ==
          "c1");
    for (const auto& [name, bytes] : contents(folder.path / "one"))
        CHECK((name.find("_c") == std::string::npos || name.find("_c1") != std::string::npos));
}

TEST_CASE("flaw: one seed gives one copy, and no flaw changes another's numbers") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    const Set all = [](FlawOptions& o) {
        o.sizes.values = {4, 2, 1.2, 0.06, 0.6, 1,  1.5, 0.2, 3, 2,  12,
                          5, 8, 10,  1,    3,   60, 1,   1,   1, 0.2};
        o.expression_share = 0.5;
    };
    set_threads(1);
    flaw(tiny.folder, folder.path / "a", 7, all);
    set_threads(4);
    flaw(tiny.folder, folder.path / "b", 7, all);
    set_threads(0);
    flaw(tiny.folder, folder.path / "c", 8, all);
    CHECK(contents(folder.path / "a") == contents(folder.path / "b"));
    for (const char* name : {"gaze.npz", "params.npz", "lmk_3d.npy", "camera", "mask", "image"})
        CHECK(changed(folder.path / "a", folder.path / "c").contains(name));
    // Landmarks, cameras and centres of one alone are those among all.
    flaw(tiny.folder, folder.path / "alone", 7, [](FlawOptions& o) {
        o.sizes[Flaw::landmarks] = 1.5;
        o.sizes[Flaw::centres] = 1.2;
        o.sizes[Flaw::focal] = 2;
    });
    const Capture a = read_capture(folder.path / "a"), alone = read_capture(folder.path / "alone");
    for (std::size_t f = 0; f < 4; ++f) {
        CHECK(a.frames[f].landmarks == alone.frames[f].landmarks);
        CHECK(*a.frames[f].eyes[1].centre == *alone.frames[f].eyes[1].centre);
    }
    for (int f = 0; f < 4; ++f)
        for (int c = 0; c < 3; ++c)
            if (a.view(f, c).present) CHECK(a.camera(f, c).fx == alone.camera(f, c).fx);
    // A flaw of a flawed capture remembers what was there.
    flaw(folder.path / "alone", folder.path / "again", 1,
         [](FlawOptions& o) { o.sizes[Flaw::gain] = 5; });
    const auto record = read_json(folder.path / "again" / "flaws.json");
    CHECK(record.at("before").at("flaws").at("landmarks").at("size") == 1.5);
    CHECK(record.at("flaws").at("gain").at("rms").get<double>() > 0);
    CHECK(record.at("flaws").at("gain").at("count") == 3);
    CHECK(record.at("seed") == 1);
}

TEST_CASE("flaw: the capture's unit, and checksums of its arrays") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    nlohmann::ordered_json description{{"train_frames", {"0000", "0001", "0002"}},
                                       {"test_frames", {"0003"}},
                                       {"checksums", array_checksums(tiny.folder)}};
    tiny.write_text("capture.json", checked_text(description, 1));
    const Set set = [](FlawOptions& o) { o.sizes[Flaw::landmarks] = 1; };
    flaw(tiny.folder, folder.path / "a", 0, set);
    CHECK(changed_files(folder.path / "a").empty());
    description["unit_mm"] = 50;
    tiny.write_text("capture.json", checked_text(description, 1));
    flaw(tiny.folder, folder.path / "b", 0, set);
    const auto moved = [&](const char* name) {
        return (read_capture(folder.path / name).frames[0].landmarks -
                read_capture(tiny.folder).frames[0].landmarks)
            .norm();
    };
    CHECK(moved("b") == doctest::Approx(2 * moved("a")).epsilon(1e-4));
    description["unit_mm"] = -1;
    tiny.write_text("capture.json", checked_text(description, 1));
    CHECK_FAULT(flaw(tiny.folder, folder.path / "c", 0, set), "unit_mm: got -1, expected > 0");
}

TEST_CASE("flaw: what is refused leaves nothing behind") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    const fs::path out = folder.path / "out";
    const Set set = [](FlawOptions& o) { o.sizes[Flaw::gaze_common] = 4; };
    CHECK_FAULT(flaw(tiny.folder, out, 0, [](FlawOptions&) {}), "no flaw is asked for");
    CHECK_FAULT(flaw(tiny.folder, out, 0, [](FlawOptions& o) { o.one_camera = "c9"; }),
                "--one-camera: got 'c9', expected one of: c0 c1 c2");
    CHECK_FAULT(flaw(tiny.folder, tiny.folder / "out", 0, set), "inside the capture");
    CHECK_FAULT(flaw(tiny.folder, tiny.folder, 0, set), "which exists already");
    // Eyeballs far from their lids.
    CHECK_FAULT(flaw(tiny.folder, out, 0, [](FlawOptions& o) { o.sizes[Flaw::centres] = 50; }),
                (out / "params").string());
    TinyCapture::remove(tiny.params(1, "gaze.npz"), "eye_center_left");
    CHECK_FAULT(flaw(tiny.folder, out, 0, [](FlawOptions& o) { o.sizes[Flaw::centres] = 1; }),
                "--centres: ");
    fs::remove(tiny.params(1, "gaze.npz"));
    CHECK_FAULT(flaw(tiny.folder, out, 0, set), "--gaze-common: ");
    fs::remove(tiny.image(2, 1, "eye_mask"));
    CHECK_FAULT(
        flaw(tiny.folder, out, 0, [](FlawOptions& o) { o.sizes[Flaw::eye_mask_dilation] = 1; }),
        "--eye-mask-dilation: ");
    fs::remove(tiny.params(0, "params.npz"));
    CHECK_FAULT(flaw(tiny.folder, out, 0, set), "params.npz");
    CHECK(files_in(folder.path) == 1); // the capture
}

TEST_CASE("flaw: command lines") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    const auto says = [&](const std::vector<std::string>& words, const std::string& sentence) {
        std::vector<std::string> line{"flaw", "--capture", tiny.folder.string(), "--out",
                                      (folder.path / "out").string()};
        line.insert(line.end(), words.begin(), words.end());
        const Answer a = answer(line);
        INFO(a.text);
        CHECK(a.code == 2);
        CHECK(a.text.find("rye flaw: " + sentence) != std::string::npos);
        CHECK(files_in(folder.path) == 1);
    };
    says({"--gaze-common", "-1"}, "--gaze-common: got -1, expected 0 to 45");
    says({"--gaze-single", "50"}, "--gaze-single: got 50, expected 0 to 45");
    says({"--expression-share", "0.5"}, "--expression-share requires --expression");
    says({"--expression", "1", "--expression-share", "1.5"},
         "--expression-share: got 1.5, expected 0 to 1");
    says({"--pose", "1"}, "--pose: got too few values, expected 2");
    says({"--pose", "1,-2"}, "--pose: got -2, expected 0 to 90");
    says({"--landmarks", "much"}, "--landmarks: got 'much', expected a number");
    says({"--jpeg", "0"}, "--jpeg: got 0, expected 1 to 100");
    says({"--drop-views", "2"}, "--drop-views: got 2, expected 0 to 1");
    says({"--gain", "nan"}, "--gain: got 'nan', expected a finite number");
    says({"--labels", "tets", "--gain", "1"}, "--labels: got 'tets', expected train or all");
    says({"--seed", "-1", "--gain", "1"}, "--seed: got '-1', expected a whole number");
    says({}, "no flaw is asked for");
    says({"--gaze", "1"}, "--gaze is no option");
    CHECK(answer({"flaw", "--capture", tiny.folder.string(), "--out", (folder.path / "out").string(),
                  "--pose", "0.6,1", "--jpeg", "75", "--quiet", "--seed", "3"})
              .code == 0);
    const auto flaws = read_json(folder.path / "out" / "flaws.json").at("flaws");
    CHECK(flaws.at("pose-rotation").at("size") == 0.6);
    CHECK(flaws.at("pose-position").at("size") == 1);
    CHECK(flaws.at("pose-rotation").at("frames") == "train");
    CHECK(flaws.at("jpeg").at("size") == 75);
    CHECK(flaws.at("jpeg").at("frames") == "all");
}
