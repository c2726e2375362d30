// SPDX-License-Identifier: Apache-2.0
/// Imports FLAME tracking exported by VHAP, with its meshes. The export has pictures, cameras,
/// masks, expression and pose; landmarks, eyeballs and eye masks come from the meshes, the gaze
/// from eyes_pose. World: the export's, metres, times a power of ten. Head frame: FLAME's axes (x
/// subject's left, y up, z out of the face), with the middle of the eyes at eyes_in_head.
/// Source of the layout: VHAP (Qian, 2024), export_as_nerf_dataset.
#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"
#include "data/json.hpp"
#include "data/memory_limit.hpp"
#include "data/photographs.hpp"
#include "importers/face_geometry.hpp"
#include "importers/flame.hpp"
#include "importers/flame_params.hpp"
#include "importers/import_folder.hpp"
#include "importers/iris_size.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = ImportFolder::Json;

/// Largest difference between the head's rotation by the meshes and by the parameters of a frame
/// [deg].
constexpr double most_disagreement = 8;

struct VhapView {
    std::string camera;
    fs::path image, mask;
    Pinhole<double> pinhole;
};

struct VhapFrame {
    std::string id;
    fs::path params, mesh;
    std::vector<VhapView> views;
};

struct VhapSource {
    fs::path folder;
    std::vector<VhapFrame> frames;
    std::set<std::string> cameras;
    int masks = 0, views = 0;
    std::array<int, 4> eyeballs = flame_eyeballs;
    std::array<int, 68> landmarks = flame_landmarks;
};

std::string padded(Index number, std::size_t digits) {
    std::string text = std::to_string(number);
    return std::string(text.size() < digits ? digits - text.size() : 0, '0') + text;
}

/// Returns a whole number of a frame of transforms.json, 0 or more.
Index whole(const Json& frame, const char* key, const std::string& who) {
    require(frame.contains(key), who + ": " + key,
            "is missing, expected a whole number: not an export of VHAP");
    const Json& value = frame.at(key);
    require(
        value.is_number_integer() && value.get<double>() >= 0 && value.get<double>() < 1e6,
        who + ": " + key, "got ", [&] { return value.dump(); },
        ", expected a whole number from 0 on");
    return value.get<Index>();
}

/// Returns a path of a frame of transforms.json, or a default.
fs::path file_of(const Json& frame, const char* key, const std::string& otherwise,
                 const std::string& who) {
    if (!frame.contains(key)) return otherwise;
    require(
        frame.at(key).is_string(), who + ": " + key, "got ", [&] { return frame.at(key).dump(); },
        ", expected a path");
    return frame.at(key).get<std::string>();
}

/// Returns a frame's file in a sister folder of another of its files, or of the export's own
/// folder.
fs::path beside(const fs::path& other, const char* folder, const std::string& number,
                const char* suffix) {
    const std::string stem = other.empty() ? number : other.stem().string();
    return other.parent_path().parent_path() / folder / (stem + suffix);
}

std::array<int, 68> read_landmark_vertices(const fs::path& path) {
    std::array<int, 68> all{};
    const Bytes bytes = read_file(path, 1U << 20U);
    std::string text(as_text(bytes));
    std::replace(text.begin(), text.end(), ',', ' ');
    std::istringstream in(text);
    std::size_t n = 0;
    for (std::string word; in >> word; ++n) {
        require(n < all.size(), path.string(), "got more than 68 vertices, expected 68");
        require(word.size() < 7 && word.find_first_not_of("0123456789") == std::string::npos,
                path.string(), "landmark ", n, ": got '", word, "', expected a vertex from 0 on");
        all[n] = std::stoi(word);
    }
    require(n == all.size(), path.string(), "got ", n, " vertices, expected 68");
    return all;
}

