// SPDX-License-Identifier: Apache-2.0
/// MakeHuman's files and the head model made of them. The base mesh and targets are tested if
/// RYE_DATA names a folder with makehuman/; that test passes if it is unset.
#include "../support/real_data.hpp"
#include "synthetic_capture/makehuman_pack.hpp"
#include "synthetic_capture/scene.hpp"
#include "synthetic_capture/subdivision.hpp"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <fstream>

#include <doctest/doctest.h>

#include <rye/io/gzip.hpp>
#include <rye/core/error.hpp>
#include <rye/rig/gaze.hpp>

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;
using V3 = Vec3<double>;

namespace {

/// The surface of a unit cube, whose texture is one square; the last face is a group of its own.
const std::string cube =
    "# a cube\n"
    "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
    "v 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n"
    "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    "g body\n"
    "f 4/1 3/2 2/3 1/4\nf 5/1 6/2 7/3 8/4\nf 1/1 2/2 6/3 5/4\n"
    "f 3/1 4/2 8/3 7/4\nf 2/1 3/2 7/3 6/4\r\n"
    "g helper-side\nf 1/1 5/2 8/3 4/4\n";

template <class F>
std::string error_of(F&& f) {
    try {
        f();
    } catch (const Error& e) {
        return e.what();
    }
    return "";
}

std::string said_of_mesh(const std::string& text) {
    return error_of([&] { parse_quads(text, "base.obj"); });
}
std::string said_of_target(const std::string& text) {
    return error_of([&] { parse_target(text, 8, "a.target"); });
}

struct Folder {
    fs::path path = fs::temp_directory_path() / ("rye_makehuman_" + std::to_string(::getpid()));
    Folder() {
        fs::remove_all(path);
        fs::create_directories(path);
    }
    ~Folder() { fs::remove_all(path); }
};

HeadState looking(const HeadModel& m, double pitch_deg) {
    constexpr double degree = 0.017453292519943295;
    HeadState s;
    s.expression = VecX<double>::Zero(static_cast<Index>(m.expression_names.size()));
    s.lids = lid_coefficients({Vec2<double>(0, pitch_deg), Vec2<double>(0, pitch_deg)});
    s.optical.fill(gaze_vector(pitch_deg * degree, 0.0));
    return s;
}

/// Height of the opening between the lids of an eye: the middles of their edges.
double opening(const HeadModel& m, const Points& vertices, int eye) {
    const auto y = [&](int i) {
        return vertices(1, m.landmarks[static_cast<std::size_t>((eye == 0 ? 42 : 36) + i)]);
    };
    return (y(1) + y(2) - y(4) - y(5)) / 2;
}

} // namespace

TEST_CASE("MakeHuman's files: vertices, faces, groups and displacements are read") {
    const QuadMesh mesh = parse_quads(cube, "base.obj");
    CHECK(mesh.vertices.cols() == 8);
    CHECK(V3(mesh.vertices.col(6)) == V3(1, 1, 1));
    CHECK(mesh.uv.cols() == 4);
    REQUIRE(mesh.faces.size() == 6);
    CHECK(mesh.faces[4].vertex == std::array<Index, 4>{1, 2, 6, 5});
    CHECK(mesh.faces[4].uv == std::array<Index, 4>{0, 1, 2, 3});
    CHECK(mesh.groups == std::vector<std::string>{"body", "helper-side"});
    CHECK(mesh.group == std::vector<std::size_t>{0, 0, 0, 0, 0, 1});
    const Points moved = parse_target("# made\n\n3 0 -.5 1e-1\r\n7 1 2 3\n", 8, "a.target");
    CHECK(V3(moved.col(3)) == V3(0, -0.5, 0.1));
    CHECK(V3(moved.col(7)) == V3(1, 2, 3));
    CHECK(moved.col(0).isZero(0));
}

TEST_CASE("MakeHuman's files: errors name file, line and value") {
    CHECK(said_of_mesh("v 0 0 0\nv 0 x1 0\n") ==
          "base.obj: line 2: got the coordinate 'x1', expected a finite number");
    CHECK(said_of_mesh("v 0 0\n") ==
          "base.obj: line 1: got the coordinate '', expected a finite number");
    CHECK(said_of_mesh("v 0 0 inf\n").find("line 1: got the coordinate 'inf'") !=
          std::string::npos);
    CHECK(said_of_mesh(cube + "f 1/1 2/1 9/1 3/1\n") ==
          "base.obj: line 22: got the vertex '9', expected 1 to 8");
    CHECK(said_of_mesh(cube + "f 1/1 2/5 3/1 4/1\n") ==
          "base.obj: line 22: got the texture coordinate '5', expected 1 to 4");
    CHECK(said_of_mesh(cube + "f 1/1 2/1 3/1\n") ==
          "base.obj: line 22: got a face of 3 corners, expected 4");
    CHECK(said_of_mesh(cube + "f 1 2 3 4\n").find("line 22: got the corner '1'") !=
          std::string::npos);
    CHECK(said_of_mesh("").find("base.obj: has no faces") == 0);
    CHECK(said_of_target("0 0 0 0\n8 1 1 1\n") ==
          "a.target: line 2: got the vertex '8', expected 0 to 7");
    CHECK(said_of_target("1 0 nan 0\n") ==
          "a.target: line 1: got the displacement 'nan', expected a finite number");
    CHECK(said_of_target("1 0 0\n").find("line 1: got the displacement ''") != std::string::npos);
    CHECK(said_of_target("1 0 0 0 0\n").find("line 1: got more than") != std::string::npos);

    const Folder folder;
    const auto said = [&] { return error_of([&] { pack_makehuman(folder.path); }); };
    CHECK(said().find("base.obj: no such file") != std::string::npos);
    std::ofstream(folder.path / "base.obj") << cube;
    CHECK(said().find("base.obj: got 8 vertices, expected the 19158") != std::string::npos);
}

