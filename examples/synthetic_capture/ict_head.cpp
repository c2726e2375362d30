// SPDX-License-Identifier: Apache-2.0
/// The ICT face model (light) as a head: its skin, mouth and expressions, with rye's eyeballs.
/// Source: ICT-FaceKit, (c) 2020 USC Institute for Creative Technologies, MIT; packed as one npz
/// with names.json beside it. The model's unit is a tenth of ours. Another model packed in the same
/// arrays is read as well: MakeHuman's by makehuman_pack.hpp, whose names.json states its origin.
#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <memory>

#include <rye/io/npz.hpp>
#include <rye/core/random.hpp>

#include "data/json.hpp"
#include "synthetic_capture/skin_paint.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using V3 = Vec3<double>;

constexpr double ict_unit = 0.1;
/// Size of the albedo image [px].
constexpr int width = 1792, height = 896;
/// Limit on identity weights, in standard deviations of the model.
constexpr double most_identity = 1.3;

/// Part by its number in the pack; -1 skips the model's eyeballs and transparent shells.
constexpr std::array<int, 19> kept{0,  0, 1, 1,  1,  1,  2,  -1, -1, -1,
                                   -1, 3, 3, -1, -1, -1, -1, -1, -1};
constexpr std::array kinds{Part::skin, Part::mouth, Part::tooth, Part::eye_corner};
/// Number of the left sclera; the right one is two further.
constexpr std::size_t sclera = 7;

float half_to_float(std::uint16_t h) {
    const int exponent = (h >> 10) & 31, mantissa = h & 1023;
    const float size = exponent == 0
                           ? std::ldexp(static_cast<float>(mantissa), -24)
                           : std::ldexp(static_cast<float>(1024 + mantissa), exponent - 25);
    return (h & 0x8000) != 0 ? -size : size;
}

/// The arrays of an npz that may include float16, which rye's reader does not support: such arrays
/// are read as 16-bit integers.
NpzArrays read_pack(const fs::path& path) {
    const Bytes zip = read_file(path);
    const std::string who = path.string();
    NpzArrays arrays;
    for (const detail::ZipMember& m : detail::read_zip_directory(zip, who)) {
        const char* what = "a zip local header";
        const auto name = read_at<std::uint16_t>(zip, m.header + 26, who, what);
        const auto extra = read_at<std::uint16_t>(zip, m.header + 28, who, what);
        const ByteSpan packed = slice(zip, m.header + 30 + name + extra, m.packed, who, "its data");
        Bytes bytes =
            m.method == 8 ? inflate(packed, m.unpacked, who) : Bytes(packed.begin(), packed.end());
        require(crc32(bytes) == m.crc, who, "'", m.name, "' is damaged: its checksum is wrong");
        constexpr std::string_view half = "'<f2'";
        const std::string_view head =
            as_text(ByteSpan(bytes).first(std::min<std::size_t>(128, bytes.size())));
        if (const auto at = head.find(half); at != std::string_view::npos)
            bytes[at + 2] = static_cast<std::byte>('u');
        arrays.emplace(m.name.substr(0, m.name.find(".npy")),
                       parse_npy(bytes, who + ": " + m.name));
    }
    return arrays;
}

class Pack {
  public:
    explicit Pack(const fs::path& path) : who_(path.string()), arrays_(read_pack(path)) {}

    const NpyArray& array(const std::string& name, Index columns) const {
        const auto found = arrays_.find(name);
        require(found != arrays_.end(), who_, "has no array '", name, "', expected the ICT pack");
        const std::vector<Index>& shape = found->second.shape;
        require(
            !shape.empty() && (columns == 1 ? shape.size() == 1 : shape.back() == columns), who_,
            name, ": got shape ", [&] { return shape_text(shape); }, ", expected rows of ",
            columns);
        return found->second;
    }
    std::vector<Index> indices(const std::string& name, Index columns, Index below) const {
        std::vector<Index> list = array(name, columns).values<Index>(who_ + ": " + name);
        for (const Index i : list)
            require(i >= 0 && i < below, who_, name, ": got the index ", i, ", expected 0 to ",
                    below - 1);
        return list;
    }
    /// Floats or half floats, as columns of D.
    Columns<double> columns(const std::string& name, Index d) const {
        const NpyArray& a = array(name, d);
        std::vector<double> list;
        if (a.type() == "u2")
            for (const auto h : a.values<std::uint16_t>(who_)) list.push_back(half_to_float(h));
        else
            list = a.values<double>(who_ + ": " + name);
        return Eigen::Map<const Columns<double>>(list.data(), d,
                                                 static_cast<Index>(list.size()) / d);
    }
    const std::string& who() const { return who_; }

