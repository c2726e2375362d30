// SPDX-License-Identifier: Apache-2.0
/// importers/face_mesh.hpp: facts of MediaPipe's face landmarker: the order of its 478 landmarks.
/// Eye 0 is the subject's left, as everywhere.
/// Source: MediaPipe's canonical face model and the connectors of its face landmarker (Kartynnik et
/// al., 2019; Ablavatski et al., 2020, for the irises).
#pragma once

#include <array>
#include <string_view>

namespace rye::trainer {

inline constexpr int face_landmarks = 478; ///< 468 of the face, then 5 of each iris
inline constexpr int skin_landmarks = 468;

/// Landmarks nearest to the 68 of iBUG.
inline constexpr std::array<int, 68> face_ibug{
    127, 234, 93,  58,  172, 136, 149, 148, 152, 377, 378, 365, 397, 288, 323, 454, 356,
    70,  63,  105, 66,  107, 336, 296, 334, 293, 300, 168, 197, 5,   4,   75,  97,  2,
    326, 305, 33,  160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380, 61,  39,  37,
    0,   267, 269, 291, 405, 314, 17,  84,  181, 78,  82,  13,  312, 308, 317, 14,  87};

/// The rim of an eye's lids, around it: clockwise in a picture of a face that looks at the camera.
inline constexpr std::array<std::array<int, 16>, 2> face_lids{
    {{362, 398, 384, 385, 386, 387, 388, 466, 263, 249, 390, 373, 374, 380, 381, 382},
     {33, 246, 161, 160, 159, 158, 157, 173, 133, 155, 154, 153, 145, 144, 163, 7}}};

/// The chin among iBUG's landmarks.
inline constexpr std::size_t ibug_chin = 8;
/// The middle of an iris; four places on its rim follow, the opposite ones two apart.
inline constexpr std::array<int, 2> face_iris{473, 468};

/// Returns true for coefficients that say where the eyes look, or nothing of the expression.
constexpr bool is_no_expression(std::string_view name) {
    return name.starts_with("eyeLook") || name == "_neutral";
}

} // namespace rye::trainer
