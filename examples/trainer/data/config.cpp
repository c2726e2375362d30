// SPDX-License-Identifier: Apache-2.0
#include "data/config.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>

#include <rye/core/error.hpp>

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;

/// Valid values of a field: [low, high], and 0 if `zero`.
struct Range {
    double low, high;
    bool zero = false;
};
constexpr Range any{0, 1e6};            // weights and lengths, which may be 0
constexpr Range above_zero{1e-9, 1e6};
constexpr Range rate{0, 10};            // learning rates
constexpr Range steps{0, 1e9};
constexpr int most_doublings = 4;
constexpr Range part{1e-6, 1 - 1e-6};   // fractions, without 0 and 1
constexpr Range seeds{0, 18446744073709551616.};  // 2^64: all of them

/// A whole number, or the word "auto", which leaves it to the program.
struct NumberOrAuto {
    int& number;
    bool& automatic;
};

/// Lists each field of the configuration once, with its valid values; Reader and Writer below
/// traverse it.
template <class F>
void walk(F& f, TrainConfig& c) {
    f("preset", c.preset);
    f("seed", c.seed, seeds);
    f("gaze_axis", c.gaze_axis);
    f("measured_eyes", c.measured_eyes);
    f("correct_labels", c.correct_labels);
    f("correct_colours", c.correct_colours);
    f("correct_cameras", c.correct_cameras);
    f("avatar", [&] {
        AvatarConfig& a = c.avatar;
        f("feature", a.feature, Range{1, 4096});
        f("channels", a.channels, Range{3, 1024});
        f("frequencies", a.frequencies, Range{0, 20});
        f("pose_frequencies", a.pose_frequencies, Range{0, 20});
        f("gaze_frequencies", a.gaze_frequencies, Range{0, 20});
        f("exp_near", a.exp_near, any);
        f("exp_far", a.exp_far, any);
        f("gaze_near", a.gaze_near, any);
        f("gaze_far", a.gaze_far, any);
        f("metric", a.metric);
        f("deform_scale", a.deform_scale, Range{0, 100});
        f("attribute_scale", a.attribute_scale, Range{0, 100});
        f("vertex_offset", a.vertex_offset, Range{0, 100});
        f("drivers_from_zero", a.drivers_from_zero);
        f("gaze_mechanism", c.gaze_mechanism);
        f("eye_appearance", c.eye_appearance);
        f("shading", c.shading);
        f("highlights", c.highlights);
        f("lid_shadow", c.lid_shadow);
        f("refraction", c.refraction);
        f("view_color", c.view_color, Range{0, 3});
        f("networks", [&] {
            NetworkConfig& n = a.networks;
            f("geometry", n.geometry);
            f("exp_color", n.exp_color);
            f("pose_color", n.pose_color);
            f("exp_deform", n.exp_deform);
            f("pose_deform", n.pose_deform);
            f("exp_attributes", n.exp_attributes);
            f("pose_attributes", n.pose_attributes);
            f("gaze_deform", n.gaze_deform);
            f("gaze_color", n.gaze_color);
            f("eye_offset", n.eye_offset);
        });
    });
    f("grid", [&] {
        f("half_side", c.grid.half_side, Range{0.01, 1000});
        f("cell", c.grid.cell, Range{1e-4, 1000});
        f("subdivide", c.grid.subdivide);
    });
    f("mesh", [&] {
        MeshTrainConfig& m = c.mesh;
        f("steps", m.steps, steps);
        f("epochs", m.epochs, Range{0, 1e6});
        f("epochs_over", m.epochs_over);
        f("views", m.views, Range{1, 1000});
        f("image_size", m.image_size, Range{8, 16384});
        f("pretrain_steps", m.pretrain_steps, Range{0, 1e6});
        f("rate_decay", m.rate_decay, above_zero);
        f("landmarks_follow_gaze", m.landmarks_follow_gaze);
        f("fit_steps", m.fit_steps, Range{0, 1e7});
        f("fit_rate", m.fit_rate, rate);
        f("fit_mixed", m.fit_mixed, Range{0, 1});
        f("fit_lids", m.fit_lids, any);
        f("fit_regions", m.fit_regions);
        f("fit_shapes", m.fit_shapes);
        f("weights", [&] {
            f("rgb", m.weights.rgb, any);
            f("silhouette", m.weights.silhouette, any);
            f("deform", m.weights.deform, any);
            f("offset", m.weights.offset, any);
            f("landmark", m.weights.landmark, any);
            f("laplacian", m.weights.laplacian, any);
            f("laplacian_unit", m.weights.laplacian_unit);
            f("eye_offset", m.weights.eye_offset, any);
        });
        f("rates", [&] {
            f("networks", m.rates.networks, rate);
            f("landmarks", m.rates.landmarks, rate);
        });
    });
    f("gaussians", [&] {
        AvatarTrainConfig& g = c.gaussians;
        f("steps", g.steps, steps);
        f("epochs", g.epochs, Range{0, 1e6});
        f("views", g.views, Range{1, 1000});
        f("epochs_over", g.epochs_over);
        f("mouth_points", g.mouth_points, Range{0, 1e7});
        f("spacing", g.spacing, Range{1e-4, 1000, true});
        f("spacing_slope", g.spacing_slope, Range{0, 1000});
        f("lid_margin", g.lid_margin, Range{1e-3, 1000, true});
        f("opacity", g.opacity, part);
        f("thickness", g.thickness, Range{1e-6, 1});
        f("rate_decay", g.rate_decay, above_zero);
        f("augment", g.augment);
        f("checkpoint_every", g.checkpoint_every, Range{1, 1e9});
        f("panel_every", g.panel_every, steps);
        f("eyeball", [&] {
            f("points", g.eyeball.points, Range{1, 50000});  // neighbours need P^2 distances
            f("radius", g.eyeball.radius, Range{1e-3, 1000});
            f("opacity", g.eyeball.opacity, part);
            f("thickness", g.eyeball.thickness, Range{1e-6, 1});
            f("max_growth", g.eyeball.max_growth, Range{1e-3, 1e6, true});
            f("bulge", g.eyeball.bulge);
        });
        f("weights", [&] {
            f("high_resolution", g.weights.high_resolution, any);
            f("low_resolution", g.weights.low_resolution, any);
            f("perceptual", g.weights.perceptual, any);
            f("dssim", g.weights.dssim, any);
            f("eye_low", g.weights.eye_low, any);
            f("eye_high", g.weights.eye_high, any);
            f("blank", g.weights.blank, any);
            f("eye_smooth", g.weights.eye_smooth, any);
            f("face_alone", g.weights.face_alone, any);
            f("face_smooth", g.weights.face_smooth, any);
            f("face_mirror", g.weights.face_mirror, any);
            f("eye_high_every", g.weights.eye_high_every, Range{1, 1e6});
        });
        f("rates", [&] {
            f("upsampler", g.rates.upsampler, rate);
            f("networks", g.rates.networks, rate);
            f("deform", g.rates.deform, rate);
            f("opacity", g.rates.opacity, rate);
            f("scale", g.rates.scale, rate);
            f("position", g.rates.position, rate);
            f("feature", g.rates.feature, rate);
            f("rotation", g.rates.rotation, rate);
            f("delta_pose", g.rates.delta_pose, rate);
            f("eye_feature", g.rates.eye_feature, rate);
            f("eye_offset", g.rates.eye_offset, rate);
            f("kappa", g.rates.kappa, rate);
            f("delta_gaze", g.rates.delta_gaze, rate);
            f("delta_view", g.rates.delta_view, rate);
            f("delta_view_from", g.rates.delta_view_from, Range{0, 1e8});
            f("shading", g.rates.shading, rate);
            f("light_intensity", g.rates.light_intensity, rate);
            f("light_position", g.rates.light_position, rate);
            f("lid_shadow", g.rates.lid_shadow, rate);
            f("view_color", g.rates.view_color, rate);
            f("refractive_index", g.rates.refractive_index, rate);
        });
        f("centre_corrections", g.centre_corrections);
        f("lid_steps", g.lid_steps, steps);
        f("density", [&] {
            f("every", g.density.every, steps);
            f("first", g.density.first, steps);
            f("last", g.density.last, steps);
            f("grow", g.density.grow, Range{0, 1});
            f("most", g.density.most, Range{1, 1e8});
            f("prune", g.density.prune, Range{0, 1 - 1e-6});
            f("prefer", g.density.prefer, Range{1, 1e6});
            f("reach", g.density.reach, Range{1e-6, 1000});
        });
        f("upsampler", [&] {
            f("capacity", g.upsampler.capacity, Range{1, 1024});
            f("doublings", NumberOrAuto{g.upsampler.doublings, g.auto_doublings},
              Range{0, most_doublings});
            f("norm", g.upsampler.norm);
            f("skip", g.upsampler.skip);
        });
        f("planes", g.planes, Range{1, 3});
    });
}

