// SPDX-License-Identifier: Apache-2.0
/// Consistency of the synthetic capture with its labels. The ICT head is tested if RYE_DATA names a
/// folder with ict/ict_light.npz; the test passes if it is unset.
#include "../support/real_data.hpp"
#include "synthetic_capture/scene.hpp"

#include <unistd.h>

#include <cmath>
#include <fstream>
#include <set>

#include <doctest/doctest.h>

#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "../programs/command_line.hpp"
#include "data/capture.hpp"
#include "data/threads.hpp"
#include "data/validate.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;
using V3 = Vec3<double>;

namespace {

constexpr double degree = 0.017453292519943295;

const HeadModel& head() {
    static const HeadModel model = procedural_head(1); // of this test program only
    return model;
}

struct Folder {
    fs::path path = fs::temp_directory_path() / ("rye_capture_" + std::to_string(::getpid()));
    Folder() {
        fs::remove_all(path);
        fs::create_directories(path);
    }
    ~Folder() { fs::remove_all(path); }
};

HeadState looking(const HeadModel& model, const Vec2<double>& left, const Vec2<double>& right) {
    HeadState s;
    s.expression = VecX<double>::Zero(static_cast<Index>(model.expression_names.size()));
    s.lids = lid_coefficients({left, right});
    s.optical = {gaze_vector(left.y() * degree, left.x() * degree),
                 gaze_vector(right.y() * degree, right.x() * degree)};
    return s;
}

/// Middle of a lid's edge above the line between the corners, of eye 0 or 1.
double opening(const HeadModel& model, const Points& vertices, int eye, bool upper) {
    const int first = eye == 0 ? 42 : 36;
    const auto y = [&](int i) {
        return vertices(1, model.landmarks[static_cast<std::size_t>(first + i)]);
    };
    return (upper ? y(1) + y(2) : y(4) + y(5)) / 2 - (y(0) + y(3)) / 2;
}

} // namespace

TEST_CASE("scene: splits, held-out gazes, kappa and targets are what the labels say") {
    for (const std::uint64_t seed : {1ULL, 2ULL, 3ULL}) {
        CaptureSettings settings;
        settings.train_frames = 150;
        settings.novel_frames = 40;
        settings.independent_frames = 5;
        settings.seed = seed;
        const CaptureScene scene = capture_scene(head(), settings);
        REQUIRE(scene.frames.size() == 195);
        const SceneFrame& first = scene.frames.front();
        CHECK(first.fixation_deg->norm() == 0);
        CHECK(first.pose.norm() == 0);
        CHECK(first.state.expression.norm() == 0);
        std::set<std::string> ids;
        for (const SceneFrame& f : scene.frames) {
            ids.insert(f.id);
            const auto contains = [&](const GazeCell& c) {
                return f.fixation_deg && c.contains(*f.fixation_deg);
            };
            const bool held_out =
                std::any_of(scene.held_out.begin(), scene.held_out.end(), contains);
            CHECK(held_out == (f.kind == FrameKind::novel));
            CHECK(f.target.has_value() == (f.kind != FrameKind::independent));
            CHECK(f.state.expression.minCoeff() >= 0);
            CHECK(f.state.expression.maxCoeff() <= 1);
            for (std::size_t e = 0; e < 2; ++e) {
                // apply_kappa is the toolkit's own definition.
                const KappaAngles<double> kappa{scene.kappa_deg[e].y() * degree,
                                          scene.kappa_deg[e].x() * degree};
                CHECK(angular_error(apply_kappa(f.visual[e], kappa), f.state.optical[e]) < 1e-12);
                if (!f.target) continue;
                const V3 centre = f.state.world_from_head.apply(head().eyes[e].centre);
                const V3 sight = f.state.world_from_head.turn(f.visual[e]);
                CHECK(angular_error(V3(*f.target - centre), sight) < 1e-12);
            }
            if (f.kind == FrameKind::independent)
                CHECK(angular_error(f.state.optical[0], f.state.optical[1]) > 1 * degree);
        }
        CHECK(ids.size() == scene.frames.size());
    }
}

