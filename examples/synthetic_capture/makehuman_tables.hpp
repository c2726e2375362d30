// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/makehuman_tables.hpp: places on MakeHuman's base mesh (hm08), and what its
/// targets are to a head: modes of identity and shapes of expressions.
/// Source: MakeHuman's base mesh and targets, CC0, www.makehumancommunity.org.
#pragma once

#include <array>
#include <string_view>

#include <rye/core/columns.hpp>

namespace rye::trainer::makehuman {

inline constexpr Index base_vertices = 19158;

/// Vertices of the 68 landmarks, in the order of iBUG: chosen once by geometry (rims of lids and
/// lips, extremes of the profile), mirrored, and nearest to ICT-FaceKit's on jaw and brows.
inline constexpr std::array<Index, 68> landmarks{
    5402,  5235,  5238,  5241, 737,  891,  5294, 5221, 5296, 11831, 11900, 7593,  7457,  11850,
    11847, 11844, 12001, 5261, 5260, 229,  230,  233,  7006, 7003,  7002,  11868, 11869, 133,
    131,   201,   5054,  360,  314,  317,  7077, 7121, 27,   0,     54,    66,    47,    41,
    6850,  6838,  6784,  6811, 6825, 6831, 404,  504,  458,  467,   7217,  7253,  7164,  7130,
    7241,  492,   486,   370,  440,  481,  474,  7236, 7200, 7237,  493,   482};

/// Vertices in the texture islands of the head's skin, the mouth's inside and the eye sockets.
/// Sockets are left out: eyeballs fill the lids, and a socket would show through thin skin.
inline constexpr Index nose_tip = 5054, palate = 696, left_socket = 11915, right_socket = 5310;

/// The head and neck: vertices of the body above `lowest` and nearer to the middle than `widest`
/// [dm].
inline constexpr double lowest = 4.95, widest = 1.25;

/// A mode of identity: weight times (target plus - target minus); * is both sides, l and r.
struct Mode {
    std::string_view name, plus, minus;
    double weight;
};

inline constexpr std::array kinds{"african", "asian", "caucasian"};
inline constexpr double gender_weight = 0.6, kind_weight = 0.45, age_weight = 0.2;

inline constexpr std::array modes{
    Mode{"head_width", "head/head-scale-horiz-incr", "head/head-scale-horiz-decr", 0.14},
    Mode{"head_depth", "head/head-scale-depth-incr", "head/head-scale-depth-decr", 0.14},
    Mode{"head_fat", "head/head-fat-incr", "head/head-fat-decr", 0.22},
    Mode{"head_oval", "head/head-oval", "head/head-square", 0.22},
    Mode{"head_triangular", "head/head-triangular", "head/head-invertedtriangular", 0.17},
    Mode{"forehead_height", "forehead/forehead-scale-vert-incr",
         "forehead/forehead-scale-vert-decr", 0.19},
    Mode{"forehead_depth", "forehead/forehead-trans-forward", "forehead/forehead-trans-backward",
         0.4},
    Mode{"brow_angle", "eyebrows/eyebrows-angle-up", "eyebrows/eyebrows-angle-down", 0.22},
    Mode{"brow_depth", "eyebrows/eyebrows-trans-forward", "eyebrows/eyebrows-trans-backward", 0.22},
    Mode{"eye_scale", "eyes/*-eye-scale-incr", "eyes/*-eye-scale-decr", 0.17},
    Mode{"eye_slant", "eyes/*-eye-corner2-up", "eyes/*-eye-corner2-down", 0.22},
    Mode{"eye_height", "eyes/*-eye-height2-incr", "eyes/*-eye-height2-decr", 0.17},
    Mode{"eye_distance", "eyes/*-eye-trans-out", "eyes/*-eye-trans-in", 0.22},
    Mode{"cheek_bones", "cheek/*-cheek-bones-incr", "cheek/*-cheek-bones-decr", 0.25},
    Mode{"cheek_volume", "cheek/*-cheek-volume-incr", "cheek/*-cheek-volume-decr", 0.22},
    Mode{"nose_width", "nose/nose-scale-horiz-incr", "nose/nose-scale-horiz-decr", 0.19},
    Mode{"nose_length", "nose/nose-scale-vert-incr", "nose/nose-scale-vert-decr", 0.17},
    Mode{"nose_depth", "nose/nose-scale-depth-incr", "nose/nose-scale-depth-decr", 0.19},
    Mode{"nose_hump", "nose/nose-hump-incr", "nose/nose-hump-decr", 0.22},
    Mode{"nose_point", "nose/nose-point-up", "nose/nose-point-down", 0.22},
    Mode{"nose_flaring", "nose/nose-flaring-incr", "nose/nose-flaring-decr", 0.22},
    Mode{"mouth_width", "mouth/mouth-scale-horiz-incr", "mouth/mouth-scale-horiz-decr", 0.19},
    Mode{"mouth_height", "mouth/mouth-trans-up", "mouth/mouth-trans-down", 0.17},
    Mode{"upper_lip", "mouth/mouth-upperlip-volume-incr", "mouth/mouth-upperlip-volume-decr", 0.22},
    Mode{"lower_lip", "mouth/mouth-lowerlip-volume-incr", "mouth/mouth-lowerlip-volume-decr", 0.22},
    Mode{"chin_width", "chin/chin-width-incr", "chin/chin-width-decr", 0.22},
    Mode{"chin_height", "chin/chin-height-incr", "chin/chin-height-decr", 0.17},
    Mode{"chin_depth", "chin/chin-prominent-incr", "chin/chin-prominent-decr", 0.22},
    Mode{"jaw_drop", "chin/chin-jaw-drop-incr", "chin/chin-jaw-drop-decr", 0.17},
    Mode{"ear_scale", "ears/*-ear-scale-incr", "ears/*-ear-scale-decr", 0.17},
    Mode{"ear_wing", "ears/*-ear-wing-incr", "ears/*-ear-wing-decr", 0.19},
    Mode{"neck_width", "neck/neck-scale-horiz-incr", "neck/neck-scale-horiz-decr", 0.19},
    Mode{"nose_asymmetry", "asym/asym-nose-1-l", "asym/asym-nose-1-r", 0.17},
    Mode{"jaw_asymmetry", "asym/asym-jaw-1-l", "asym/asym-jaw-1-r", 0.17},
};

/// Part of a target that a shape takes.
enum class Share { all, one_side, lower };

/// An expression: weight times a part of a target. A name that ends in _ stands for two, _L and _R.
/// In the target's name * is the folder of the units of expressions, ? left or right, and ! l or r.
/// The jaw alone moves teeth and tongue.
struct Expression {
    std::string_view name, target;
    double weight;
    Share share = Share::all;
};

inline constexpr std::array expressions{
    Expression{"browDown_", "*eyebrows-?-down", 1},
    Expression{"browInnerUp_", "*eyebrows-?-inner-up", 1},
    Expression{"browOuterUp_", "*eyebrows-?-extern-up", 1},
    Expression{"cheekPuff_", "cheek/!-cheek-volume-incr", 1},
    Expression{"eyeBlink_", "*eye-?-closure", 1},
    Expression{"eyeSquint_", "*eye-?-slit", 0.8},
    Expression{"eyeWide_", "*eye-?-opened-up", 1},
    Expression{"jawForward", "chin/chin-prognathism-incr", 0.8},
    Expression{"jawOpen", "*mouth-open", 1},
    Expression{"mouthFrown_", "*mouth-depression", 1, Share::one_side},
    Expression{"mouthFunnel", "*mouth-protusion", 1},
    Expression{"mouthLeft", "mouth/mouth-trans-out", 1},
    Expression{"mouthLowerDown_", "*mouth-depression-retraction", 1, Share::lower},
    Expression{"mouthPucker", "*mouth-pursing", 1},
    Expression{"mouthRight", "mouth/mouth-trans-in", 1},
    Expression{"mouthShrugLower", "*mouth-eversion", 1},
    Expression{"mouthSmile_", "*mouth-corner-puller", 1, Share::one_side},
    Expression{"mouthStretch_", "*mouth-retraction", 1, Share::one_side},
    Expression{"mouthUpperUp_", "*mouth-elevation", 1, Share::one_side},
    Expression{"noseSneer_", "*nose-?-elevation", 1},
};

} // namespace rye::trainer::makehuman