VhapSource read_vhap(const ImportOptions& o) {
    VhapSource s;
    s.folder = o.source;
    if (!o.landmarks.empty()) s.landmarks = read_landmark_vertices(o.landmarks);
    if (!o.eyeballs.empty()) {
        require(o.eyeballs.size() == 4, "--eyeballs", "got ", o.eyeballs.size(),
                " numbers, expected 4: first and last vertex of the left and right eyeball");
        std::copy(o.eyeballs.begin(), o.eyeballs.end(), s.eyeballs.begin());
        for (std::size_t e = 0; e < 4; e += 2)
            require(s.eyeballs[e] >= 0 && s.eyeballs[e + 1] - s.eyeballs[e] >= 15, "--eyeballs",
                    "got the vertices ", s.eyeballs[e], " to ", s.eyeballs[e + 1],
                    ", expected at least 16 of an eyeball");
    }
    const fs::path file = s.folder / "transforms.json";
    require(fs::exists(file), file.string(), "no such file, expected the export folder of VHAP");
    const Json json = read_json<Json>(file);
    require(json.is_object() && json.contains("frames") && json.at("frames").is_array() &&
                !json.at("frames").empty(),
            file.string() + ": frames", "is missing or empty, expected the views of an export");
    const std::vector<Photograph> photographs = read_photographs(file);
    std::map<Index, VhapFrame> frames;
    std::set<std::pair<Index, Index>> seen;
    for (std::size_t i = 0; i < photographs.size(); ++i) {
        const Json& view = json.at("frames").at(i);
        const std::string who = file.string() + ": frame " + std::to_string(i);
        const Index time = whole(view, "timestep_index", who);
        const Index camera = whole(view, "camera_index", who);
        require(seen.insert({time, camera}).second, who + ": camera_index", "got ", camera,
                " twice for timestep_index ", time, ", expected each view once");
        require(!photographs[i].bent(), who,
                "has lens distortion, expected the pinhole pictures of an export");
        const std::string number = padded(time, 5);
        VhapFrame& frame = frames[time];
        frame.id = number;
        // An export names one of the two files; the other one is in the same folder's other export.
        const fs::path mesh = file_of(view, "mesh_path", "", who);
        const fs::path params =
            file_of(view, "flame_param_path",
                    beside(mesh, "flame_param", number, ".npz").generic_string(), who);
        const auto named = [&](const fs::path& path, const char* key) {
            return named_file(o, s.folder, path, who + ": " + key);
        };
        frame.params = named(params, "flame_param_path");
        frame.mesh =
            named(mesh.empty() ? beside(params, "meshes", number, ".obj") : mesh, "mesh_path");
        VhapView v{
            padded(camera, 2), named(photographs[i].file, "file_path"), {}, photographs[i].camera};
        require(fs::is_regular_file(v.image), v.image.string(),
                "no such file, expected the picture of frame ", i, " of ", file.string());
        const fs::path mask = file_of(view, "fg_mask_path", "", who);
        if (!mask.empty()) {
            v.mask = named(mask, "fg_mask_path");
            require(fs::is_regular_file(v.mask), v.mask.string(),
                    "no such file, expected the fg_mask_path of frame ", i, " of ", file.string());
            ++s.masks;
        }
        s.cameras.insert(v.camera);
        ++s.views;
        frame.views.push_back(std::move(v));
    }
    for (auto& [time, frame] : frames) s.frames.push_back(std::move(frame));
    for (const VhapFrame& f : s.frames) {
        require(fs::exists(f.params), f.params.string(),
                "no such file: export once more into the same folder with VHAP's "
                "`--flame-mode param`");
        require(fs::exists(f.mesh), f.mesh.string(),
                "no such file: landmarks and eyes come from the meshes; export once more into the "
                "same folder with VHAP's `--flame-mode mesh --no-create-mask-from-mesh`");
    }
    return s;
}

TriangleMesh<double> read_mesh(const VhapSource& s, const fs::path& path) {
    TriangleMesh<double> mesh = read_obj(path);
    const Index count = mesh.vertices.cols();
    const bool flame = s.eyeballs == flame_eyeballs && s.landmarks == flame_landmarks;
    if (flame)
        require(count == flame_vertices || count == flame_vertices_with_teeth, path.string(),
                "got ", count,
                " vertices, expected FLAME's 5023, or 5143 with "
                "VHAP's teeth; for another topology give --eyeballs and --landmarks");
    for (const int i : s.eyeballs)
        require(i < count, path.string(), "has ", count, " vertices, expected vertex ", i,
                " of --eyeballs in it");
    for (const int i : s.landmarks)
        require(i < count, path.string(), "has ", count, " vertices, expected vertex ", i,
                " of --landmarks in it");
    require(!mesh.faces.empty(), path.string(), "has no faces, expected a triangle mesh");
    return mesh;
}

