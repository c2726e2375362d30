// SPDX-License-Identifier: Apache-2.0
/// rye/io/gltf.hpp: reads the Gaussians of a glTF 2.0 file, .gltf or GLB: every primitive with
/// KHR_gaussian_splatting below the nodes of its scene, moved by their transforms, as one cloud.
/// Axes of glTF are x right, y up, z toward the viewer; clouds have those of a PLY. A node may
/// rotate, translate and scale uniformly: a Gaussian's axes do not follow a shear. Colours are
/// those of srgb_rec709_display. Files with a compression are refused by its name: none is
/// ratified. Source: glTF 2.0 specification (Khronos, 2021); KHR_gaussian_splatting, its text of
/// July 2026, a release candidate.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include <rye/io/gltf_file.hpp>
#include <rye/io/splat_quantize.hpp>
#include <rye/gaussian/move_cloud.hpp>

namespace rye {

namespace detail {

inline constexpr const char* gltf_splats = "KHR_gaussian_splatting";

using GltfMatrix = Eigen::Matrix<double, 4, 4>;

/// A primitive with Gaussians, and where the scene has it.
struct GltfPrimitive {
    const JsonValue* attributes = nullptr;
    std::string where; ///< such as meshes[0].primitives[1]
    Similarity pose;
    std::uint64_t count = 0;
    int degree = 0;
};

/// Returns numbers of an object's list, exactly so many; empty if it has no such list.
inline std::vector<double> gltf_numbers(const GltfFile& file, const JsonValue& object,
                                        const char* name, std::size_t count,
                                        const std::string& where) {
    const JsonValue* value = object.find(name);
    if (!value) return {};
    const JsonArray* list = value->get<JsonArray>();
    std::vector<double> numbers;
    for (std::size_t k = 0; list && k < list->size(); ++k) {
        if (const auto* x = (*list)[k].get<double>()) numbers.push_back(*x);
        if (const auto* x = (*list)[k].get<std::int64_t>())
            numbers.push_back(static_cast<double>(*x));
    }
    require(
        numbers.size() == count && list->size() == count, file.who(), where, ".", name, " is ",
        [&] { return json_text(*value).substr(0, 200); }, ", expected ", count, " numbers");
    return numbers;
}

/// Returns a node's own transform: its matrix, or its translation, rotation and scale.
inline GltfMatrix gltf_transform(const GltfFile& file, const JsonValue& node,
                                 const std::string& where) {
    GltfMatrix m = GltfMatrix::Identity();
    const std::vector<double> all = gltf_numbers(file, node, "matrix", 16, where);
    for (std::size_t k = 0; k < all.size(); ++k)
        m(static_cast<Index>(k % 4), static_cast<Index>(k / 4)) = all[k];
    if (!all.empty()) return m;
    const std::vector<double> r = gltf_numbers(file, node, "rotation", 4, where);
    if (!r.empty()) {
        const Quat<double> q(r[3], r[0], r[1], r[2]);
        require(std::abs(q.norm() - 1) < 1e-2, file.who(), where, ".rotation has the length ",
                q.norm(), ", expected 1");
        m.topLeftCorner<3, 3>() = quat_matrix<double>(quat_normalized<double>(q));
    }
    const std::vector<double> s = gltf_numbers(file, node, "scale", 3, where);
    const std::vector<double> t = gltf_numbers(file, node, "translation", 3, where);
    for (std::size_t k = 0; k < 3; ++k) {
        const auto c = static_cast<Index>(k);
        if (!s.empty()) m.col(c) *= s[k];
        if (!t.empty()) m(c, 3) = t[k];
    }
    return m;
}

/// Returns a node's global transform as a similarity; throws an Error for a shear, a mirror, or
/// scales that differ.
inline Similarity gltf_similarity(const GltfMatrix& m, const std::string& who,
                                  const std::string& where) {
    const Mat3<double> linear = m.topLeftCorner<3, 3>();
    const std::array<double, 3> length{linear.col(0).norm(), linear.col(1).norm(),
                                       linear.col(2).norm()};
    constexpr double slack = 1e-4; // of transforms that were written with six digits
    const double scale = std::cbrt(length[0] * length[1] * length[2]);
    require(std::isfinite(scale) && scale > 0 && m.allFinite(), who, where,
            ": its global scale is ", length[0], " ", length[1], " ", length[2],
            ", expected finite numbers above 0");
    const Mat3<double> r = linear / scale;
    require(std::max({length[0], length[1], length[2]}) <=
                (1 + slack) * std::min({length[0], length[1], length[2]}),
            who, where, ": its global scale is ", length[0], " ", length[1], " ", length[2],
            ", expected three equal numbers");
    require(std::abs(r.col(0).dot(r.col(1))) < slack && std::abs(r.col(1).dot(r.col(2))) < slack &&
                std::abs(r.col(2).dot(r.col(0))) < slack,
            who, where,
            ": its global transform has a shear, expected rotation, uniform scale and "
            "translation");
    require(dot(cross(Vec3<double>(r.col(0)), Vec3<double>(r.col(1))), Vec3<double>(r.col(2))) > 0,
            who, where,
            ": its global transform is a mirror, expected rotation, uniform scale and translation");
    const Quat<double> q = quat_normalized<double>(matrix_quat<double>(r));
    return {scale, quat_matrix<double>(q), m.topRightCorner<3, 1>()};
}

/// Returns the accessor of an attribute, or nothing.
inline std::optional<std::uint64_t> gltf_attribute(const GltfFile& file, const GltfPrimitive& p,
                                                   const std::string& name) {
    if (!p.attributes || !p.attributes->find(name)) return {};
    return file.whole(*p.attributes, name.c_str(), p.where + ".attributes");
}

/// Returns the name of a coefficient's attribute.
inline std::string gltf_harmonic(int degree, int order) {
    std::string name = "KHR_gaussian_splatting:SH_DEGREE_";
    name += std::to_string(degree);
    name += "_COEF_";
    return name += std::to_string(order);
}

/// Throws an Error for a kernel, a colour space or a projection that is not the one that clouds
/// have, and for a compression.
inline void require_gltf_splats(const GltfFile& file, const JsonValue& splats,
                                const std::string& where) {
    const std::string own = where + ".extensions." + gltf_splats;
    const auto expect = [&](const char* name, const char* value, bool optional) {
        const JsonValue* got = splats.find(name);
        if (!got && optional) return;
        const auto* text = got ? got->get<std::string>() : nullptr;
        require(text && *text == value, file.who(), own, ".", name, " is ",
                got ? json_text(*got) : "missing", ", expected ", value);
    };
    const JsonValue* inner = splats.find("extensions");
    const JsonObject* further = inner ? inner->get<JsonObject>() : nullptr;
    for (std::size_t k = 0; further && k < further->size(); ++k)
        require((*further)[k].name.find("compression") == std::string::npos, file.who(), own,
                " is compressed by ", (*further)[k].name, ", which is not read");
    expect("kernel", "ellipse", false);
    expect("colorSpace", "srgb_rec709_display", false);
    expect("projection", "perspective", true);
}

/// Adds a mesh's primitives with Gaussians to the list.
inline void add_gltf_mesh(const GltfFile& file, std::uint64_t index, const GltfMatrix& transform,
                          const std::string& node, std::vector<GltfPrimitive>& list) {
    const JsonValue& mesh = file.item("meshes", index, node + ".mesh");
    const JsonValue* value = mesh.find("primitives");
    const JsonArray* primitives = value ? value->get<JsonArray>() : nullptr;
    for (std::size_t k = 0; primitives && k < primitives->size(); ++k) {
        const JsonValue& primitive = (*primitives)[k];
        const JsonValue* extensions = primitive.find("extensions");
        const JsonValue* splats = extensions ? extensions->find(gltf_splats) : nullptr;
        if (!splats) continue;
        GltfPrimitive p;
        p.where = "meshes[" + std::to_string(index) + "].primitives[" + std::to_string(k) + "]";
        require_gltf_splats(file, *splats, p.where);
        const std::uint64_t mode = file.whole(primitive, "mode", p.where, 4);
        require(mode == 0, file.who(), p.where, ".mode is ", mode, ", expected 0 (points)");
        p.attributes = primitive.find("attributes");
        const auto position = gltf_attribute(file, p, "POSITION");
        require(position.has_value(), file.who(), p.where, ".attributes has no POSITION");
        const JsonValue& accessor = file.item("accessors", *position, p.where);
        p.count = file.whole(accessor, "count", p.where + ": its POSITION");
        while (p.degree < 3 && gltf_attribute(file, p, gltf_harmonic(p.degree + 1, 0))) ++p.degree;
        p.pose = gltf_similarity(transform, file.who(), node);
        list.push_back(p);
    }
}

/// Returns the primitives with Gaussians of the file's scene: its default one, or the first, or
/// where it has none, all nodes that are no child. Throws an Error for a node that is reached
/// twice.
inline std::vector<GltfPrimitive> gltf_primitives(const GltfFile& file) {
    struct Waiting {
        std::uint64_t node;
        GltfMatrix parent;
    };
    std::vector<Waiting> open;
    const std::size_t count = file.count("nodes");
    std::vector<bool> seen(count, false), is_child(count, false);
    const auto each = [&](const JsonValue& object, const char* name, const std::string& where,
                          const auto& f) {
        const JsonValue* value = object.find(name);
        const JsonArray* items = value ? value->get<JsonArray>() : nullptr;
        for (std::size_t k = 0; items && k < items->size(); ++k) {
            const auto* index = (*items)[k].get<std::int64_t>();
            require(index && *index >= 0 && static_cast<std::uint64_t>(*index) < count, file.who(),
                    where, ".", name, "[", k, "] is ", json_text((*items)[k]).substr(0, 60),
                    ", expected a node, 0 to below ", count);
            f(static_cast<std::uint64_t>(*index));
        }
    };
    const auto name_of = [](std::uint64_t node) { return "nodes[" + std::to_string(node) + "]"; };
    if (file.count("scenes") > 0) {
        const std::uint64_t scene = file.whole(file.root(), "scene", "glTF", 0);
        each(file.item("scenes", scene, "scene"), "nodes", "scenes[" + std::to_string(scene) + "]",
             [&](std::uint64_t n) {
                 open.push_back({n, GltfMatrix::Identity()});
             });
    } else {
        for (std::uint64_t n = 0; n < count; ++n)
            each(file.item("nodes", n, "nodes"), "children", name_of(n),
                 [&](std::uint64_t child) { is_child[static_cast<std::size_t>(child)] = true; });
        for (std::uint64_t n = 0; n < count; ++n)
            if (!is_child[static_cast<std::size_t>(n)]) open.push_back({n, GltfMatrix::Identity()});
    }
    std::reverse(open.begin(), open.end());
    std::vector<GltfPrimitive> list;
    while (!open.empty()) {
        const Waiting at = open.back();
        open.pop_back();
        const std::string where = name_of(at.node);
        const auto place = static_cast<std::size_t>(at.node);
        require(!seen[place], file.who(), where, " is reached twice, expected a tree of nodes");
        seen[place] = true;
        const JsonValue& node = file.item("nodes", at.node, where);
        const GltfMatrix transform = at.parent * gltf_transform(file, node, where);
        if (node.find("mesh"))
            add_gltf_mesh(file, file.whole(node, "mesh", where), transform, where, list);
        const std::size_t before = open.size();
        each(node, "children", where, [&](std::uint64_t n) { open.push_back({n, transform}); });
        std::reverse(open.begin() + static_cast<std::ptrdiff_t>(before), open.end());
    }
    return list;
}

/// Returns the Gaussians of a primitive, moved, in glTF's axes.
template <Real T>
GaussianCloud<T> gltf_cloud(GltfFile& file, const GltfPrimitive& p, bool quantized) {
    constexpr GltfType real{5126, false};
    const auto n = static_cast<std::int64_t>(p.count);
    const auto read = [&](const std::string& name, Index rows,
                          std::initializer_list<GltfType> types) {
        const auto accessor = gltf_attribute(file, p, name);
        require(accessor.has_value(), file.who(), p.where, ".attributes has no ", name);
        return file.columns<T>(*accessor, rows, n, types, p.where + ": " + name);
    };
    const auto fault = [&](const char* field, Index i, T value, const char* expected) {
        throw Error(file.who() + ": " + p.where + ": " + gltf_splats + ":" + field +
                    " of Gaussian " + std::to_string(i) + " is " + number_text(value) +
                    ", expected " + expected);
    };
    const std::string stem = "KHR_gaussian_splatting:";
    const Columns<T> mean = quantized ? read("POSITION", 3,
                                             {real,
                                              {5120, false},
                                              {5120, true},
                                              {5121, false},
                                              {5121, true},
                                              {5122, false},
                                              {5122, true},
                                              {5123, false},
                                              {5123, true}})
                                      : read("POSITION", 3, {real});
    GaussianCloud<T> cloud(mean.cols(), p.degree); // so many are in the file
    cloud.mean = mean;
    const Columns<T> turn = read(stem + "ROTATION", 4, {real, {5120, true}, {5122, true}});
    const Columns<T> scale =
        read(stem + "SCALE", 3, {real, {5121, false}, {5121, true}, {5123, false}, {5123, true}});
    const Columns<T> opacity = read(stem + "OPACITY", 1, {real, {5121, true}, {5123, true}});
    for (Index i = 0; i < cloud.count(); ++i) {
        const Quat<T> q(turn(3, i), turn(0, i), turn(1, i), turn(2, i));
        // Of length 1 in the text; there are writers that keep a PLY's, of any length.
        if (!(q.norm() > T(0)) || !std::isfinite(q.norm()))
            fault("ROTATION", i, q.norm(), "a quaternion of length 1");
        cloud.rotation.col(i) = quat_normalized<T>(q);
        if (!(opacity(0, i) >= T(0) && opacity(0, i) <= T(1)))
            fault("OPACITY", i, opacity(0, i), "0 to 1");
        cloud.logit_opacity(0, i) = bounded_logit(opacity(0, i));
        for (Index k = 0; k < 3; ++k) {
            if (scale(k, i) < T(0)) fault("SCALE", i, scale(k, i), "at least 0");
            cloud.log_scale(k, i) = std::log(std::max(scale(k, i), std::numeric_limits<T>::min()));
        }
    }
    cloud.sh_constant = read(gltf_harmonic(0, 0), 3, {real});
    const Index more = cloud.sh_rest.rows() / 3;
    for (int degree = 1, k = 0; degree <= p.degree; ++degree)
        for (int order = 0; order < 2 * degree + 1; ++order, ++k) {
            const Columns<T> c = read(gltf_harmonic(degree, order), 3, {real});
            for (Index channel = 0; channel < 3; ++channel)
                cloud.sh_rest.row(channel * more + k) = c.row(channel);
        }
    move_cloud(cloud, p.pose);
    return cloud;
}

/// Turns a cloud between glTF's axes and those of a PLY, by signs.
template <Real T>
void flip_axes(GaussianCloud<T>& cloud) {
    cloud.mean.bottomRows(2) *= T(-1);
    cloud.rotation.bottomRows(2) *= T(-1);
    const Index more = cloud.sh_rest.rows() / 3;
    for (Index r = 0; r < cloud.sh_rest.rows(); ++r)
        if (sh_half_turn[static_cast<std::size_t>(r % more)] < 0) cloud.sh_rest.row(r) *= T(-1);
}

} // namespace detail

/// Returns the Gaussians in the bytes of a .gltf or GLB file; messages begin with `who`. `outside`
/// reads buffers that are files of their own; without it they are an error. A primitive of a lower
/// degree than another's has zeros above it. Throws an Error for a file without Gaussians or with
/// those stated above, damage, numbers that are not finite or out of bounds, a required extension
/// that is not read, and, before they are allocated, for more bytes than `memory`.
template <Real T>
GaussianCloud<T> parse_gltf(ByteSpan bytes, const std::string& who,
                            std::uint64_t memory = default_memory,
                            const detail::GltfBuffer& outside = {}) {
    detail::GltfFile file(bytes, who, memory, outside);
    bool quantized = false;
    if (const JsonValue* value = file.root().find("extensionsRequired"))
        if (const JsonArray* names = value->get<JsonArray>())
            for (const JsonValue& entry : *names) {
                const auto* name = entry.get<std::string>();
                const bool positions = name && *name == "KHR_mesh_quantization";
                quantized = quantized || positions;
                require(positions || (name && *name == detail::gltf_splats), who,
                        "extensionsRequired has ", json_text(entry).substr(0, 100),
                        ", which is not read");
            }
    const std::vector<detail::GltfPrimitive> list = detail::gltf_primitives(file);
    require(!list.empty(), who, "its scene has no primitive with KHR_gaussian_splatting");
    std::uint64_t count = 0;
    int degree = 0;
    for (const detail::GltfPrimitive& p : list) {
        count = detail::saturated_sum(count, p.count);
        degree = std::max(degree, p.degree);
    }
    constexpr auto most = static_cast<std::uint64_t>(std::numeric_limits<Index>::max());
    // Twice: those of one primitive, and all.
    const std::uint64_t need =
        GaussianCloud<T>::memory(static_cast<Index>(std::min(count, most)), degree);
    require_memory(saturated_product(2, need), memory, who,
                   "its " + std::to_string(count) + " Gaussians");
    std::vector<GaussianCloud<T>> parts; // whose data are there, before all are allocated
    for (const detail::GltfPrimitive& p : list)
        parts.push_back(detail::gltf_cloud<T>(file, p, quantized));
    GaussianCloud<T> all(static_cast<Index>(count), degree);
    all.sh_rest.setZero();
    const Index rows = all.sh_rest.rows() / 3;
    Index at = 0;
    for (const GaussianCloud<T>& part : parts) {
        const Index n = part.count(), own = part.sh_rest.rows() / 3;
        all.mean.middleCols(at, n) = part.mean;
        all.sh_constant.middleCols(at, n) = part.sh_constant;
        all.logit_opacity.middleCols(at, n) = part.logit_opacity;
        all.log_scale.middleCols(at, n) = part.log_scale;
        all.rotation.middleCols(at, n) = part.rotation;
        for (Index c = 0; c < 3; ++c)
            all.sh_rest.block(c * rows, at, own, n) = part.sh_rest.middleRows(c * own, own);
        at += n;
    }
    detail::flip_axes(all);
    detail::check_storable(all, who); // after transforms, too
    return all;
}

} // namespace rye