/// Returns the names of an enumeration, in the order of its values.
template <class E>
const std::vector<std::string>& words();
template <>
const std::vector<std::string>& words<LaplacianUnit>() {
    static const std::vector<std::string> w{"metre", "world"};
    return w;
}
template <>
const std::vector<std::string>& words<EpochsOver>() {
    static const std::vector<std::string> w{"frames", "pictures"};
    return w;
}
template <>
const std::vector<std::string>& words<Normalization>() {
    static const std::vector<std::string> w{"instance", "none"};
    return w;
}
template <>
const std::vector<std::string>& words<GazeAxis>() {
    static const std::vector<std::string> w{"optical", "visual"};
    return w;
}
template <>
const std::vector<std::string>& words<GazeMechanismName>() {
    static const std::vector<std::string> w{"rotation",        "feature_rotation",   "condition",
                                            "latent_rotation", "learned_quaternion", "none"};
    return w;
}
template <>
const std::vector<std::string>& words<EyeAppearanceName>() {
    static const std::vector<std::string> w{"free", "driven"};
    return w;
}
template <>
const std::vector<std::string>& words<ShadingName>() {
    static const std::vector<std::string> w{"none", "head_pose"};
    return w;
}
const std::vector<std::string>& metric_words() {
    static const std::vector<std::string> w{"squared", "euclidean"};
    return w;
}

