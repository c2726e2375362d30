// SPDX-License-Identifier: Apache-2.0
/// data/config_difference.hpp: in which field two configurations differ, all of them or those that
/// stage 1 reads.
#pragma once

#include <string>

#include "data/config.hpp"

namespace rye::trainer {

/// "field 'a.b': got X, expected Y" of the first field in which two configurations as JSON differ;
/// empty if they do not.
std::string first_difference(const nlohmann::ordered_json& got,
                             const nlohmann::ordered_json& wanted, const std::string& path = "");

/// The fields that stage 1 reads, a part of to_json(config). Runs that agree in them and train on
/// the same capture by the same backend have the same stage 1, bit for bit.
nlohmann::ordered_json stage_one_fields(const TrainConfig& config);

} // namespace rye::trainer
