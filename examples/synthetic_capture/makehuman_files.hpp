// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/makehuman_files.hpp: MakeHuman's files: the base mesh (an OBJ of quads with
/// groups) and targets, which are displacements of its vertices; each plain or as .gz.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "synthetic_capture/head_model.hpp"

namespace rye::trainer {

/// A face of four corners.
struct Quad {
    std::array<Index, 4> vertex{}, uv{};
};

/// A mesh of quads with texture coordinates; each face belongs to a group.
struct QuadMesh {
    Points vertices;    ///< 3 x V
    Columns<double> uv; ///< 2 x U, v points up
    std::vector<Quad> faces;
    std::vector<std::size_t> group;  ///< of each face, a number in `groups`
    std::vector<std::string> groups; ///< names, in the order of the file
};

/// Parses an OBJ of quads with texture coordinates. Throws an Error that names the line and the
/// value.
QuadMesh parse_quads(std::string_view text, const std::string& name);

/// Parses a target, lines of "vertex dx dy dz": displacements (3 x V) of a mesh of `count`
/// vertices. Throws an Error that names the line and the value.
Points parse_target(std::string_view text, Index count, const std::string& name);

/// Contents of `path` or of `path` + ".gz". Throws an Error that names the file if neither exists.
std::string read_plain_or_gz(const std::filesystem::path& path);

} // namespace rye::trainer
