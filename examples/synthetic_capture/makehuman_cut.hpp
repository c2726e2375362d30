// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/makehuman_cut.hpp: head and neck cut out of MakeHuman's base mesh, subdivided
/// once, with vertices in the order of their parts.
#pragma once

#include "synthetic_capture/subdivision.hpp"

namespace rye::trainer::makehuman {

/// Names of the parts, which are ICT-FaceKit's; MakeHuman's head lacks some.
constexpr std::array part_names{"face",
                                "head_neck",
                                "mouth_socket",
                                "eye_socket_left",
                                "eye_socket_right",
                                "gums_tongue",
                                "teeth",
                                "sclera_left",
                                "iris_left",
                                "sclera_right",
                                "iris_right",
                                "lacrimal_left",
                                "lacrimal_right",
                                "eye_blend_left",
                                "eye_blend_right",
                                "eye_occlusion_left",
                                "eye_occlusion_right",
                                "eyelashes_left",
                                "eyelashes_right"};
constexpr int face = 0, head_neck = 1, mouth_socket = 2, tongue = 5, teeth = 6, left_eye = 7,
              right_eye = 9;
/// Number of the faces of the eye sockets and of all that is not of the head, which are left out.
constexpr int socket = -2, elsewhere = -1;

/// Returns the part of each face of the base mesh.
std::vector<int> parts_of(const QuadMesh& mesh);

/// The head cut out of the base mesh and subdivided: which vertices, and how they are made.
struct Cut {
    std::vector<Index> kept;                                     ///< vertices of the base mesh
    Subdivision mesh;                                            ///< of the kept ones
    std::vector<int> parts;                                      ///< of its faces
    std::vector<Index> order;                                    ///< its vertices, by part
    std::vector<Index> place;                                    ///< in the order, of each vertex
    std::array<std::array<Index, 2>, part_names.size()> range{}; ///< places of each part

    /// Subdivided columns in their order, of points or displacements of the base mesh.
    Points operator()(const Points& all) const {
        const Points made = Points(all(Eigen::all, kept)) * mesh.weights;
        return made(Eigen::all, order);
    }
};

Cut cut_head(const QuadMesh& base);

} // namespace rye::trainer::makehuman
