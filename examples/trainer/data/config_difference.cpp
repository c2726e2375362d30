// SPDX-License-Identifier: Apache-2.0
#include "data/config_difference.hpp"

namespace rye::trainer {

using Json = nlohmann::ordered_json;

std::string first_difference(const Json& got, const Json& wanted, const std::string& path) {
    if (!got.is_object() || !wanted.is_object())
        return got == wanted
                   ? ""
                   : "field '" + path + "': got " + got.dump() + ", expected " + wanted.dump();
    for (const auto& [key, value] : wanted.items()) {
        const std::string here = path.empty() ? key : path + "." + key;
        if (!got.contains(key)) return "field '" + here + "' is missing";
        const std::string inner = first_difference(got.at(key), value, here);
        if (!inner.empty()) return inner;
    }
    return "";
}

Json stage_one_fields(const TrainConfig& config) {
    // All fields except those known to be read by stage 2 alone: a new field counts as read.
    Json fields = to_json(config);
    fields.erase("preset"); // a name
    Json& avatar = fields["avatar"];
    for (const char* name : {"attribute_scale", "gaze_mechanism", "eye_appearance", "shading",
                             "highlights", "lid_shadow", "refraction", "view_color"})
        avatar.erase(name);
    for (const char* name : {"exp_attributes", "pose_attributes"}) avatar["networks"].erase(name);
    fields["grid"].erase("subdivide");
    // The radius determines the assumed centres of a capture without measured eyeballs.
    const Json radius = fields["gaussians"]["eyeball"]["radius"];
    fields["gaussians"] = {{"eyeball", {{"radius", radius}}}};
    return fields;
}

} // namespace rye::trainer