TEST_CASE("scene: gazes that are asked for follow the other frames, which stay as they are") {
    CaptureSettings settings;
    settings.train_frames = 2;
    settings.novel_frames = 1;
    settings.independent_frames = 1;
    const CaptureScene without = capture_scene(head(), settings);
    settings.gazes = {{0, 35}, {-40, -30}};
    const CaptureScene scene = capture_scene(head(), settings);
    REQUIRE(scene.frames.size() == 6);
    for (std::size_t i = 0; i < without.frames.size(); ++i) {
        CHECK(scene.frames[i].id == without.frames[i].id);
        CHECK(scene.frames[i].pose == without.frames[i].pose);
        CHECK(scene.frames[i].optical_deg == without.frames[i].optical_deg);
    }
    for (std::size_t i = 0; i < 2; ++i) {
        const SceneFrame& f = scene.frames[4 + i];
        CHECK(f.id == "000" + std::to_string(4 + i));
        CHECK(f.kind == FrameKind::novel);
        CHECK(f.pose.norm() == 0);
        CHECK(f.state.expression.norm() == 0);
        CHECK(*f.fixation_deg == settings.gazes[i]);
        const Vec2<double> both = 0.5 * (f.optical_deg[0] + f.optical_deg[1]);
        CHECK((both - settings.gazes[i]).norm() < 3); // kappa and vergence are less
    }
}

TEST_CASE("scene: settings that make no capture are refused by name") {
    const auto message = [](const CaptureSettings& s) {
        try {
            capture_scene(head(), s);
        } catch (const Error& e) {
            return std::string(e.what());
        }
        return std::string();
    };
    CHECK(message({.size = 33}).find("even") != std::string::npos);
    CHECK(message({.size = 8}).find("image size") != std::string::npos);
    CHECK(message({.cameras = 19}).find("1 to 18") != std::string::npos);
    CHECK(message({.gazes = {{56, 0}}}).find("got 56,0 for a gaze's yaw and pitch") !=
          std::string::npos);
    CHECK(message({.gazes = {{0, std::nan("")}}}).find("at most 55 and 45") != std::string::npos);
    CHECK(message({.gazes = std::vector<Vec2<double>>(101)}).find("at most 100") !=
          std::string::npos);
    CHECK(message({.train_frames = 0}).find("training frames") != std::string::npos);
    CHECK(message({.samples = 0}).find("samples") != std::string::npos);
    CHECK(message({}).empty());
}

TEST_CASE("head: the lids follow the gaze, meet in a blink, and leave the expression alone") {
    const HeadModel& m = head();
    const auto vertices = [&](double pitch, const std::string& name, double weight) {
        HeadState s = looking(m, {0, pitch}, {0, pitch});
        for (std::size_t i = 0; i < m.expression_names.size(); ++i)
            if (m.expression_names[i].starts_with(name) && weight > 0)
                s.expression[static_cast<Index>(i)] = weight;
        return m.vertices(s.expression, s.lids);
    };
    for (const int eye : {0, 1}) {
        double last = 1e9;
        for (const double pitch : {20.0, 10.0, 0.0, -10.0, -20.0}) {
            const Points v = vertices(pitch, "", 0);
            const double upper = opening(m, v, eye, true);
            CHECK(upper < last - 0.005); // monotonically lower
            CHECK(upper > opening(m, v, eye, false) + 0.02);
            last = upper;
        }
        CHECK(opening(m, vertices(-20, "", 0), eye, false) <
              opening(m, vertices(0, "", 0), eye, false));
        const Points shut = vertices(0, "eyeBlink", 1.0);
        CHECK(std::abs(opening(m, shut, eye, true) - opening(m, shut, eye, false)) < 0.01);
        CHECK(opening(m, vertices(0, "eyeWide", 1.0), eye, true) >
              opening(m, vertices(0, "", 0), eye, true));
    }
    // Only the one eye's lids.
    const Points one = vertices(0, "eyeBlink_L", 1.0);
    CHECK(opening(m, one, 0, true) < 0.01);
    CHECK(opening(m, one, 1, true) > 0.03);
}

TEST_CASE("head: landmarks are where iBUG has them, left is left, and sides are alike") {
    const HeadModel& m = head();
    const Points v = m.vertices(VecX<double>::Zero(static_cast<Index>(m.expression_names.size())),
                                VecX<double>::Zero(8));
    CHECK(v.allFinite());
    const auto mark = [&](int i) { return V3(v.col(m.landmarks[static_cast<std::size_t>(i)])); };
    CHECK(std::set<Index>(m.landmarks.begin(), m.landmarks.end()).size() == 68);
    CHECK(mark(36).x() < mark(39).x());
    CHECK(mark(39).x() < mark(42).x());
    CHECK(mark(42).x() < mark(45).x());
    CHECK(mark(8).y() < mark(57).y());
    CHECK(mark(57).y() < mark(51).y());
    CHECK(mark(51).y() < mark(30).y());
    CHECK(mark(30).z() > mark(27).z());
    const double face = (mark(27) - mark(8)).norm();
    CHECK(face > 1.0);
    CHECK(face < 1.25);
    for (const auto& [r, l] :
         {std::pair{0, 16}, {17, 26}, {36, 45}, {37, 44}, {41, 46}, {48, 54}, {31, 35}})
        CHECK((mark(r) - V3(-1, 1, 1).cwiseProduct(mark(l))).norm() < 1e-6);
    for (std::size_t e = 0; e < 2; ++e) {
        const V3 between = 0.5 * (mark(e == 0 ? 42 : 36) + mark(e == 0 ? 45 : 39));
        CHECK((between - m.eyes[e].centre).head<2>().norm() < 0.05);
    }
}