Columns<double> picked(const Columns<double>& points, const auto& which) {
    Columns<double> out(3, static_cast<Index>(which.size()));
    for (std::size_t i = 0; i < which.size(); ++i)
        out.col(static_cast<Index>(i)) = points.col(which[i]);
    return out;
}

double span_of(const Columns<double>& points) {
    return (points.rowwise().maxCoeff() - points.rowwise().minCoeff()).norm();
}

std::array<Sphere, 2> eyeballs_of(const VhapSource& s, const Columns<double>& vertices) {
    std::array<Sphere, 2> balls;
    for (std::size_t e = 0; e < 2; ++e)
        balls[e] = fit_sphere(
            vertices.middleCols(s.eyeballs[2 * e], s.eyeballs[2 * e + 1] - s.eyeballs[2 * e] + 1));
    return balls;
}

/// Landmarks of the nose and the eyes' corners, which expressions move least.
constexpr std::array<int, 13> stable{27, 28, 29, 30, 31, 32, 33, 34, 35, 36, 39, 42, 45};

/// Properties shared by all frames, from the first frame's mesh.
struct Shared {
    double factor = 1;                ///< from the export's unit to rye's
    std::vector<int> dense;           ///< vertices of the narrow face
    Columns<double> stable_in_head;   ///< of the first frame, about their mean
    std::vector<std::uint8_t> labels; ///< values of eye masks, per face
    std::vector<Face> faces;
};

Shared shared_of(const VhapSource& s, const VhapFrame& first) {
    Shared shared;
    const TriangleMesh<double> mesh = read_mesh(s, first.mesh);
    const FlameParams params = read_flame_params(first.params);
    const Columns<double> marks = picked(mesh.vertices, s.landmarks);
    const double span = span_of(marks);
    require(span > 0, first.mesh.string(), "its landmarks are all in one place");
    shared.factor = unit_factor(span);
    const Columns<double> head = params.rotation.transpose() * mesh.vertices;
    const Columns<double> nose = picked(params.rotation.transpose() * marks, stable);
    shared.stable_in_head = nose.colwise() - Vec3<double>(nose.rowwise().mean());
    const Columns<double> face = picked(head, s.landmarks);
    const double behind = face.leftCols(17).row(2).mean(), below = face.row(1).minCoeff(),
                 above = face.row(1).maxCoeff();
    for (Index i = 0; i < head.cols(); ++i) {
        const bool eye = (i >= s.eyeballs[0] && i <= s.eyeballs[1]) ||
                         (i >= s.eyeballs[2] && i <= s.eyeballs[3]);
        if (!eye && i < flame_vertices && head(2, i) > behind && head(1, i) > below &&
            head(1, i) < above + 0.2 * (above - below))
            shared.dense.push_back(static_cast<int>(i));
    }
    shared.faces = mesh.faces;
    for (const Face& f : mesh.faces) {
        std::uint8_t label = 0;
        for (int e = 0; e < 2; ++e) {
            const auto of_eye = [&](Index v) {
                return v >= s.eyeballs[static_cast<std::size_t>(2 * e)] &&
                       v <= s.eyeballs[static_cast<std::size_t>(2 * e + 1)];
            };
            if (of_eye(f[0]) && of_eye(f[1]) && of_eye(f[2])) label = eye_mask_value(e);
        }
        shared.labels.push_back(label);
    }
    return shared;
}

/// Returns the angle between the rotations of the parameters and of the mesh since the first frame
/// [deg].
double disagreement(const Shared& shared, const Columns<double>& marks, const FlameParams& p) {
    const Columns<double> nose = picked(p.rotation.transpose() * marks, stable);
    const Rigid<double> turned = fit_rigid(shared.stable_in_head, nose);
    return degrees * norm(so3_log(turned.rotation));
}

