// SPDX-License-Identifier: Apache-2.0
#include "run.hpp"

#include <cmath>
#include <type_traits>

#include <rye/avatar/hold.hpp>
#include <rye/train/checkpoint.hpp>

#include "json_io.hpp"

namespace rye::trainer {
namespace {

constexpr const char* format_name = "rye-checkpoint";
constexpr const char* format_version = "1";

Columns<double> as_columns(const std::vector<Index>& list) {
    Columns<double> c(1, static_cast<Index>(list.size()));
    for (std::size_t i = 0; i < list.size(); ++i) c(0, static_cast<Index>(i)) = double(list[i]);
    return c;
}

std::vector<Index> as_list(const Columns<double>& c) {
    std::vector<Index> list;
    for (Index i = 0; i < c.cols(); ++i) list.push_back(static_cast<Index>(c(0, i)));
    return list;
}

/// The subject as arrays, in one place for both directions.
struct SubjectArrays {
    Columns<double> expression, eye0, eye1, neutral, head_centre, eye_centre, eye_sizes;

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        f("roles.expression", p.expression...);
        f("roles.left_eye", p.eye0...);
        f("roles.right_eye", p.eye1...);
        f("neutral_landmarks", p.neutral...);
        f("head_centre", p.head_centre...);
        f("eye_centre", p.eye_centre...);
        f("eye_sizes", p.eye_sizes...);
    }
};

SubjectArrays arrays_of(const Subject& s) {
    SubjectArrays a{as_columns(s.roles.expression), as_columns(s.roles.eye[0]),
                    as_columns(s.roles.eye[1]), s.neutral, s.head_centre, Columns<double>(3, 2),
                    Columns<double>(3, 2)};
    for (std::size_t e = 0; e < 2; ++e) {
        a.eye_centre.col(static_cast<Index>(e)) = s.eye_centre[e];
        a.eye_sizes.col(static_cast<Index>(e)) << s.eye_radius[e], s.limbus_radius[e], s.iris_plane[e];
    }
    return a;
}

Subject subject_of(const SubjectArrays& a, bool measured) {
    Subject s;
    s.roles.expression = as_list(a.expression);
    s.roles.eye = {as_list(a.eye0), as_list(a.eye1)};
    s.neutral = a.neutral;
    s.head_centre = a.head_centre.col(0);
    for (std::size_t e = 0; e < 2; ++e) {
        s.eye_centre[e] = a.eye_centre.col(static_cast<Index>(e));
        s.eye_radius[e] = a.eye_sizes(0, static_cast<Index>(e));
        s.limbus_radius[e] = a.eye_sizes(1, static_cast<Index>(e));
        s.iris_plane[e] = a.eye_sizes(2, static_cast<Index>(e));
    }
    s.measured_eyes = measured;
    return s;
}

} // namespace

void save_checkpoint(const std::filesystem::path& run, const TrainState& state) {
    const SubjectArrays subject = arrays_of(state.subject);
    std::vector<TensorEntry> entries;
    append_fields("subject", subject, entries);
    append_fields("mesh", state.mesh, entries);
    if (state.stage == Stage::mesh) {
        append_adam("mesh_adam", state.mesh_adam, entries);
    } else if (state.visual) {
        append_fields("avatar", state.visual->avatar, entries);
        append_adam("avatar_adam", state.visual->adam, entries);
    } else {
        append_fields("avatar", state.avatar, entries);
        append_adam("avatar_adam", state.avatar_adam, entries);
    }
    const std::vector<std::int64_t> frames(state.train_frames.begin(), state.train_frames.end());
    entries.push_back(tensor_entry<std::int64_t>("train_frames", {static_cast<Index>(frames.size())},
                                                 frames));
    const TensorMetadata metadata{
        {"format", format_name},
        {"version", format_version},
        {"stage", state.stage == Stage::mesh ? "mesh" : "avatar"},
        {"step", std::to_string(state.step)},
        {"capture", state.capture},
        {"expression", std::to_string(state.config.avatar.expression)},
        {"measured_eyes", state.subject.measured_eyes ? "true" : "false"},
        {"config", to_json(state.config).dump()},
    };
    write_safetensors(checkpoint_path(run), entries, metadata);
}

