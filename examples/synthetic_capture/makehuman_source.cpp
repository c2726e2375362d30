// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/makehuman_source.hpp"

#include <algorithm>

#include <rye/core/error.hpp>

#include "synthetic_capture/makehuman_tables.hpp"

namespace rye::trainer::makehuman {

std::string replaced(std::string_view text, char what, std::string_view by) {
    std::string out;
    for (const char c : text)
        if (c == what)
            out += by;
        else
            out += c;
    return out;
}

Source::Source(const std::filesystem::path& folder) : folder_(folder) {
    const std::filesystem::path path = folder / "base.obj";
    mesh = parse_quads(read_plain_or_gz(path), path.string());
    require(mesh.vertices.cols() == base_vertices, path.string(), "got ", mesh.vertices.cols(),
            " vertices, expected the ", base_vertices, " of MakeHuman's base mesh hm08");
}

Points Source::target(const std::string& name) const {
    const std::filesystem::path path = folder_ / "targets" / (name + ".target");
    return parse_target(read_plain_or_gz(path), mesh.vertices.cols(), path.string());
}

Points Source::both(std::string_view name) const {
    if (name.find('*') == std::string_view::npos) return target(std::string(name));
    return target(replaced(name, '*', "l")) + target(replaced(name, '*', "r"));
}

std::vector<Index> group_vertices(const QuadMesh& mesh, const std::string& name) {
    std::vector<Index> list;
    for (std::size_t f = 0; f < mesh.faces.size(); ++f)
        if (mesh.groups[mesh.group[f]] == name)
            list.insert(list.end(), mesh.faces[f].vertex.begin(), mesh.faces[f].vertex.end());
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
    require(!list.empty(), "MakeHuman's base mesh", "has no group '", name, "'");
    return list;
}

} // namespace rye::trainer::makehuman