struct Writer {
    Json json = Json::object();
    template <class V>
    void operator()(const char* name, V&& value, Range = {}) {
        using X = std::remove_cvref_t<V>;
        if constexpr (std::is_invocable_v<X>) {
            Json outer = std::move(json);
            json = Json::object();
            value();
            outer[name] = std::move(json);
            json = std::move(outer);
        } else if constexpr (std::is_enum_v<X>) {
            json[name] = words<X>()[static_cast<std::size_t>(value)];
        } else if constexpr (std::is_same_v<X, ChosenMetric>) {
            json[name] = metric_words()[value.index()];
        } else if constexpr (std::is_same_v<X, NumberOrAuto>) {
            json[name] = value.automatic ? Json("auto") : Json(value.number);
        } else {
            json[name] = value;
        }
    }
};

bool within(double x, const Range& r) { return (r.zero && x == 0) || (x >= r.low && x <= r.high); }

/// Returns a text such as "from 1 to 1000".
std::string text(const Range& r) {
    const auto number = [](double x) {
        const bool whole = x == std::floor(x) && x < 1e18;
        return whole ? std::to_string(static_cast<std::uint64_t>(x)) : Json(x).dump();
    };
    return (r.zero ? "that is 0, or from " : "from ") + number(r.low) + " to " + number(r.high);
}

/// Returns a value for a message, shortened.
std::string shown(const Json& json) {
    if (json.is_structured()) return json.is_array() ? "a list" : "an object";
    const std::string text = json.dump(-1, ' ', true, Json::error_handler_t::replace);
    return text.size() <= 60 ? text : text.substr(0, 57) + "...";
}

struct Reader {
    std::string source;
    std::string path;       // of the current object
    const Json* json;
    std::size_t used = 0;   // known fields of the current object