ImportHead head_of(const VhapSource& s, const Shared& shared, const VhapFrame& frame,
                   const Columns<double>& vertices, double& off) {
    const FlameParams p = read_flame_params(frame.params);
    ImportHead head;
    head.expression = p.expression;
    head.landmarks = picked(vertices, s.landmarks);
    head.vertices = picked(vertices, shared.dense);
    off = disagreement(shared, head.landmarks / shared.factor, p);
    require(
        off < most_disagreement, frame.mesh.string(), "the head is turned by ",
        [&] { return factor_text(off); }, " degrees from the rotation in ", frame.params.string(),
        ", expected below ", [&] { return factor_text(most_disagreement); },
        ": mesh and parameters are of different exports");
    const std::array<Sphere, 2> balls = eyeballs_of(s, vertices);
    const Vec3<double> middle = 0.5 * (balls[0].centre + balls[1].centre);
    head.pose.head<3>() = so3_log(p.rotation);
    head.pose.tail<3>() = middle - p.rotation * eyes_in_head;
    head.has_gaze = true;
    for (std::size_t e = 0; e < 2; ++e) {
        require(
            balls[e].error < 0.1 * balls[e].radius, frame.mesh.string(), "the vertices of the ",
            e == 0 ? "left" : "right", " eyeball are ",
            [&] { return factor_text(balls[e].error / balls[e].radius * 100); },
            " % of a radius off a sphere, expected below 10: another topology than FLAME's?");
        head.eyes[e].optical = p.gaze[e];
        head.eyes[e].centre = balls[e].centre;
        head.eyes[e].radius = balls[e].radius;
    }
    return head;
}

ImportView view_of(const VhapView& source, const LabelledMesh& mesh, double factor) {
    ImportView view;
    view.camera = source.camera;
    view.copy_of = source.image;
    view.pinhole = source.pinhole;
    view.pinhole.camera_from_world.translation *= factor;
    const ImageHeader size = read_image_header(source.image);
    require(size.width == view.pinhole.width && size.height == view.pinhole.height,
            source.image.string(), "got ", size.width, " x ", size.height, " pixels, expected ",
            view.pinhole.width, " x ", view.pinhole.height, " as transforms.json has");
    view.eyes = draw_labels(mesh, view.pinhole);
    if (!source.mask.empty()) {
        view.mask = read_image8(source.mask, 1);
        require(view.mask.width == size.width && view.mask.height == size.height,
                source.mask.string(), "got ", view.mask.width, " x ", view.mask.height,
                " pixels, expected ", size.width, " x ", size.height);
    } else {
        view.mask = view.eyes;
        for (std::uint8_t& v : view.mask.values) v = v == 255 ? 0 : 255;
    }
    for (std::uint8_t& v : view.eyes.values)
        if (v == 255) v = 0;
    clip_to_mask(view.eyes, view.mask);
    return view;
}

/// Returns the frames of transforms_test.json, which VHAP keeps for tests.
std::set<std::string> test_frames(const VhapSource& s) {
    std::set<std::string> frames;
    const fs::path file = s.folder / "transforms_test.json";
    if (!fs::exists(file)) return frames;
    const Json json = read_json<Json>(file);
    if (json.is_object() && json.contains("frames") && json.at("frames").is_array())
        for (const Json& view : json.at("frames"))
            frames.insert(padded(whole(view, "timestep_index", file.string()), 5));
    return frames;
}