TEST_CASE("head: no vertex stays inside an eyeball, and the cornea bulges") {
    const HeadModel& m = head();
    CHECK(m.eyes[0].surface(0) > 1.05 * m.eyes[0].radius);
    CHECK(std::abs(m.eyes[0].surface(std::asin(m.eyes[0].limbus_radius / m.eyes[0].radius)) -
                   m.eyes[0].radius) < 1e-12);
    const HeadState s = looking(m, {25, -15}, {-20, 10});
    Points v = m.vertices(s.expression, s.lids);
    const Points before = v;
    clear_eyeballs(v, m.eyes, s.optical, 0.01);
    CHECK((v - before).norm() > 0);
    int near = 0;
    for (Index i = 0; i < v.cols(); ++i)
        for (std::size_t e = 0; e < 2; ++e) {
            const V3 arm = V3(v.col(i)) - m.eyes[e].centre;
            if (arm.dot(s.optical[e]) <= 0) continue;
            const double angle = angular_error(arm, s.optical[e]);
            CHECK(arm.norm() > m.eyes[e].surface(angle) + 0.0099);
            near += arm.norm() < 1.3 * m.eyes[e].radius ? 1 : 0;
        }
    CHECK(near > 100);
}

TEST_CASE("pictures: eye masks lie on the eyeballs, and the pupils where the gaze says") {
    const HeadModel& m = head();
    for (const auto& [left, right] : {std::pair{Vec2<double>(0, 0), Vec2<double>(0, 0)},
                                      std::pair{Vec2<double>(20, -10), Vec2<double>(12, -10)},
                                      std::pair{Vec2<double>(-15, 10), Vec2<double>(14, 0)}}) {
        HeadState state = looking(m, left, right);
        state.world_from_head.rotation =
            quat_matrix(shortest_arc(V3(0, 0, 1), normalized(V3(0.1, 0.06, 1))));
        state.world_from_head.translation = V3(0.05, -0.04, 0.06);
        const PosedHead posed(m, state);
        for (std::size_t e = 0; e < 2; ++e) {
            const V3 centre = state.world_from_head.apply(m.eyes[e].centre);
            const V3 gaze = state.world_from_head.turn(state.optical[e]);
            CHECK((posed.eye_centres()[e] - centre).norm() < 1e-12);
            const V3 from = centre + V3(e == 0 ? 1 : -1, 0.3, 10);
            Pinhole<double> camera = look_at<double>(from, centre, V3(0, 1, 0), 0.05, {96, 96});
            const HeadPicture p = posed.picture(camera, 4);
            const auto label = [&](int x, int y) {
                return static_cast<int>(p.eye[static_cast<std::size_t>(96 * y + x)]);
            };
            // Every labelled pixel's ray meets the eyeball of that label, enlarged by a tenth for
            // the cornea.
            int count = 0;
            for (int y = 0; y < 96; ++y)
                for (int x = 0; x < 96; ++x) {
                    if (label(x, y) == 0) continue;
                    CHECK(label(x, y) == static_cast<int>(e) + 1);
                    const V3 arm = centre - from, ray = camera.ray({x + 0.5, y + 0.5});
                    CHECK(norm(cross(arm, ray)) < 1.1 * m.eyes[e].radius);
                    ++count;
                }
            CHECK(count > 500);
            // The iris disc: its middle is labelled and black, its rim is labelled away from the
            // lids.
            const V3 iris = centre + m.eyes[e].iris_plane() * gaze;
            const V3 at = camera.project_point(iris);
            const int x = static_cast<int>(at.x()), y = static_cast<int>(at.y());
            CHECK(label(x, y) == static_cast<int>(e) + 1);
            const auto grey = [&](double u, double v) {
                return p.image.at(static_cast<int>(u), static_cast<int>(v)).sum() / 3;
            };
            const double rim = m.eyes[e].limbus_radius * camera.fx / at.z();
            // Dark within the pupil except for the softbox's reflection, bright on the white beside
            // it.
            double darkest = 1;
            for (int dx = -3; dx <= 3; ++dx)
                darkest = std::min<double>(darkest, grey(x + dx, y + 2));
            CHECK(darkest < 0.2);
            double white = 0;
            for (const double side : {-1.45, 1.45}) {
                const double u = at.x() + side * rim;
                if (label(static_cast<int>(u), y) != 0) white = std::max<double>(white, grey(u, y));
            }
            CHECK(white > darkest + 0.25);
        }
    }
}

