// SPDX-License-Identifier: Apache-2.0
/// data/config_difference.hpp: the first field in which two configurations differ, of all fields or
/// of those that stage 1 reads.
#pragma once

#include <string>

#include "data/config.hpp"

namespace rye::trainer {

/// Returns "field 'a.b': got X, expected Y" for the first field in which two configurations as JSON
/// differ; empty if they do not.
std::string first_difference(const nlohmann::ordered_json& got,
                             const nlohmann::ordered_json& wanted, const std::string& path = "");

/// Returns the fields that stage 1 reads, a part of to_json(config). Runs that agree in them and
/// train on the same capture with the same backend have the same stage 1, bit for bit.
nlohmann::ordered_json stage_one_fields(const TrainConfig& config);

} // namespace rye::trainer