    template <class V>
    void operator()(const char* name, V&& value, Range range = {}) {
        using X = std::remove_cvref_t<V>;
        const auto found = json->find(name);
        if (found == json->end()) return;
        ++used;
        const std::string where = path.empty() ? name : path + "." + name;
        const auto fail = [&](const std::string& expected) {
            throw Error(source + ": field '" + where + "': got " + shown(*found) + ", expected " +
                        expected);
        };
        const auto word = [&](const std::vector<std::string>& all) -> std::size_t {
            std::string list;
            for (std::size_t i = 0; i < all.size(); ++i) {
                if (found->is_string() && *found == all[i]) return i;
                list += (i == 0 ? "\"" : " or \"") + all[i] + "\"";
            }
            fail(list);
            return 0;
        };
        if constexpr (std::is_invocable_v<X>) {
            if (!found->is_object()) fail("an object");
            Reader inner{source, where, &*found};
            std::swap(inner, *this);  // inner calls of the walk operate on this object
            value();
            check_all_used();
            std::swap(inner, *this);
        } else if constexpr (std::is_enum_v<X>) {
            value = static_cast<X>(word(words<X>()));
        } else if constexpr (std::is_same_v<X, ChosenMetric>) {
            if (word(metric_words()) == 0) value = SquaredDistance{};
            else value = EuclideanDistance{};
        } else if constexpr (std::is_same_v<X, NumberOrAuto>) {
            value.automatic = *found == "auto";
            if (value.automatic) return;
            if (!found->is_number_integer() || !within(found->template get<double>(), range))
                fail("\"auto\" or a whole number " + text(range));
            value.number = found->template get<int>();
        } else if constexpr (std::is_same_v<X, bool>) {
            if (!found->is_boolean()) fail("true or false");
            value = found->template get<bool>();
        } else if constexpr (std::is_same_v<X, double>) {
            if (!found->is_number() || !within(found->template get<double>(), range))
                fail("a number " + text(range));
            value = found->template get<double>();
        } else if constexpr (std::is_integral_v<X>) {
            if (!found->is_number_integer() || !within(found->template get<double>(), range))
                fail("a whole number " + text(range));
            value = found->template get<X>();
        } else if constexpr (std::is_same_v<X, std::string>) {
            if (!found->is_string()) fail("a string");
            value = found->template get<std::string>();
        } else {
            if (!found->is_array() || found->size() > 64) fail("a list of layer widths");
            X list;
            for (const Json& e : *found) {
                if (!e.is_number_integer() || !within(e.template get<double>(), {1, 65536}))
                    fail("a list of layer widths from 1 to 65536");
                list.push_back(e.template get<int>());
            }
            value = list;
        }
    }

    void check_all_used() const {
        if (used == json->size()) return;
        // Unknown fields are those that a full configuration lacks here.
        TrainConfig reference;
        const Json full = to_json(reference);
        const Json* at = &full;
        std::size_t begin = 0;
        while (begin < path.size()) {
            const std::size_t end = std::min(path.find('.', begin), path.size());
            at = &(*at)[path.substr(begin, end - begin)];
            begin = end + 1;
        }
        for (const auto& [key, value] : json->items())
            if (!at->contains(key))
                throw Error(source + ": field '" + (path.empty() ? key : path + "." + key) +
                            "' is unknown; see `rye train --help`");
    }
};

/// Checks relations between fields.
void check(const TrainConfig& c, const std::string& source) {
    const auto ordered = [&](const char* field, double v, const char* bound, double least) {
        require(
            v >= least, source, "field '", field, "': got ", [&] { return std::to_string(v); },
            ", expected ", bound, " (", [&] { return std::to_string(least); }, ") or more");
    };
    ordered("avatar.exp_far", c.avatar.exp_far, "avatar.exp_near", c.avatar.exp_near);
    ordered("avatar.gaze_far", c.avatar.gaze_far, "avatar.gaze_near", c.avatar.gaze_near);
    ordered("grid.half_side", c.grid.half_side, "grid.cell", c.grid.cell);
    const DensityConfig& density = c.gaussians.density;
    require(density.every == 0 || density.last >= density.first, source,
            "field 'gaussians.density.last': got ", density.last,
            ", expected gaussians.density.first (", density.first, ") or more");
    require(density.every == 0 || c.gaussians.rates.position > 0, source,
            "field 'gaussians.density.every': got ", density.every,
            ", expected 0, as gaussians.rates.position is 0: the optimiser then keeps no "
            "gradients of positions, by which Gaussians are chosen");
    const auto neighbours_stay = [&](const char* field, double weight) {
        require(density.every == 0 || weight == 0, source, "field 'gaussians.weights.", field,
                "': got ", weight, ", expected 0, as gaussians.density.every is ", density.every,
                ": neighbours on the face are those of its Gaussians before any splits or goes");
    };
    neighbours_stay("face_smooth", c.gaussians.weights.face_smooth);
    neighbours_stay("face_mirror", c.gaussians.weights.face_mirror);
    require(c.gaussians.planes != 2, source,
            "field 'gaussians.planes': got 2, expected 1 or 3, which there are kernels for");
    require(
        c.gaze_mechanism == GazeMechanismName::rotation || c.gaze_axis == GazeAxis::optical, source,
        "field 'avatar.gaze_mechanism': got \"", [&] { return word_of(c.gaze_mechanism); },
        "\", expected \"rotation\", as gaze_axis is \"visual\"");
    require(
        c.gaze_mechanism == GazeMechanismName::rotation ||
            c.eye_appearance == EyeAppearanceName::free,
        source, "field 'avatar.gaze_mechanism': got \"", [&] { return word_of(c.gaze_mechanism); },
        "\", expected \"rotation\", as eye_appearance is \"",
        [&] { return word_of(c.eye_appearance); }, "\"");
    require(
        c.gaze_mechanism == GazeMechanismName::rotation || !c.refraction, source,
        "field 'avatar.gaze_mechanism': got \"", [&] { return word_of(c.gaze_mechanism); },
        "\", expected \"rotation\", as refraction is true");
    require(
        c.gaze_mechanism == GazeMechanismName::rotation || c.view_color == 0, source,
        "field 'avatar.gaze_mechanism': got \"", [&] { return word_of(c.gaze_mechanism); },
        "\", expected \"rotation\", as view_color is not 0");
}