TEST_CASE("pictures: rays of few samples lie evenly around a pixel's middle") {
    const HeadModel& m = head();
    const HeadState state = looking(m, {0, 0}, {0, 0});
    const Pinhole<double> camera =
        look_at<double>(V3(3, 1, 9.5), head_centre, V3(0, 1, 0), 0.36, {96, 96});
    const PosedHead posed(m, state);
    const auto middle = [&](int samples) { // of the head's area [px]
        const Image<float> mask = posed.picture(camera, samples).mask;
        Vec2<double> sum = Vec2<double>::Zero();
        for (int y = 0; y < 96; ++y)
            for (int x = 0; x < 96; ++x) sum += mask.at(x, y)[0] * Vec2<double>(x, y);
        return Vec2<double>(sum / mask.pixels.sum());
    };
    const Vec2<double> exact = middle(128);
    for (const int samples : {4, 8}) {
        CAPTURE(samples);
        CHECK((middle(samples) - exact).norm() < 0.02);
    }
}

TEST_CASE("pictures: the same bits on one thread and on two, from the seed on") {
    set_threads(1);
    const HeadModel one = procedural_head(7);
    const HeadState state = looking(one, {10, -5}, {6, -5});
    const Pinhole<double> camera =
        look_at<double>(V3(3, 1, 9.5), head_centre, V3(0, 1, 0), 0.28, {48, 48});
    const HeadPicture a = PosedHead(one, state).picture(camera, 4);
    set_threads(2);
    const HeadModel two = procedural_head(7);
    const HeadPicture b = PosedHead(two, state).picture(camera, 4);
    CHECK(one.albedo.pixels == two.albedo.pixels);
    CHECK(a.image.pixels == b.image.pixels);
    CHECK(a.mask.pixels == b.mask.pixels);
    CHECK(a.eye == b.eye);
    CHECK(a.mask.pixels.maxCoeff() == 1.0f);
    CHECK(a.mask.pixels.minCoeff() == 0.0f);
    // Premultiplied: black outside the mask.
    for (Index i = 0; i < a.mask.size(); ++i)
        CHECK(a.image.pixels.col(i).maxCoeff() <= a.mask.pixels(0, i));
    // Another seed is another subject.
    CHECK(one.identity != head().identity);
    CHECK(one.albedo.pixels != head().albedo.pixels);
}

TEST_CASE("files: what is written is read back, valid, with the labels that were made") {
    const Folder folder;
    const CaptureSettings settings{.size = 64,
                                   .cameras = 4,
                                   .train_frames = 2,
                                   .novel_frames = 1,
                                   .independent_frames = 1,
                                   .samples = 4};
    const CaptureScene scene = capture_scene(head(), settings);
    int told = 0;
    write_capture(head(), scene, folder.path / "made", [&](int done, int of) {
        CHECK(done == ++told);
        CHECK(of == 4);
    });
    std::vector<Problem> warnings;
    const Capture c = read_valid_capture(folder.path / "made", {}, &warnings);
    CHECK(warnings.empty());
    CHECK(c.images_over_black);
    CHECK(c.has_eye_masks);
    CHECK(c.has_gaze());
    CHECK(c.has_centres());
    CHECK(c.train == std::vector<int>{0, 1});
    CHECK(c.test == std::vector<int>{2, 3});
    CHECK(c.novel_gaze == std::vector<int>{2});
    CHECK(c.independent_gaze == std::vector<int>{3});
    CHECK(c.expression_names == head().expression_names);
    for (std::size_t f = 0; f < 4; ++f) {
        const SceneFrame& made = scene.frames[f];
        const CaptureFrame& read = c.frames[f];
        CHECK((read.pose - made.pose).cwiseAbs().maxCoeff() < 1e-7);
        for (std::size_t e = 0; e < 2; ++e) {
            CHECK((read.eyes[e].optical - made.state.optical[e]).norm() == 0);
            CHECK((*read.eyes[e].visual - made.visual[e]).norm() == 0);
            const V3 centre = made.state.world_from_head.apply(head().eyes[e].centre);
            CHECK((*read.eyes[e].centre - centre).norm() < 1e-12);
            CHECK(*read.eyes[e].iris_plane == head().eyes[e].iris_plane());
        }
        CHECK(read.landmarks.cols() == 66);
        CHECK(read.vertices.cols() == static_cast<Index>(head().dense.size()));
    }
    const PosedHead posed(head(), scene.frames[1].state);
    const HeadPicture p = posed.picture(scene.cameras[2].camera, settings.samples);
    CHECK((c.mask(1, 2).pixels - p.mask.pixels).cwiseAbs().maxCoeff() < 0.502f / 255);
    CHECK((c.image(1, 2).pixels - p.image.pixels).cwiseAbs().mean() < 0.01f); // JPEG loss
    const Image<float> eyes = c.eye_mask(1, 2);
    for (Index i = 0; i < eyes.size(); ++i)
        for (Index e = 0; e < 2; ++e)
            CHECK(eyes.pixels(e, i) == (p.eye[static_cast<std::size_t>(i)] == e + 1 ? 1.0f : 0.0f));
    CHECK((c.camera(1, 2).camera_from_world.rotation -
           scene.cameras[2].camera.camera_from_world.rotation)
              .norm() == 0);
}

