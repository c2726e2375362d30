// SPDX-License-Identifier: Apache-2.0
/// training/labels.hpp: how far a capture's labels are off, by what they say about each other and
/// by the irises in its pictures; and their correction before a training. Training frames alone:
/// others keep their labels. Labels that are right to within the bounds stay as they are, bit for
/// bit. Source: rye/train/label_consistency.hpp; docs/labels.md.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "data/capture.hpp"
#include "data/samples.hpp"

namespace rye::trainer {

/// What was found about one kind of label, and what was done.
struct LabelFinding {
    std::string label;  ///< "head poses"
    double off = 0;     ///< root mean square, in `unit`
    double bound = 0;   ///< up to which it stays
    std::string unit;   ///< "deg" or "mm"
    bool wrong = false; ///< above the bound: corrected where correction was asked for
    std::string remedy; ///< what corrects it
};

/// What was found about all.
struct LabelFindings {
    std::vector<LabelFinding> all;
    std::vector<std::string> not_judged; ///< sentences: which label, and why
    std::vector<std::pair<std::string, double>> worst; ///< frames, the worst first [deg of gaze]
    bool poses = false, gazes = false; ///< whether they were corrected

    bool empty() const { return all.empty() && not_judged.empty(); }
    std::vector<std::string> lines() const;
    nlohmann::ordered_json json() const;
};

/// Judges the labels of the training frames of a capture that has gazes, and corrects them in it.
/// Deterministic: the same capture gives the same bits.
LabelFindings correct_labels(Capture& capture, const TrainConfig& config);

/// Lets stage 2 go on with what was corrected: gazes, beside a kappa, and head poses of each frame
/// become parameters, unless the configuration has delta_gaze or centre_corrections already. Where
/// nothing was corrected, nothing changes. Returns a sentence, or an empty text.
std::string refine_further(const LabelFindings& findings, TrainConfig& config);

} // namespace rye::trainer