/// Returns networks with fewer operations: the shapes of the paper's, narrower.
NetworkConfig narrow_networks(int wide, int narrow) {
    NetworkConfig n;
    n.geometry.assign(4, wide);
    n.exp_color.assign(2, wide);
    n.pose_color.assign(1, narrow);
    n.exp_deform.assign(4, wide);
    n.pose_deform.assign(2, wide);
    n.exp_attributes.assign(2, wide);
    n.pose_attributes.assign(1, narrow);
    n.gaze_deform.assign(3, wide);
    n.gaze_color.assign(1, wide);
    n.eye_offset.assign(2, narrow);
    return n;
}

/// Changes the preset `paper` to `paper-literal`: an epoch over frames, whatever the number of
/// cameras; super-resolution from a quarter of any picture's size; the Laplacian's weight without a
/// unit; eyes of free colours with the iris on a plane.
void take_literal_readings(TrainConfig& c) {
    c.eye_appearance = EyeAppearanceName::free;
    c.mesh.weights.laplacian_unit = LaplacianUnit::world;
    AvatarTrainConfig& g = c.gaussians;
    g.epochs_over = EpochsOver::frames;
    g.eyeball.bulge = false;
    g.auto_doublings = false;
}

/// Changes the preset `cpu` to one that a large device trains in minutes: pictures of 512 x 512,
/// half of the paper's widths, a finer face, three times the steps.
void take_device_sizes(TrainConfig& c) {
    c.avatar.feature = 64;
    c.avatar.channels = 16;
    c.avatar.networks = narrow_networks(128, 64);
    c.mesh.image_size = 256;
    c.grid.subdivide = true;
    AvatarTrainConfig& g = c.gaussians;
    g.steps = 20000;
    g.spacing = 0.01;
    g.spacing_slope = 0.02;
    g.weights.dssim = 0.5;
    g.checkpoint_every = 2000;
    g.panel_every = 2000;
    g.eyeball.points = 4000;
    g.weights.eye_high_every = 1;
    g.upsampler.capacity = 16;
}

/// Changes the preset `tiny` to the common part of `cpu` and `gpu`, without the sizes: corrected
/// labels and colours, deformations that hold for expressions and gazes that no frame has, light
/// that does not move with head and eyes, and faster Gaussians.
void take_generalisation(TrainConfig& c) {
    c.correct_labels = c.correct_colours = c.correct_cameras = true;
    c.avatar.pose_frequencies = c.avatar.gaze_frequencies = 1;
    c.shading = ShadingName::head_pose;
    c.highlights = true;
    NetworkConfig& n = c.avatar.networks;
    n.exp_deform.assign(4, 128);
    n.pose_deform.assign(2, 128);
    n.gaze_deform.assign(3, 128);
    c.grid.cell = 3.5 / 32;
    c.grid.subdivide = false;
    c.mesh.fit_steps = 10000;
    c.mesh.fit_rate = 3e-3;
    AvatarTrainConfig& g = c.gaussians;
    g.mouth_points = 2000;
    g.spacing = 0.02;
    g.spacing_slope = 0.03;
    g.weights.eye_smooth = 0.1;
    AvatarRates& rates = g.rates;
    rates.deform = 3e-5;
    rates.position = 1e-3;
    rates.scale = rates.feature = 5e-3;
    rates.view_color = 2.5e-4;
}

} // namespace

const std::string& word_of(GazeMechanismName mechanism) {
    return words<GazeMechanismName>()[static_cast<std::size_t>(mechanism)];
}
const std::string& word_of(EyeAppearanceName appearance) {
    return words<EyeAppearanceName>()[static_cast<std::size_t>(appearance)];
}
const std::string& word_of(ShadingName shading) {
    return words<ShadingName>()[static_cast<std::size_t>(shading)];
}

