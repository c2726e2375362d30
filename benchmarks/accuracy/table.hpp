// SPDX-License-Identifier: Apache-2.0
/// benchmarks/accuracy/table.hpp: the tables of the program, printed and as CSV.
#pragma once

#include <cstdio>
#include <string>
#include <vector>

namespace rye::bench {

/// One line of accuracy.csv. NaN where something was not measured.
struct PriceRow {
    std::string kind; ///< preset, or the setting changed
    std::string name, scene;
    double largest, rms, psnr;
    double g_relative, g_cosine, g_worst; ///< of the worst group
    double forward, both;                 ///< time over Exact32's, forward and with the vjp
};

/// One line of primitives.csv.
struct PrimitiveRow {
    std::string name;
    double ulp, relative, ns;
    std::string range;
    bool exhaustive;
};

struct Settings {
    std::string csv = "accuracy.csv", primitives_csv = "primitives.csv", ply;
    int repeats = 7;
    bool exhaustive = false;
    bool prices = true, primitives = true, learning = true, selection = false, training = true;
};

std::vector<PriceRow> price_list(const Settings&);
std::vector<PrimitiveRow> primitives(const Settings&);
void learning();
void training(int steps);
int selection(int scenes); ///< number of held-out scenes that exceed their bound

} // namespace rye::bench
