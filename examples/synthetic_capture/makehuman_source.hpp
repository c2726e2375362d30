// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/makehuman_source.hpp: MakeHuman's folder: the base mesh, and targets by name.
#pragma once

#include "synthetic_capture/makehuman_files.hpp"

namespace rye::trainer::makehuman {

/// Returns a text with each character `what` replaced.
std::string replaced(std::string_view text, char what, std::string_view by);

class Source {
  public:
    /// Reads base.obj, plain or as .gz. Throws an Error if it is not MakeHuman's base mesh.
    explicit Source(const std::filesystem::path& folder);

    /// Reads a target by its path in targets/, without extension: displacements (3 x V).
    Points target(const std::string& name) const;
    /// Returns the sum over both sides of a target whose name has a *.
    Points both(std::string_view name) const;

    QuadMesh mesh;

  private:
    std::filesystem::path folder_;
};

/// Returns the vertices of a group of the base mesh, in ascending order.
std::vector<Index> group_vertices(const QuadMesh& mesh, const std::string& name);

} // namespace rye::trainer::makehuman
