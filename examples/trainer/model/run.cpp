// SPDX-License-Identifier: Apache-2.0
#include "model/run.hpp"

#include <charconv>
#include <cmath>
#include <limits>

#include <rye/avatar/hold.hpp>
#include <rye/train/checkpoint.hpp>

#include "data/checksums.hpp"
#include "data/json.hpp"
#include "model/trained_parts.hpp"

namespace rye::trainer {
namespace {

constexpr const char* format_name = "rye-checkpoint";
constexpr const char* format_version = "1";
constexpr Index most_steps = 1'000'000'000;       // as in the configuration
constexpr Index most_expressions = 1'000'000;
constexpr Index sparse_landmarks = 66;            // eyes and lips are among these

using Json = nlohmann::ordered_json;

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

/// Arrays of the subject, for writing and reading alike.
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

template <class F>
void for_avatar(const TrainState& state, F&& f) {
    if (state.stage == Stage::mesh) return;
    if (state.compared) f(state.compared->avatar, state.compared->adam);
    else f(state.avatar, state.avatar_adam);
}

void require_finite(const std::string& who, const std::string& name, const auto& a,
                    bool also_positive = false) {
    const auto sound = [&](Index i) { return std::isfinite(a(i)) && !(also_positive && a(i) < 0); };
    Index i = 0;
    while (i < a.size() && sound(i)) ++i;
    if (i == a.size()) return; // building the message costs more than the check
    throw Error(who + ": tensor '" + name + "': value " + std::to_string(i) + " is " +
                std::to_string(a(i)) + ", expected " +
                (also_positive ? "a finite number, 0 or more" : "a finite number"));
}

/// Throws an Error for parameters or moments of the optimiser that are not finite.
template <class P>
void require_finite(const std::string& who, const std::string& prefix, const P& p,
                    const Adam<P>* adam, const std::string& adam_prefix) {
    const auto check = [&](const std::string& name, const auto& a) {
        require_finite(who, prefix + "." + name, a);
    };
    P::fields(check, p);
    if constexpr (requires { P::buffers(check, p); }) P::buffers(check, p);
    if (adam == nullptr) return;
    P::fields([&](const std::string& name, const auto& m, const auto& v) {
        require_finite(who, adam_prefix + ".m." + name, m);
        require_finite(who, adam_prefix + ".v." + name, v, true);
    }, adam->m, adam->v);
}

/// Throws an Error, which begins with `who`, unless every number of the state is finite.
void require_finite(const TrainState& state, const std::string& who) {
    const bool mesh = state.stage == Stage::mesh;
    require_finite(who, "mesh", state.mesh, mesh ? &state.mesh_adam : nullptr, "mesh_adam");
    for_avatar(state, [&](const auto& avatar, const auto& adam) {
        require_finite(who, "avatar", avatar, &adam, "avatar_adam");
    });
}

/// Returns the number of parameters of a configuration's networks, in double: sizes may be
/// arbitrary.
double network_numbers(const TrainConfig& config, bool with_avatar) {
    const AvatarConfig& c = config.avatar;
    const NetworkConfig& n = c.networks;
    double sum = 0;
    const auto add = [&](int inputs, int frame_inputs, const std::vector<int>& hidden, int outputs) {
        const MlpShape s = mlp_shape(inputs, frame_inputs, hidden, outputs);
        for (int l = 0; l < s.layers(); ++l)
            sum += (static_cast<double>(s.fan_in(l)) + 1) * s.layer_out(l);
    };
    const int xyz = c.position_code(), pose = c.pose_code(), gaze = c.gaze_code();
    add(xyz, 0, n.geometry, 4 + c.feature);
    add(c.feature, c.expression, n.exp_color, c.channels);
    add(xyz, c.expression, n.exp_deform, 3);
    add(c.feature, pose, n.pose_color, c.channels);
    add(xyz, pose, n.pose_deform, 3);
    for (int eye = 0; eye < 2; ++eye) {
        add(xyz, gaze, n.gaze_deform, 3);
        add(c.feature, gaze, n.gaze_color, c.channels);
    }
    add(c.expression + pose, 0, n.eye_offset, 6);
    if (!with_avatar) return sum;
    if (config.eye_appearance == EyeAppearanceName::driven)
        for (int eye = 0; eye < 2; ++eye) {
            const MlpShape s = DrivenFeatures::shape({c.channels, 0, c.expression, 6});
            for (int l = 0; l < s.layers(); ++l)
                sum += (static_cast<double>(s.fan_in(l)) + 1) * s.layer_out(l);
        }
    add(c.feature, c.expression, n.exp_attributes, 8);
    add(c.feature, pose, n.pose_attributes, 8);
    UpsamplerShape u = config.gaussians.upsampler;
    u.in_channels = c.channels;
    for (int l = 0; l < u.layers(); ++l)
        sum += 9. * u.layer_in(l) * u.block_out(l / 2);
    return sum;
}

/// Checks the columns of landmarks that a tensor lists: whole numbers below `count`.
void require_columns_of(const std::string& who, const char* name, const Columns<double>& list,
                        Index count) {
    require(list.rows() == 1 && list.cols() >= 1, who,
            std::string("tensor 'subject.") + name + "': got " + std::to_string(list.cols()) +
                " columns of " + std::to_string(list.rows()) + ", expected at least one of one");
    for (Index i = 0; i < list.cols(); ++i)
        require(list(0, i) >= 0 && list(0, i) < static_cast<double>(count) &&
                    list(0, i) == std::floor(list(0, i)),
                who, std::string("tensor 'subject.") + name + "': value " + std::to_string(i) +
                         " is " + std::to_string(list(0, i)) +
                         ", expected a whole number from 0 to " + std::to_string(count - 1));
}

/// Checks shapes, then ranges, of the arrays that load_fields has read.
void check_subject(const std::string& who, const SubjectArrays& a) {
    const Index landmarks = a.neutral.cols();
    require(a.neutral.rows() == 3 && landmarks >= sparse_landmarks, who,
            "tensor 'subject.neutral_landmarks': got shape (" + std::to_string(landmarks) + ", " +
                std::to_string(a.neutral.rows()) + "), expected (N, 3) with N " +
                std::to_string(sparse_landmarks) + " or more");
    require_columns_of(who, "roles.expression", a.expression, landmarks);
    require_columns_of(who, "roles.left_eye", a.eye0, landmarks);
    require_columns_of(who, "roles.right_eye", a.eye1, landmarks);
    SubjectArrays::fields([&](const std::string& name, const auto& x) {
        require_finite(who, "subject." + name, x);
    }, a);
    for (Index e = 0; e < 2; ++e)
        require_eyeball({a.eye_sizes(0, e), a.eye_sizes(1, e), a.eye_sizes(2, e)},
                        who + ": tensor 'subject.eye_sizes'");
}

/// Checks the optimiser's counts, which load_fields and load_adam cannot check.
template <class P>
void check_counts(const std::string& who, const std::string& prefix, const P& p,
                  const Adam<P>& adam) {
    std::size_t fields = 0;
    P::fields([&](const std::string&, const auto&) { ++fields; }, p);
    require(adam.step >= 0 && adam.step <= most_steps, who,
            "tensor '" + prefix + ".step': got " + std::to_string(adam.step) +
                ", expected 0 to " + std::to_string(most_steps));
    require(adam.field_steps.empty() || adam.field_steps.size() == fields, who,
            "tensor '" + prefix + ".field_steps': got " + std::to_string(adam.field_steps.size()) +
                " counts, expected none or " + std::to_string(fields));
    for (const Index n : adam.field_steps)
        require(n >= 0 && n <= adam.step, who,
                "tensor '" + prefix + ".field_steps': got " + std::to_string(n) +
                    ", expected 0 to " + std::to_string(adam.step));
}

/// Metadata of a checkpoint.
struct Words {
    const Safetensors& file;
    const std::string& who;

