// SPDX-License-Identifier: Apache-2.0
/// corrections/labels.hpp: errors of a capture's labels, found from the labels of all frames and from
/// the irises in its pictures, and their correction before a training. Only training frames are
/// changed. Labels that are right to within the bounds keep their bits. Source:
/// rye/train/label_consistency.hpp; docs/refine.md.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <rye/geometry/rigid.hpp>

#include "data/capture.hpp"
#include "data/samples.hpp"

namespace rye::trainer {

/// Finding about one kind of label.
struct LabelFinding {
    std::string label;  ///< "head poses"
    double off = 0;     ///< root mean square error, in `unit`
    double bound = 0;   ///< largest error that is not corrected
    std::string unit;   ///< "deg" or "mm"
    bool wrong = false; ///< true above the bound: corrected if correction was asked for
    std::string remedy; ///< the correction
};

/// Findings about all labels.
struct LabelFindings {
    std::vector<LabelFinding> all;
    std::vector<std::string> not_judged; ///< sentences: the label, and the reason
    std::vector<std::pair<std::string, double>> worst; ///< worst frames first [deg of gaze]
    bool poses = false, gazes = false; ///< true if corrected
    /// Motions of the world that landmarks and vertices of training frames were moved by, in their
    /// order; empty if they were not.
    std::vector<Rigid<double>> moved;

    bool empty() const { return all.empty() && not_judged.empty(); }
    std::vector<std::string> lines() const;
    nlohmann::ordered_json json() const;
};

/// Judges the labels of the training frames of a capture with gazes, and corrects wrong ones in it.
/// Deterministic: the same capture gives the same bits.
LabelFindings correct_labels(Capture& capture, const TrainConfig& config);

/// Lets stage 2 refine the corrected labels further: gazes (with a kappa) and head poses of each
/// frame become parameters, unless the configuration has delta_gaze or centre_corrections already.
/// Changes nothing if nothing was corrected. Returns a sentence, or an empty text.
std::string refine_further(const LabelFindings& findings, TrainConfig& config);

} // namespace rye::trainer