  private:
    std::string who_;
    NpzArrays arrays_;
};

struct Names {
    std::vector<std::string> expressions, identity;
    std::string origin = "ICT-FaceKit light model, (c) 2020 USC Institute for Creative "
                         "Technologies, MIT licence"; ///< source and licence
};

Names read_names(const fs::path& path) {
    const nlohmann::json json = read_json(path);
    const auto names = [&](const char* key) {
        const std::string who = path.string() + ": " + key;
        require(json.is_object() && json.contains(key) && json.at(key).is_array(), who,
                "is missing or no list, expected a list of names");
        std::vector<std::string> list;
        for (const nlohmann::json& name : json.at(key)) {
            require(
                name.is_string(), who, "got ", [&] { return name.dump(); }, ", expected a name");
            list.push_back(name.get<std::string>());
        }
        return list;
    };
    Names all{names("expressions"), names("identity")};
    if (json.contains("origin")) {
        const nlohmann::json& origin = json.at("origin");
        require(
            origin.is_string(), path.string() + ": origin", "got ",
            [&] { return origin.dump(); }, ", expected the model's source and licence");
        all.origin = origin.get<std::string>();
    }
    return all;
}

/// Deformable geometry: the subject's neutral face and its sparse blendshapes.
struct Shapes {
    Points neutral;
    std::vector<Index> vertex; // of each row of delta
    Points delta;
    std::vector<Index> offset;                 // first row of each shape
    std::vector<std::size_t> expression, lids; // shapes that the weights drive

    Points vertices(const VecX<double>& weights, const VecX<double>& lid) const {
        Points v = neutral;
        const auto add = [&](std::size_t shape, double w) {
            if (w == 0) return;
            for (Index r = offset[shape]; r < offset[shape + 1]; ++r)
                v.col(vertex[static_cast<std::size_t>(r)]) += w * delta.col(r);
        };
        for (std::size_t i = 0; i < expression.size(); ++i)
            add(expression[i], weights[static_cast<Index>(i)]);
        for (std::size_t i = 0; i < lids.size(); ++i) add(lids[i], lid[static_cast<Index>(i)]);
        return v;
    }
};

/// The mean head's eyeball, moved and scaled as the identity does the model's own.
Eyeball find_eyeball(const Pack& pack, const Points& mean, const Points& subject, std::size_t eye) {
    const Columns<double> ranges = pack.columns("part_range", 2);
    const auto part = static_cast<Index>(sclera + 2 * eye);
    require(ranges.cols() > part, pack.who(), "part_range has too few rows");
    const auto first = static_cast<Index>(ranges(0, part));
    const Index n = static_cast<Index>(ranges(1, part)) - first;
    require(first >= 0 && n > 0 && first + n <= mean.cols(), pack.who(),
            "part_range is out of range");
    const V3 a = mean.middleCols(first, n).rowwise().mean();
    const V3 b = subject.middleCols(first, n).rowwise().mean();
    const double grown = (subject.middleCols(first, n).colwise() - b).norm() /
                         (mean.middleCols(first, n).colwise() - a).norm();
    const Columns<double> centres = pack.columns("eye_center", 3),
                          radii = pack.columns("eye_radius", 1);
    const auto k = static_cast<Index>(eye);
    const V3 centre = ict_unit * V3(centres.col(k));
    Eyeball ball;
    ball.centre = b + grown * (centre - a);
    ball.radius = ict_unit * radii(0, k) * grown;
    // The model's limbus, and a cornea whose apex lies where the model's does.
    ball.limbus_radius = 0.398 * ball.radius;
    ball.cornea_radius = 0.490 * ball.radius;
    return ball;
}

} // namespace

