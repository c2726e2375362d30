// SPDX-License-Identifier: Apache-2.0
#include "training/begun.hpp"

#include <array>
#include <cstdint>
#include <fstream>

#include "data/config_difference.hpp"
#include "data/json.hpp"

namespace rye::trainer {

bool has_stage_one(const std::filesystem::path& run) {
    // A safetensors file: the header's length in 8 bytes, little-endian, then the header, JSON.
    std::ifstream file(checkpoint_path(run), std::ios::binary);
    std::array<unsigned char, 8> size{};
    if (!file.read(reinterpret_cast<char*>(size.data()), size.size())) return false;
    std::uint64_t length = 0;
    for (std::size_t i = size.size(); i-- > 0;) length = length << 8U | size[i];
    constexpr std::uint64_t most = 1U << 24U;
    if (length == 0 || length > most) return false;
    std::string text(static_cast<std::size_t>(length), ' ');
    if (!file.read(text.data(), static_cast<std::streamsize>(length))) return false;
    const auto json = json_or_discarded(text);
    const nlohmann::json none = nlohmann::json::object();
    const auto words = json.is_object() ? json.find("__metadata__") : none.end();
    return json.is_object() && words != json.end() && words->is_object() &&
           words->contains("stage") && words->at("stage") == "avatar";
}

void take_stage_one(const std::filesystem::path& run, TrainState& state) {
    const TrainState from = load_checkpoint(run);
    const std::string who = "--begin: " + run.string();
    require(from.stage == Stage::avatar, who,
            "this run is still in stage 1 (step " + std::to_string(from.step) +
                "), expected one in stage 2; go on with `rye train --out " + run.string() +
                " --resume`");
    const std::string difference =
        first_difference(stage_one_fields(from.config), stage_one_fields(state.config));
    require(difference.empty(), who, difference + ", as stage 1 of this run would have it");
    require(
        from.frames == state.frames && from.train_frames == state.train_frames, who,
        "its frames, drivers or cameras are not those of the capture in '" + state.capture + "'");
    require(from.config.avatar.expression == state.config.avatar.expression &&
                from.subject.neutral == state.subject.neutral &&
                from.subject.eye_centre == state.subject.eye_centre,
            who, "its subject is not that of the capture in '" + state.capture + "'");
    state.mesh = from.mesh;
}

} // namespace rye::trainer