    const std::string& operator()(const std::string& key) const { return file.word(key); }
    /// Returns true for the first of two words; throws an Error for a third.
    bool first(const std::string& key, const std::string& yes, const std::string& no) const {
        const std::string& got = file.word(key);
        require(got == yes || got == no, who,
                "metadata '" + key + "': got '" + got + "', expected '" + yes + "' or '" + no + "'");
        return got == yes;
    }
    Index number(const std::string& key, Index most) const {
        const std::string& text = file.word(key);
        Index value = 0;
        const auto [end, fault] = std::from_chars(text.data(), text.data() + text.size(), value);
        require(fault == std::errc() && end == text.data() + text.size() && value >= 0 &&
                    value <= most,
                who, "metadata '" + key + "': got '" + text + "', expected a whole number from 0 to " +
                         std::to_string(most));
        return value;
    }
};

/// Throws an Error unless the file is large enough for the networks of its configuration: nothing
/// is allocated by sizes that only the metadata claim.
void require_networks_in(const Safetensors& file, const TrainConfig& config, Stage stage,
                         const std::string& who) {
    double held = 0;
    for (const auto& [name, t] : file.tensors())
        held += static_cast<double>(t.bytes.size() / info_of(t.type).size);
    const double wanted = network_numbers(config, stage == Stage::avatar);
    require(wanted <= held, who,
            "metadata 'config': its networks have " + Json(wanted).dump() +
                " numbers, but all tensors of the file have " + Json(held).dump());
}

template <class A>
void check_clouds(const std::string& who, const A& avatar, const TrainState& s) {
    const auto agree = [&](const char* name, const auto& a, Index rows, Index cols) {
        require(a.rows() == rows && a.cols() == cols, who,
                std::string("tensor 'avatar.") + name + "': got shape (" + std::to_string(a.cols()) +
                    ", " + std::to_string(a.rows()) + "), expected (" + std::to_string(cols) + ", " +
                    std::to_string(rows) + ")");
    };
    const AvatarConfig& c = s.config.avatar;
    const auto& f = avatar.face;
    const auto& e = avatar.eyes;
    const Index n = std::max<Index>(f.position.cols(), 1), m = std::max<Index>(e.position.cols(), 2);
    agree("face.xyz", f.position, 3, n);
    agree("face.feature", f.feature, c.feature, n);
    agree("face.scales", f.log_scale, 3, n);
    agree("face.rotation", f.rotation, 4, n);
    agree("face.opacity", f.opacity_logit, 1, n);
    agree("eyes.xyz", e.position, 3, m);
    if constexpr (requires { e.feature; })
        agree("eyes.feature", e.feature, c.channels, m);
    else
        require_mechanism_fits(avatar, c.channels, who);
    agree("eyes.scales", e.log_scale, 3, m);
    agree("eyes.rotation", e.rotation, 4, m);
    agree("eyes.opacity", e.opacity_logit, 1, m);
    agree("eyes.centre", e.centre, 3, 2);
    agree("eyes.spacing", e.spacing, 1, m);
    agree("face.landmarks_3d_neutral", f.landmarks, 3, s.subject.neutral.cols());
    if constexpr (std::same_as<A, Avatar>) require_kappa_fits(avatar, s.config, who);
    if constexpr (requires { avatar.view_color.face; })
        if (s.config.view_color > 0) {
            const Index numbers = view_color_numbers(s.config.view_color);
            agree("view_color.face", avatar.view_color.face, numbers, n);
            agree("view_color.eyes", avatar.view_color.eyes, numbers, m);
        }
    if constexpr (requires { avatar.shading.light; }) {
        if (s.config.shading == ShadingName::none) return;
        agree("shading.light", avatar.shading.light, 8, 3);
        agree("shading.normal", avatar.shading.normal, 3, n);
        agree("shading.eye_normal", avatar.shading.eye_normal, 3, 2);
    }
}

/// Key of the number of points of the left eyeball, written if the two differ.
constexpr const char* left_points_key = "left_eye_points";

template <class A>
void load_avatar(const Safetensors& file, const Words& word, const TrainState& s, A& avatar,
                 Adam<A>& adam) {
    load_fields(file, "avatar", avatar);
    check_clouds(word.who, avatar, s);
    const Index points = avatar.eyes.position.cols();
    if (file.metadata().count(left_points_key) != 0) {
        avatar.eyes.left_points = word.number(left_points_key, points - 1);
        require(avatar.eyes.left_points > 0, word.who,
                std::string("metadata '") + left_points_key + "': got 0, expected 1 or more");
    } else {
        require(points % 2 == 0, word.who,
                std::string("the metadata '") + left_points_key + "' is missing, though " +
                    std::to_string(points) + " points in 'avatar.eyes.xyz' are no two equal halves");
        avatar.eyes.left_points = points / 2;
    }
    adam = Adam<A>(avatar);
    load_adam(file, "avatar_adam", adam);
    check_counts(word.who, "avatar_adam", avatar, adam);
}

/// Returns the state in a file; `who` begins the messages.
TrainState state_of(const Safetensors& file, const std::string& who) {
    const Words word{file, who};
    require(word("format") == format_name, who,
            "metadata 'format': got '" + word("format") + "', expected '" + format_name + "'");
    require(word("version") == format_version, who,
            "metadata 'version': got '" + word("version") + "', expected '" + format_version + "'");
    TrainState s;
    try {
        s.config = preset("paper-literal"); // of fields that the file lacks
        const std::string field = who + ": metadata 'config'";
        from_json(parse_json_text<Json>(word("config"), field), field, s.config);
    } catch (const nlohmann::json::exception& e) {
        throw Error(who + ": metadata 'config': " + e.what());
    }
    s.stage = word.first("stage", "mesh", "avatar") ? Stage::mesh : Stage::avatar;
    s.step = word.number("step", most_steps);
    s.capture = word("capture");
    if (file.metadata().contains("frames")) s.frames = word("frames");
    s.config.avatar.expression = static_cast<int>(word.number("expression", most_expressions));

    // First the shapes that others depend on, then ranges, then finiteness.
    require_networks_in(file, s.config, s.stage, who);
    SubjectArrays subject;
    subject.head_centre.setZero(3, 1);
    subject.eye_centre.setZero(3, 2);
    subject.eye_sizes.setZero(3, 2);
    load_fields(file, "subject", subject);
    check_subject(who, subject);
    s.subject = subject_of(subject, word.first("measured_eyes", "true", "false"));
    const std::vector<Index>& shape = file.at("train_frames").shape;
    require(shape.size() == 1 && shape[0] > 0, who,
            "tensor 'train_frames': got shape " + shape_text(shape) + ", expected (N) with N above 0");
    for (const std::int64_t f : file.values<std::int64_t>("train_frames", shape)) {
        require(f >= 0 && f <= std::numeric_limits<int>::max(), who,
                "tensor 'train_frames': got " + std::to_string(f) + ", expected numbers of frames");
        s.train_frames.push_back(static_cast<int>(f));
    }

    s.mesh = Mesh::init(s.config.avatar, s.subject.neutral.cast<float>(), Random{0, 0});
    load_fields(file, "mesh", s.mesh);
    const bool visual = s.config.gaze_axis == GazeAxis::visual;
    if (s.stage == Stage::mesh) {
        s.mesh_adam = Adam<Mesh>(s.mesh);
        load_adam(file, "mesh_adam", s.mesh_adam);
        check_counts(who, "mesh_adam", s.mesh, s.mesh_adam);
    } else {
        require(!visual || file.has("avatar.eyes.kappa"), who,
                "there is no tensor 'avatar.eyes.kappa', expected one: the run's gaze_axis is "
                "'visual'");
        Avatar avatar = avatar_shape(s);
        begin_parts(avatar, s.config, Columns<float>(3, 0), Random{0, 0});
        if (s.config.gaze_mechanism != GazeMechanismName::rotation) {
            ComparedTraining& t = s.compared.emplace();
            t.avatar = compared_avatar(avatar, s.config, Columns<float>(3, 0), Random{0, 0});
            load_avatar(file, word, s, t.avatar, t.adam);
        } else {
            // Angles of 0 change no bit and are kept with their moments.
            if (file.has("avatar.eyes.kappa")) avatar.eyes.kappa = Columns<float>::Zero(2, 2);
            if (const char* const views = "avatar.delta_views"; file.has(views)) {
                const std::vector<Index>& got = file.at(views).shape;
                require(got.size() == 2 && got[0] > 0 && got[1] == 6, who,
                        std::string("tensor '") + views + "': got shape " + shape_text(got) +
                            ", expected (cameras, 6)");
                avatar.delta_view = Columns<float>::Zero(6, got[0]);
            }
            if (const char* const lights = "avatar.eyes.light_position"; file.has(lights)) {
                const std::vector<Index>& got = file.at(lights).shape;
                require(got.size() == 2 && got[0] > 0 && got[0] <= most_lights && got[1] == 3, who,
                        std::string("tensor '") + lights + "': got shape " + shape_text(got) +
                            ", expected (lights, 3)");
                resize_lights(avatar.eyes.optics, got[0]);
            }
            if (file.has("avatar.eyes.refractive_index")) set_refraction(avatar.eyes.optics, 1);
            if (const char* const lids = "avatar.eyes.lid_line"; file.has(lids)) {
                const std::vector<Index>& got = file.at(lids).shape;
                require(got.size() == 2 && got[0] > 0 && got[0] % 2 == 0 && got[1] == 3, who,
                        std::string("tensor '") + lids + "': got shape " + shape_text(got) +
                            ", expected (2 K, 3)");
                avatar.eyes.lid_shadow = Columns<float>::Zero(lid_numbers, 2);
                avatar.eyes.lid_line = Columns<float>::Zero(3, got[0]);
            }
            s.avatar = std::move(avatar);
            load_avatar(file, word, s, s.avatar, s.avatar_adam);
        }
    }
    require_finite(s, who);
    return s;
}

} // namespace

Avatar avatar_shape(const TrainState& s) {
    const AvatarConfig& c = s.config.avatar;
    UpsamplerShape shape = s.config.gaussians.upsampler;
    shape.in_channels = c.channels;
    TwoStream<float, MeshEffects> a;
    a.upsampler = Upsampler<float>(shape);
    a.face.networks = s.mesh.networks;
    a.face.exp_attributes =
        Mlp<float>(mlp_shape(c.feature, c.expression, c.networks.exp_attributes, 8));
    a.face.pose_attributes =
        Mlp<float>(mlp_shape(c.feature, c.pose_code(), c.networks.pose_attributes, 8));
    a.eyes.offset = s.mesh.eye_offset;
    a.delta_pose = Columns<float>::Zero(6, static_cast<Index>(s.train_frames.size()));
    return restricted<TrainEffects>(a);
}

void save_checkpoint(const std::filesystem::path& run, const TrainState& state) {
    require_finite(state, checkpoint_path(run).string() + ": not written");
    const SubjectArrays subject = arrays_of(state.subject);
    std::vector<TensorEntry> entries;
    append_fields("subject", subject, entries);
    append_fields("mesh", state.mesh, entries);
    const std::vector<std::int64_t> frames(state.train_frames.begin(), state.train_frames.end());
    entries.push_back(tensor_entry<std::int64_t>("train_frames", {static_cast<Index>(frames.size())},
                                                 frames));
    TensorMetadata metadata{
        {"format", format_name},
        {"version", format_version},
        {"stage", state.stage == Stage::mesh ? "mesh" : "avatar"},
        {"step", std::to_string(state.step)},
        {"capture", state.capture},
        {"expression", std::to_string(state.config.avatar.expression)},
        {"measured_eyes", state.subject.measured_eyes ? "true" : "false"},
        {"config", to_json(state.config).dump()},
    };
    if (!state.frames.empty()) metadata["frames"] = state.frames;
    if (state.stage == Stage::mesh) append_adam("mesh_adam", state.mesh_adam, entries);
    for_avatar(state, [&](const auto& avatar, const auto& adam) {
        append_fields("avatar", avatar, entries);
        append_adam("avatar_adam", adam, entries);
        if (avatar.eyes.points_of(0) != avatar.eyes.points_of(1))
            metadata[left_points_key] = std::to_string(avatar.eyes.points_of(0));
    });
    write_safetensors(checkpoint_path(run), entries, metadata);
}

TrainState load_checkpoint(const std::filesystem::path& run) {
    const std::filesystem::path path = checkpoint_path(run);
    const std::string who = path.string();
    require(std::filesystem::exists(path), who,
            "there is no checkpoint here, expected a run made by `rye train --out " + run.string() + "`");
    const Safetensors file = read_safetensors(path);
    if (!file.checked()) warn_unchecked(who);
    return state_of(file, who);
}

TrainState parse_checkpoint(ByteSpan bytes, const std::string& who) {
    return state_of(parse_safetensors(bytes, who), who);
}

TrainState load_trained(const std::filesystem::path& run) {
    const TrainState s = load_checkpoint(run);
    require(s.stage == Stage::avatar && s.step > 0, run.string(),
            (s.stage == Stage::mesh ? "this run is still in stage 1 (step " + std::to_string(s.step) +
                                          ")"
                                    : "stage 2 of this run has not taken a step") +
                ", expected a trained avatar; go on with `rye train --out " + run.string() +
                " --resume`");
    return drawn_state(s);
}

TrainState drawn_state(const TrainState& state) {
    TrainState s;
    s.stage = state.stage;
    s.step = state.step;
    s.config = state.config;
    s.capture = state.capture;
    s.frames = state.frames;
    s.subject = state.subject;
    s.train_frames = state.train_frames;
    s.avatar = state.avatar;
    if (state.compared) {
        s.avatar = without_mechanism(state.compared->avatar);
        s.compared.emplace().avatar = state.compared->avatar;
    }
    return s;
}

OpticalDrivers<float> optical_drivers(const TrainState& state, const Drivers<float>& drivers) {
    return OpticalDrivers<float>(restricted<PaperEffects>(
        optical_drivers(state.avatar.eyes, restricted<TrainEffects>(drivers)).drivers));
}

} // namespace rye::trainer
