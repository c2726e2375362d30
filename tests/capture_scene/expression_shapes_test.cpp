// SPDX-License-Identifier: Apache-2.0
// Knowledge of a capture about its expressions: shapes of its face model, and regions by name.
#include <cmath>
#include <filesystem>
#include <limits>

#include <doctest/doctest.h>

#include <rye/io/npz.hpp>

#include "../support/hostile.hpp"
#include "corrections/expression_regions.hpp"
#include "data/expression_shapes.hpp"
#include "data/samples.hpp"
#include "data/validate.hpp"
#include "synthetic_capture/scene.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

/// A capture of four frames by one camera.
struct Written {
    TemporaryFolder folder;
    HeadModel head = procedural_head(1, 256);
    Capture capture;
    Written() {
        const CaptureSettings settings{.size = 32,
                                       .cameras = 1,
                                       .train_frames = 3,
                                       .novel_frames = 1,
                                       .independent_frames = 0,
                                       .samples = 1};
        write_capture(head, capture_scene(head, settings), folder.path, [](int, int) {});
        capture = read_capture(folder.path);
    }
    fs::path file() const { return folder.path / "expression_shapes.npz"; }
    /// The fault that `rye info` names after an edit of an array of the file.
    template <class F>
    std::string fault(const std::string& name, F&& edit) const {
        const NpzArrays good = read_npz(file());
        NpzArrays arrays = good;
        std::vector<double> values = arrays.at(name).template values<double>(name);
        std::vector<Index> shape = arrays.at(name).shape;
        edit(values, shape);
        arrays[name] = npy_array<double>(shape, values);
        write_npz(file(), arrays);
        std::string all;
        for (const Problem& p : validate(capture, ImagesToDecode::none)) all += p.message + "\n";
        write_npz(file(), good);
        return all;
    }
};

std::string about_shapes(const std::vector<Problem>& problems) {
    for (const Problem& p : problems)
        if (p.message.find("expression_shapes.npz") != std::string::npos) return p.message;
    return "";
}

} // namespace

TEST_CASE("shapes of a capture: those of its model, at the landmarks that training fits") {
    const Written w;
    const Columns<double> shapes = expression_shapes(w.capture);
    const Index count = w.capture.expression_width();
    REQUIRE(shapes.rows() == count);
    REQUIRE(shapes.cols() == 3 * frame_landmarks(w.capture, 0).cols());
    // Both ends of a coefficient's range, lids at rest, in the head's frame.
    const VecX<double> lids = VecX<double>::Zero(8);
    const auto landmarks = [&](const VecX<double>& e) {
        const Points all = w.head.vertices(e, lids);
        Columns<double> marks(3, 68), dense(3, static_cast<Index>(w.head.dense.size()));
        for (std::size_t i = 0; i < 68; ++i)
            marks.col(static_cast<Index>(i)) = all.col(w.head.landmarks[i]);
        for (std::size_t i = 0; i < w.head.dense.size(); ++i)
            dense.col(static_cast<Index>(i)) = all.col(w.head.dense[i]);
        return chosen_landmarks(common_landmarks(marks, "marks"), dense);
    };
    const Columns<double> rest = landmarks(VecX<double>::Zero(count));
    for (Index e = 0; e < count; ++e) {
        const Columns<double> moved = landmarks(VecX<double>::Unit(count, e)) - rest;
        CHECK(
            (shapes.row(e).transpose() - Eigen::Map<const VecX<double>>(moved.data(), moved.size()))
                .cwiseAbs()
                .maxCoeff() < 1e-6);
        CHECK(moved.cwiseAbs().maxCoeff() > 0);
    }
    CHECK(about_shapes(validate(w.capture, ImagesToDecode::none)).empty());
}

TEST_CASE("shapes of a capture: what does not fit is named") {
    const Written w;
    using Values = std::vector<double>;
    using Shape = std::vector<Index>;
    const auto has = [](const std::string& text, const std::string& words) {
        INFO(text);
        CHECK(text.find(words) != std::string::npos);
    };
    has(w.fault("landmarks", [](Values& v, Shape&) { v[7] = std::nan(""); }),
        "expression_shapes.npz: landmarks: has a number that is not finite");
    has(w.fault("landmarks",
                [](Values& v, Shape& s) {
                    s[1] = 67;
                    v.resize(v.size() / 68 * 67);
                }),
        "expression_shapes.npz: landmarks: got 67 landmarks, expected 66 or 68");
    has(w.fault("vertices",
                [](Values& v, Shape& s) {
                    --s[0];
                    v.resize(v.size() / (s[0] + 1) * s[0]);
                }),
        "a shape for each exp_coeff");
    has(w.fault("vertices",
                [](Values& v, Shape& s) {
                    --s[1];
                    v.resize(s[0] * s[1] * 3);
                }),
        "of vertices.npy");
    has(w.fault("landmarks",
                [](Values& v, Shape&) {
                    for (double& x : v) x *= 1e5;
                }),
        "expected less than 10 times the landmarks' span");
    has(w.fault("landmarks",
                [](Values& v, Shape&) {
                    for (double& x : v) x *= -1;
                }),
        "are units and exp_coeff the model's?");
    fs::remove(w.file());
    CHECK(expression_shapes(w.capture).size() == 0);
}

TEST_CASE("regions: where a coefficient acts, by its name") {
    const Written w;
    const Columns<double> neutral =
        to_canonical(w.capture.frames[0], frame_landmarks(w.capture, 0));
    // Landmarks of iBUG without 48 and 54: brows 17 to 26, the subject's right ones first; 41 of
    // the right lower lid, 46 of the left; 62 of the left corner of the mouth.
    const Columns<double> r = expression_reach({"browDown_L", "browDownRight", "jawOpen", "jawLeft",
                                                "mouthSmile_R", "EyeBlinkLeft", "e12"},
                                               neutral);
    REQUIRE(r.rows() == 7);
    REQUIRE(r.cols() == neutral.cols());
    CHECK(r.minCoeff() >= 0.05);
    CHECK(r.maxCoeff() == 1);
    CHECK(r(0, 24) == 1);   // of the left brow
    CHECK(r(0, 17) < 0.1);  // right brow's outer end
    CHECK(r(0, 8) < 0.051); // chin
    CHECK(r(1, 19) == 1);
    CHECK(r(1, 26) < 0.1);
    CHECK(r(2, 8) == 1);
    CHECK(r(2, 19) < 0.1);
    CHECK(r.row(3) == r.row(2)); // a direction, not a side
    CHECK(r(4, 58) == 1);
    CHECK(r(4, 62) < 0.8);
    CHECK(r(5, 46) == 1);
    CHECK(r(5, 41) < 0.3);
    CHECK((r.row(6).array() == 1).all());
    CHECK(expression_reach({"e1", "e2"}, neutral).size() == 0);
    CHECK(expression_reach({}, neutral).size() == 0);
}