Json description(const VhapSource& s, const Shared& shared, std::size_t expression) {
    Json train = Json::array(), test = Json::array(), names = Json::array();
    const std::set<std::string> held_out = test_frames(s);
    for (const VhapFrame& f : s.frames) (held_out.contains(f.id) ? test : train).push_back(f.id);
    if (test.empty() && train.size() > 1) {
        const std::size_t tests = std::max<std::size_t>(1, train.size() / 5);
        for (std::size_t i = train.size() - tests; i < train.size(); ++i) test.push_back(train[i]);
        train.erase(train.end() - static_cast<std::ptrdiff_t>(tests), train.end());
    }
    for (std::size_t i = 0; i + 3 < expression; ++i) names.push_back("expr_" + std::to_string(i));
    for (const char* axis : {"jaw_x", "jaw_y", "jaw_z"}) names.push_back(axis);
    const Pinhole<double>& first = s.frames.front().views.front().pinhole;
    return {{"subject", s.folder.filename().string()},
            {"image_size", {first.width, first.height}},
            {"train_frames", train},
            {"test_frames", test},
            {"exp_names", names},
            {"conventions",
             {{"image", "photographs; multiplied by the mask when read"},
              {"world", "that of the export, lengths times " + factor_text(shared.factor)},
              {"gaze", "optical axes from FLAME's eyes_pose, head frame"}}}};
}

} // namespace

ImportSummary import_vhap(const ImportOptions& o) {
    Json job = import_job("vhap", o);
    const VhapSource s = read_vhap(o);
    job["eyeballs"] = s.eyeballs;
    job["landmarks"] = s.landmarks;
    const Shared shared = shared_of(s, s.frames.front());
    ImportFolder folder(o.out, job);
    ImportSummary summary;
    std::size_t expression = 0;
    double worst = 0;
    for (const VhapFrame& frame : s.frames) {
        if (!folder.has(frame.id)) {
            TriangleMesh<double> mesh = read_mesh(s, frame.mesh);
            require(mesh.faces == shared.faces, frame.mesh.string(),
                    "its faces differ from those of ", s.frames.front().mesh.string(),
                    ", expected one topology for all frames");
            const LabelledMesh scaled{mesh.vertices * shared.factor, mesh.faces, shared.labels};
            double off = 0;
            ImportFrame out{frame.id, head_of(s, shared, frame, scaled.vertices, off), {}};
            for (const VhapView& view : frame.views)
                out.views.push_back(view_of(view, scaled, shared.factor));
            folder.write(out, {{"expression", out.head->expression.size()}, {"off", off}});
            ++summary.written;
        }
        const Json& facts = folder.facts(frame.id);
        const std::size_t width = facts.value("expression", std::size_t(0));
        require(expression == 0 || width == expression, frame.params.string() + ": expr", "got ",
                width, " numbers with jaw_pose, expected ", expression, " as in the first frame");
        expression = width;
        worst = std::max(worst, facts.value("off", 0.0));
        o.progress(++summary.frames, static_cast<int>(s.frames.size()));
    }
    summary.cameras = static_cast<int>(s.cameras.size());
    summary.found = {
        std::to_string(s.views) + " pictures and cameras, " + std::to_string(s.masks) + " masks",
        std::to_string(expression) +
            " expression coefficients (expr, jaw_pose), "
            "head poses (rotation, neck_pose)"};
    summary.derived = {
        "gaze of both eyes from eyes_pose",
        "68 landmarks, " + std::to_string(shared.dense.size()) +
            " vertices, eyeballs' centres and radii from the meshes (which agree with the "
            "parameters' rotations to " +
            factor_text(worst) + " degrees)",
        "eye masks from the meshes' eyeballs, where lids and nose do not hide them",
        "lengths times " + factor_text(shared.factor) + ", so that a head spans about 2 units"};
    if (s.masks < s.views)
        summary.derived.push_back(std::to_string(s.views - s.masks) +
                                  " masks from the meshes: without hair and shoulders");
    const Json about = description(s, shared, expression);
    std::optional<Capture> written = folder.read(about.at("train_frames"));
    const double iris = written ? measure_iris(*written) : 0;
    if (iris > 0) {
        folder.write_eyes(*written);
        summary.derived.push_back("size of the iris from the pictures: its rim has " +
                                  factor_text(iris) + " radii of the eyeball");
    } else {
        summary.missing.push_back("size of the iris: that of an average eye is used");
    }
    summary.missing.push_back("angle kappa between optical and visual axis");
    folder.finish(about, summary);
    return summary;
}

} // namespace rye::trainer