nlohmann::ordered_json to_json(const TrainConfig& config) {
    TrainConfig copy = config;
    Writer writer;
    walk(writer, copy);
    return writer.json;
}

void from_json(const nlohmann::ordered_json& json, const std::string& source, TrainConfig& config) {
    require(json.is_object(), source, "got ", json.type_name(), ", expected an object");
    Reader reader{source, "", &json};
    walk(reader, config);
    reader.check_all_used();
    check(config, source);
}

const std::vector<std::string>& preset_names() {
    static const std::vector<std::string> names{"tiny", "cpu", "gpu", "paper", "paper-literal"};
    return names;
}

TrainConfig preset(const std::string& name) {
    TrainConfig c;
    c.preset = name;
    if (name == "paper") return c;
    take_literal_readings(c);
    if (name == "paper-literal") return c;
    require(name == "cpu" || name == "tiny" || name == "gpu", "preset", "got '", name,
            "', expected tiny, cpu, gpu, paper or paper-literal");
    const bool tiny = name == "tiny";
    // Reductions of the paper's days on a graphics card: narrower networks, fewer Gaussians, one
    // doubling of the image, larger rates that decay.
    c.avatar.feature = 32;
    c.avatar.channels = tiny ? 16 : 8;
    c.avatar.drivers_from_zero = true;
    c.avatar.networks = tiny ? narrow_networks(48, 32) : narrow_networks(64, 64);
    c.grid.cell = tiny ? 3.5 / 16 : 3.5 / 24;
    c.mesh.steps = tiny ? 400 : 900;
    c.mesh.views = 2;
    c.mesh.image_size = tiny ? 96 : 128;
    c.mesh.rate_decay = 0.1;
    c.mesh.weights.laplacian_unit = LaplacianUnit::metre;
    c.mesh.landmarks_follow_gaze = true;
    c.mesh.fit_steps = 6000;
    c.mesh.fit_mixed = 0.85;
    c.mesh.fit_lids = 10;
    c.mesh.fit_regions = c.mesh.fit_shapes = true;
    AvatarTrainConfig& g = c.gaussians;
    g.steps = tiny ? 1200 : 8000;
    g.mouth_points = tiny ? 300 : 600;
    g.spacing = tiny ? 0.02 : 0.012;
    g.spacing_slope = 0.2;
    g.rate_decay = 0.05;
    g.augment = false;
    g.checkpoint_every = tiny ? 400 : 1000;
    g.panel_every = tiny ? 400 : 500;
    g.eyeball.points = tiny ? 700 : 2500;
    g.weights.dssim = 0.2;
    g.weights.face_alone = 1.0;
    g.weights.eye_high_every = 3;
    g.eyeball.max_growth = 0.7;
    g.eyeball.thickness = 0.1;
    g.weights.eye_smooth = 0.2;
    g.rates.upsampler = 1e-3;
    g.rates.networks = 1e-3;
    g.rates.deform = 3e-5;
    g.rates.opacity = 1e-2;
    g.rates.scale = 3e-3;
    g.rates.position = 3e-4;
    g.rates.feature = 2e-3;
    g.rates.rotation = 2e-3;
    g.rates.delta_pose = 1e-5;
    g.rates.eye_feature = 1e-2;
    g.rates.kappa = 0; // stays as the irises told it (corrections/found_kappa.hpp)
    g.rates.shading = 1e-2;
    g.rates.view_color = 1e-3;
    g.rates.eye_offset = 0;
    g.lid_steps = 2000;
    g.upsampler.capacity = 8;
    g.upsampler.doublings = tiny ? 1 : 0;
    g.upsampler.norm = Normalization::none;
    g.upsampler.skip = true;
    if (!tiny) take_generalisation(c);
    if (name == "gpu") take_device_sizes(c);
    return c;
}

void choose_doublings(TrainConfig& config, int width, int height) {
    AvatarTrainConfig& g = config.gaussians;
    if (!g.auto_doublings) return;
    g.auto_doublings = false;
    const int side = std::max(width, height);
    g.upsampler.doublings = 0;
    while (g.upsampler.doublings < most_doublings &&
           side >> (g.upsampler.doublings + 1) >= least_render_side)
        ++g.upsampler.doublings;
}

} // namespace rye::trainer