TEST_CASE("MakeHuman's files: plain or as gzip") {
    const Folder folder;
    const Bytes packed = gzip_bytes(as_bytes(cube));
    write_atomic(folder.path / "base.obj.gz", packed);
    CHECK(read_plain_or_gz(folder.path / "base.obj") == cube);
    write_atomic(folder.path / "base.obj.gz", ByteSpan(packed).first(packed.size() - 9));
    CHECK(error_of([&] { read_plain_or_gz(folder.path / "base.obj"); }).find("base.obj.gz") !=
          std::string::npos);
}

TEST_CASE("subdivision: a cube's first step, by the published rules") {
    const QuadMesh mesh = parse_quads(cube, "base.obj");
    const Subdivision once = subdivided(8, mesh.uv, mesh.faces);
    CHECK(once.faces.size() == 24);
    CHECK(once.weights.cols() == 8 + 12 + 6);
    const Points p = mesh.vertices * once.weights;
    // A corner: (faces' middles + 2 edges' middles + 0) / 3.
    CHECK((V3(p.col(0)) - V3::Constant(2.0 / 9)).norm() < 1e-12);
    // Each column sums to 1: a displacement of all vertices moves all new ones.
    CHECK((Eigen::RowVectorXd::Ones(8) * once.weights - Eigen::RowVectorXd::Ones(26)).norm() <
          1e-12);
    for (const Quad& q : once.faces)
        for (const Index u : q.uv) CHECK(u < once.uv.cols());
    // An open sheet keeps its border: the corners' neighbours lie on its edges.
    const Subdivision sheet = subdivided(8, mesh.uv, {mesh.faces[0]});
    const Points flat = mesh.vertices * sheet.weights;
    REQUIRE(flat.cols() == 8 + 4 + 1);
    CHECK(flat.row(2).tail(5).isZero(1e-12));
    CHECK(V3(flat.col(6)) == V3(1, 1, 1)); // of no face
    CHECK((V3(flat.col(0)) - V3(0.125, 0.125, 0)).norm() < 1e-12);
}

TEST_CASE("MakeHuman's head: its eyes, landmarks and expressions, and lids that follow the gaze") {
    const auto base = test::real_data("makehuman/base.obj.gz");
    if (!base) return;
    const HeadPack pack = pack_makehuman(base->parent_path());
    const Folder folder;
    write_npz(folder.path / "makehuman.npz", pack.arrays);
    write_atomic(folder.path / "names.json", as_bytes(pack.names));
    const HeadModel m = ict_head(folder.path / "makehuman.npz", 5);
    CHECK(m.origin.find("MakeHuman") == 0);
    CHECK(m.expression_names.size() == 33);
    CHECK(m.identity.size() == 38);
    for (std::size_t e = 0; e < 2; ++e) {
        CHECK(std::abs(std::abs(m.eyes[e].centre.x()) - 0.3) < 0.05);
        CHECK((e == 0) == (m.eyes[e].centre.x() > 0));
        CHECK(std::abs(m.eyes[e].radius - 0.146) < 0.015);
    }
    CHECK(m.dense.size() > 1000);
    const Points rest = m.vertices(looking(m, 0).expression, looking(m, 0).lids);
    const auto at = [&](const Points& p, std::size_t i) { return V3(p.col(m.landmarks[i])); };
    CHECK((at(rest, 27) - at(rest, 8)).norm() > 0.95); // nasion to chin
    CHECK((at(rest, 27) - at(rest, 8)).norm() < 1.30);
    for (std::size_t i = 0; i < 8; ++i) CHECK(at(rest, i).x() < at(rest, 16 - i).x());

    const auto with = [&](const std::string& name) {
        HeadState s = looking(m, 0);
        for (std::size_t i = 0; i < m.expression_names.size(); ++i)
            if (m.expression_names[i].starts_with(name)) s.expression[static_cast<Index>(i)] = 1;
        return m.vertices(s.expression, s.lids);
    };
    CHECK(at(with("jawOpen"), 66).y() < at(rest, 66).y() - 0.2);
    CHECK(at(with("mouthSmile"), 48).y() > at(rest, 48).y() + 0.05);
    CHECK(at(with("browDown"), 22).y() < at(rest, 22).y() - 0.03);
    CHECK((at(with("mouthSmile_L"), 48) - at(rest, 48)).norm() < 1e-3);
    for (const int eye : {0, 1}) {
        const auto lids = [&](double pitch) {
            const HeadState s = looking(m, pitch);
            return opening(m, m.vertices(s.expression, s.lids), eye);
        };
        CHECK(lids(-20) < lids(0) - 0.01);
        CHECK(lids(15) > lids(0) + 0.01);
        CHECK(opening(m, with("eyeBlink"), eye) < 0.015);
    }
    const PosedHead posed(m, looking(m, 0));
    for (std::size_t e = 0; e < 2; ++e) {
        const Pinhole<double> camera =
            look_at<double>(V3(0, 0.35, 11), m.eyes[e].centre, V3(0, 1, 0), 0.05, {64, 64});
        const HeadPicture p = posed.picture(camera, 1);
        const V3 pupil =
            camera.project_point(V3(m.eyes[e].centre + m.eyes[e].iris_plane() * V3(0, 0, 1)));
        const int pixel = 64 * static_cast<int>(pupil.y()) + static_cast<int>(pupil.x());
        CHECK(p.eye[static_cast<std::size_t>(pixel)] == e + 1);
    }
}