TEST_CASE("command: writes once, overwrites captures only, and leaves nothing half-done") {
    const Folder folder;
    const fs::path out = folder.path / "made";
    std::vector<std::string> line{"capture", "--out",         out.string(), "--frames",
                                  "1",       "--test-frames", "0",          "--apart-frames",
                                  "0",       "--cameras",     "1",          "--size",
                                  "32",      "--samples",     "1",          "--quiet"};
    CHECK(answer(line).text == "");
    CHECK(fs::exists(out / "capture.json"));
    CHECK(fs::exists(out / "images" / "0000" / "image_00.jpg"));
    CHECK_FALSE(fs::exists(folder.path / "made.tmp"));
    const auto before = fs::last_write_time(out / "capture.json");
    CHECK(answer(line).text.find("--overwrite") != std::string::npos);
    CHECK(fs::last_write_time(out / "capture.json") == before);

    line.push_back("--overwrite");
    fs::remove(out / "capture.json"); // no longer recognisable as a capture
    CHECK(answer(line).text.find("no capture") != std::string::npos);
    CHECK(fs::exists(out / "images"));

    std::vector<std::string> missing{"capture",
                                     "--out",
                                     (folder.path / "b").string(),
                                     "--model",
                                     (folder.path / "nothing.npz").string(),
                                     "--quiet"};
    CHECK(answer(missing).text.find("nothing.npz") != std::string::npos);
    std::ofstream(folder.path / "alone.npz");
    missing[4] = (folder.path / "alone.npz").string();
    CHECK(answer(missing).text.find("names.json: no such file, expected the names") !=
          std::string::npos);
    CHECK_FALSE(fs::exists(folder.path / "b"));
    CHECK_FALSE(fs::exists(folder.path / "b.tmp"));
}

TEST_CASE("ICT head: its landmarks, eyes and expressions, and lids that follow the gaze") {
    const auto pack = test::real_data("ict/ict_light.npz");
    if (!pack) return;
    const HeadModel m = ict_head(*pack, 5);
    CHECK(m.expression_names.size() == 45);
    CHECK(m.identity.size() == 10);
    for (std::size_t e = 0; e < 2; ++e) {
        CHECK(std::abs(std::abs(m.eyes[e].centre.x()) - 0.32) < 0.03);
        CHECK((e == 0) == (m.eyes[e].centre.x() > 0));
        CHECK(std::abs(m.eyes[e].radius - 0.156) < 0.012);
        CHECK(std::abs(m.eyes[e].surface(0) / m.eyes[e].radius - 1.746 / 1.557) < 0.01);
    }
    const auto vertices = [&](double pitch) {
        const HeadState s = looking(m, {0, pitch}, {0, pitch});
        return m.vertices(s.expression, s.lids);
    };
    for (const int eye : {0, 1})
        CHECK(opening(m, vertices(-20), eye, true) < opening(m, vertices(15), eye, true) - 0.02);
    const PosedHead posed(m, looking(m, {0, 0}, {0, 0}));
    const Pinhole<double> camera =
        look_at<double>(V3(0, 0.35, 11), m.eyes[0].centre, V3(0, 1, 0), 0.05, {64, 64});
    const HeadPicture p = posed.picture(camera, 1);
    const V3 at = camera.project_point(V3(m.eyes[0].centre + m.eyes[0].iris_plane() * V3(0, 0, 1)));
    CHECK(
        p.eye[static_cast<std::size_t>(64 * static_cast<int>(at.y()) + static_cast<int>(at.x()))] ==
        1);
}