TrainState load_checkpoint(const std::filesystem::path& run) {
    const std::filesystem::path path = checkpoint_path(run);
    const std::string who = path.string();
    require(std::filesystem::exists(path), who,
            "there is no checkpoint here, expected a run made by `rye train --out " + run.string() + "`");
    const Safetensors file = read_safetensors(path);
    const auto word = [&](const std::string& key) { return file.word(key); };
    require(word("format") == format_name, who,
            "metadata 'format': got '" + word("format") + "', expected '" + format_name + "'");
    require(word("version") == format_version, who,
            "metadata 'version': got '" + word("version") + "', expected '" + format_version + "'");
    TrainState s;
    const auto number = [&](const std::string& key) {
        const std::string& text = word(key);
        std::size_t used = 0;
        long value = -1;
        try {
            value = std::stol(text, &used);
        } catch (const std::exception&) {
        }
        require(used == text.size() && used > 0 && value >= 0, who,
                "metadata '" + key + "': got '" + text + "', expected a count");
        return value;
    };
    try {
        s.config = preset("paper");
        const std::string config_who = who + ": metadata 'config'";
        from_json(parse_json_text<nlohmann::ordered_json>(word("config"), config_who), who,
                  s.config);
    } catch (const nlohmann::json::exception& e) {
        throw Error(who + ": metadata 'config': " + e.what());
    }
    require(word("stage") == "mesh" || word("stage") == "avatar", who,
            "metadata 'stage': got '" + word("stage") + "', expected 'mesh' or 'avatar'");
    s.stage = word("stage") == "mesh" ? Stage::mesh : Stage::avatar;
    s.step = number("step");
    s.capture = word("capture");
    s.config.avatar.expression = static_cast<int>(number("expression"));
    SubjectArrays subject;
    load_fields(file, "subject", subject);
    s.subject = subject_of(subject, word("measured_eyes") == "true");
    const std::vector<std::int64_t> frames =
        file.values<std::int64_t>("train_frames", file.at("train_frames").shape);
    s.train_frames.assign(frames.begin(), frames.end());

    const AvatarConfig& c = s.config.avatar;
    s.mesh = Mesh::init(c, s.subject.neutral.cast<float>(), Random{0, 0});
    load_fields(file, "mesh", s.mesh);
    if (s.stage == Stage::mesh) {
        s.mesh_adam = Adam<Mesh>(s.mesh);
        load_adam(file, "mesh_adam", s.mesh_adam);
        return s;
    }
    // Networks have the shapes that the configuration says; clouds have those of the file.
    UpsamplerShape shape = s.config.gaussians.upsampler;
    shape.in_channels = c.channels;
    s.avatar.upsampler = Upsampler<float>(shape);
    s.avatar.face.networks = s.mesh.networks;
    s.avatar.face.exp_attributes =
        Mlp<float>(mlp_shape(c.feature, c.expression, c.networks.exp_attributes, 8));
    s.avatar.face.pose_attributes =
        Mlp<float>(mlp_shape(c.feature, c.pose_code(), c.networks.pose_attributes, 8));
    s.avatar.eyes.offset = s.mesh.eye_offset;
    const bool visual = s.config.gaze_axis == GazeAxis::visual;
    require(visual == file.has("avatar.eyes.kappa"), who,
            visual ? "there is no tensor 'avatar.eyes.kappa', expected one: the run's gaze_axis is "
                     "'visual'"
                   : "got a tensor 'avatar.eyes.kappa', expected none: the run's gaze_axis is "
                     "'optical'");
    const auto agree = [&](const char* name, const auto& a, Index rows, Index cols) {
        require(a.rows() == rows && a.cols() == cols, who,
                std::string("tensor 'avatar.") + name + "': got shape (" + std::to_string(a.cols()) +
                    ", " + std::to_string(a.rows()) + "), expected (" + std::to_string(cols) + ", " +
                    std::to_string(rows) + ")");
    };
    const auto load = [&](auto& avatar, auto& adam) {
        load_fields(file, "avatar", avatar);
        const auto& f = avatar.face;
        const auto& e = avatar.eyes;
        const Index n = f.position.cols(), m = e.position.cols();
        agree("face.xyz", f.position, 3, n);
        agree("face.feature", f.feature, c.feature, n);
        agree("face.scales", f.log_scale, 3, n);
        agree("face.rotation", f.rotation, 4, n);
        agree("face.opacity", f.opacity_logit, 1, n);
        agree("eyes.xyz", e.position, 3, m / 2 * 2);
        agree("eyes.feature", e.feature, c.channels, m);
        agree("eyes.scales", e.log_scale, 3, m);
        agree("eyes.rotation", e.rotation, 4, m);
        agree("eyes.opacity", e.opacity_logit, 1, m);
        agree("eyes.centre", e.centre, 3, 2);
        agree("eyes.spacing", e.spacing, 1, m);
        agree("face.landmarks_3d_neutral", f.landmarks, 3, s.subject.neutral.cols());
        adam = Adam<std::remove_reference_t<decltype(avatar)>>(avatar);
        load_adam(file, "avatar_adam", adam);
    };
    if (visual) {
        VisualTraining& t = s.visual.emplace();
        t.avatar = restricted<VisualEffects>(s.avatar);
        t.avatar.eyes.kappa = Columns<float>::Zero(2, 2);
        s.avatar = {};
        load(t.avatar, t.adam);
    } else {
        load(s.avatar, s.avatar_adam);
    }
    return s;
}

TrainState load_trained(const std::filesystem::path& run) {
    const TrainState s = load_checkpoint(run);
    require(s.stage == Stage::avatar, run.string(),
            "this run is still in stage 1 (step " + std::to_string(s.step) +
                "), expected one with Gaussians; continue it with `rye train --resume`");
    return drawn_state(s);
}

TrainState drawn_state(const TrainState& state) {
    TrainState s;
    s.stage = state.stage;
    s.step = state.step;
    s.config = state.config;
    s.capture = state.capture;
    s.subject = state.subject;
    s.train_frames = state.train_frames;
    if (state.visual) {
        s.avatar = restricted<TrainEffects>(state.visual->avatar);
        s.kappa = state.visual->avatar.eyes.kappa;
    } else {
        s.avatar = state.avatar;
        s.kappa = state.kappa;
    }
    return s;
}

Drivers<float> optical_drivers(const TrainState& drawn, const Drivers<float>& drivers) {
    Drivers<float> d = drivers;
    if (drawn.kappa.size() > 0)
        for (std::size_t eye = 0; eye < 2; ++eye)
            d.gaze[eye] = apply_kappa<float>(drivers.gaze[eye], kappa_of(drawn.kappa, eye));
    return d;
}

} // namespace rye::trainer