HeadModel ict_head(const fs::path& path, std::uint64_t seed) {
    const fs::path list = path.parent_path() / "names.json";
    require(!fs::exists(path) || fs::exists(list), list.string(),
            "no such file, expected the names of the model's expressions and identities beside ",
            path.string());
    const Pack pack(path);
    const Names names = read_names(list);
    HeadModel model;
    model.origin = names.origin + "; identity and skin from seed " + std::to_string(seed);
    model.identity_names = names.identity;

    const auto shapes = std::make_shared<Shapes>();
    const Points mean = ict_unit * pack.columns("neutral", 3);
    const Index n = mean.cols();
    const auto ids = static_cast<Index>(names.identity.size());
    const Columns<double> id_delta = pack.columns("id_delta", 3);
    require(id_delta.cols() == ids * n, pack.who(), "id_delta does not fit names.json and neutral");
    const Random random{seed, 23};
    model.identity.resize(ids);
    shapes->neutral = mean;
    for (Index i = 0; i < ids; ++i) {
        model.identity[i] =
            std::clamp(random.normal(static_cast<std::uint64_t>(i)), -most_identity, most_identity);
        shapes->neutral += ict_unit * model.identity[i] * id_delta.middleCols(i * n, n);
    }

    shapes->vertex = pack.indices("expr_index", 1, n);
    shapes->delta = ict_unit * pack.columns("expr_delta", 3);
    shapes->offset = pack.indices("expr_offset", 1, shapes->delta.cols() + 1);
    require(shapes->offset.size() == names.expressions.size() + 1 &&
                std::is_sorted(shapes->offset.begin(), shapes->offset.end()) &&
                static_cast<Index>(shapes->vertex.size()) == shapes->delta.cols(),
            pack.who(), "expr_offset, expr_index, expr_delta and names.json do not fit together");
    std::map<std::string, std::size_t> number;
    for (std::size_t i = 0; i < names.expressions.size(); ++i) number[names.expressions[i]] = i;
    for (const std::string& name : lid_names) {
        require(number.contains(name), pack.who(), "has no expression '", name, "'");
        shapes->lids.push_back(number[name]);
    }
    for (const std::string& name : names.expressions) {
        // The lids follow the gaze; the pupil is the eyeball's; cheekRaiser equals cheekSquint.
        if (name.starts_with("eyeLook") || name.starts_with("Pupil") ||
            name.starts_with("cheekRaiser"))
            continue;
        model.expression_names.push_back(name);
        shapes->expression.push_back(number[name]);
    }

    const std::vector<Index> corners = pack.indices("faces", 3, n);
    const Columns<double> uv = pack.columns("uv", 2);
    const std::vector<Index> uv_corners = pack.indices("faces_uv", 3, uv.cols());
    const std::vector<Index> parts = pack.indices("face_part", 1, static_cast<Index>(kept.size()));
    require(corners.size() == 3 * parts.size() && uv_corners.size() == corners.size(), pack.who(),
            "faces, faces_uv and face_part do not fit together");
    for (std::size_t f = 0; f < parts.size(); ++f) {
        const int kind = kept[static_cast<std::size_t>(parts[f])];
        if (kind < 0) continue;
        model.faces.push_back({corners[3 * f], corners[3 * f + 1], corners[3 * f + 2]});
        model.face_uv.push_back({uv_corners[3 * f], uv_corners[3 * f + 1], uv_corners[3 * f + 2]});
        model.parts.push_back(kinds[static_cast<std::size_t>(kind)]);
    }
    // The face has u in 0 to 1, the other skin in 1 to 2; v points up.
    model.uv = uv;
    model.uv.row(0) = 0.5 * uv.row(0);
    model.uv.row(1) = (1 - uv.row(1).array()).matrix();

    const std::vector<Index> marks = pack.indices("lmk68", 1, n);
    require(marks.size() == 68, pack.who(), "lmk68 has ", marks.size(), " vertices, expected 68");
    std::array<V3, 68> places;
    for (std::size_t i = 0; i < 68; ++i) {
        model.landmarks[i] = marks[i];
        places[i] = shapes->neutral.col(marks[i]);
    }
    const Columns<double> ranges = pack.columns("part_range", 2);
    for (Index i = 0; i < std::min(n, static_cast<Index>(ranges(1, 0))); ++i) {
        const V3 p = mean.col(i);
        if (i % 2 == 0 && p.z() > 0.24 && p.y() > -0.8 && p.y() < 0.96) model.dense.push_back(i);
    }
    for (std::size_t e = 0; e < 2; ++e)
        model.eyes[e] = find_eyeball(pack, mean, shapes->neutral, e);

    model.vertices = [shapes](const VecX<double>& expression, const VecX<double>& lid) {
        return shapes->vertices(expression, lid);
    };
    const Palette colours = palette(seed);
    model.look = colours.eyes;
    model.albedo = painted(model, shapes->neutral, SkinPaint(places, colours, seed), width,
                           height);
    return model;
}

} // namespace rye::trainer
