// SPDX-License-Identifier: Apache-2.0
#include "config.hpp"

#include <functional>
#include <map>

#include <rye/core/error.hpp>

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;

/// Names each field of the configuration once; Reader and Writer below walk over it.
template <class F>
void walk(F& f, TrainConfig& c) {
    f("preset", c.preset);
    f("seed", c.seed);
    f("gaze_axis", c.gaze_axis);
    f("measured_eyes", c.measured_eyes);
    f("avatar", [&] {
        AvatarConfig& a = c.avatar;
        f("feature", a.feature);
        f("channels", a.channels);
        f("frequencies", a.frequencies);
        f("pose_frequencies", a.pose_frequencies);
        f("gaze_frequencies", a.gaze_frequencies);
        f("exp_near", a.exp_near);
        f("exp_far", a.exp_far);
        f("gaze_near", a.gaze_near);
        f("gaze_far", a.gaze_far);
        f("metric", a.metric);
        f("deform_scale", a.deform_scale);
        f("attribute_scale", a.attribute_scale);
        f("vertex_offset", a.vertex_offset);
        f("drivers_from_zero", a.drivers_from_zero);
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
        f("half_side", c.grid.half_side);
        f("cell", c.grid.cell);
        f("subdivide", c.grid.subdivide);
    });
    f("mesh", [&] {
        MeshTrainConfig& m = c.mesh;
        f("steps", m.steps);
        f("epochs", m.epochs);
        f("views", m.views);
        f("image_size", m.image_size);
        f("pretrain_steps", m.pretrain_steps);
        f("rate_decay", m.rate_decay);
        f("landmarks_follow_gaze", m.landmarks_follow_gaze);
        f("fit_steps", m.fit_steps);
        f("weights", [&] {
            f("rgb", m.weights.rgb);
            f("silhouette", m.weights.silhouette);
            f("deform", m.weights.deform);
            f("offset", m.weights.offset);
            f("landmark", m.weights.landmark);
            f("laplacian", m.weights.laplacian);
            f("eye_offset", m.weights.eye_offset);
        });
        f("rates", [&] {
            f("networks", m.rates.networks);
            f("landmarks", m.rates.landmarks);
        });
    });
    f("gaussians", [&] {
        AvatarTrainConfig& g = c.gaussians;
        f("steps", g.steps);
        f("epochs", g.epochs);
        f("mouth_points", g.mouth_points);
        f("spacing", g.spacing);
        f("spacing_slope", g.spacing_slope);
        f("opacity", g.opacity);
        f("rate_decay", g.rate_decay);
        f("augment", g.augment);
        f("checkpoint_every", g.checkpoint_every);
        f("panel_every", g.panel_every);
        f("eyeball", [&] {
            f("points", g.eyeball.points);
            f("radius", g.eyeball.radius);
            f("opacity", g.eyeball.opacity);
            f("thickness", g.eyeball.thickness);
            f("max_growth", g.eyeball.max_growth);
        });
        f("weights", [&] {
            f("high_resolution", g.weights.high_resolution);
            f("low_resolution", g.weights.low_resolution);
            f("perceptual", g.weights.perceptual);
            f("dssim", g.weights.dssim);
            f("eye_low", g.weights.eye_low);
            f("eye_high", g.weights.eye_high);
            f("blank", g.weights.blank);
            f("blank_eyeballs", g.weights.blank_eyeballs);
            f("eyes_from_eye_terms", g.weights.eyes_from_eye_terms);
            f("eye_smooth", g.weights.eye_smooth);
            f("eye_average", g.weights.eye_average);
            f("face_alone", g.weights.face_alone);
            f("eye_high_every", g.weights.eye_high_every);
        });
        f("rates", [&] {
            f("upsampler", g.rates.upsampler);
            f("networks", g.rates.networks);
            f("opacity", g.rates.opacity);
            f("scale", g.rates.scale);
            f("position", g.rates.position);
            f("feature", g.rates.feature);
            f("rotation", g.rates.rotation);
            f("delta_pose", g.rates.delta_pose);
            f("eye_feature", g.rates.eye_feature);
            f("eye_offset", g.rates.eye_offset);
            f("kappa", g.rates.kappa);
        });
        f("upsampler", [&] {
            f("capacity", g.upsampler.capacity);
            f("doublings", g.upsampler.doublings);
            f("norm", g.upsampler.norm);
            f("skip", g.upsampler.skip);
        });
    });
}

/// The words of an enumeration, in the order of its values.
template <class E>
const std::vector<std::string>& words();
template <>
const std::vector<std::string>& words<EyeAverage>() {
    static const std::vector<std::string> w{"image", "mask"};
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
const std::vector<std::string>& metric_words() {
    static const std::vector<std::string> w{"squared", "euclidean"};
    return w;
}

struct Writer {
    Json json = Json::object();
    template <class V>
    void operator()(const char* name, V&& value) {
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
        } else {
            json[name] = value;
        }
    }
};

struct Reader {
    std::string source;
    std::string path;       // of the object being read
    const Json* json;
    std::size_t used = 0;   // fields of that object that are known

    template <class V>
    void operator()(const char* name, V&& value) {
        using X = std::remove_cvref_t<V>;
        const auto found = json->find(name);
        if (found == json->end()) return;
        ++used;
        const std::string where = path.empty() ? name : path + "." + name;
        const auto fail = [&](const std::string& expected) {
            throw Error(source + ": field '" + where + "': got " + found->dump() + ", expected " +
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
            std::swap(inner, *this);  // the walk's inner calls come to this object
            value();
            check_all_used();
            std::swap(inner, *this);
        } else if constexpr (std::is_enum_v<X>) {
            value = static_cast<X>(word(words<X>()));
        } else if constexpr (std::is_same_v<X, ChosenMetric>) {
            if (word(metric_words()) == 0) value = SquaredDistance{};
            else value = EuclideanDistance{};
        } else if constexpr (std::is_same_v<X, bool>) {
            if (!found->is_boolean()) fail("true or false");
            value = found->template get<bool>();
        } else if constexpr (std::is_same_v<X, double>) {
            if (!found->is_number() || found->template get<double>() < 0)
                fail("a number, 0 or more");
            value = found->template get<double>();
        } else if constexpr (std::is_integral_v<X>) {
            if (!found->is_number_unsigned() || found->template get<std::uint64_t>() > 1'000'000'000)
                fail("a whole number from 0 to 1000000000");
            value = found->template get<X>();
        } else if constexpr (std::is_same_v<X, std::string>) {
            if (!found->is_string()) fail("a string");
            value = found->template get<std::string>();
        } else {
            if (!found->is_array() || found->size() > 64) fail("a list of layer widths");
            X list;
            for (const Json& e : *found) {
                if (!e.is_number_unsigned() || e.template get<std::uint64_t>() < 1 ||
                    e.template get<std::uint64_t>() > 65536)
                    fail("a list of layer widths from 1 to 65536");
                list.push_back(e.template get<int>());
            }
            value = list;
        }
    }

    void check_all_used() const {
        if (used == json->size()) return;
        // Which ones: those that a full configuration does not have at this place.
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
                            "' is not known; `rye train --help` says how to print all fields");
    }
};

void check(const TrainConfig& c, const std::string& source) {
    const auto fail = [&](const std::string& field, const std::string& got,
                          const std::string& expected) {
        throw Error(source + ": field '" + field + "': got " + got + ", expected " + expected);
    };
    const auto positive = [&](const std::string& field, double v) {
        if (!(v > 0)) fail(field, std::to_string(v), "a number above 0");
    };
    if (c.avatar.channels < 3) fail("avatar.channels", std::to_string(c.avatar.channels), "3 or more");
    if (c.avatar.feature < 1) fail("avatar.feature", std::to_string(c.avatar.feature), "1 or more");
    if (c.avatar.exp_far < c.avatar.exp_near)
        fail("avatar.exp_far", std::to_string(c.avatar.exp_far), "exp_near or more");
    if (c.avatar.gaze_far < c.avatar.gaze_near)
        fail("avatar.gaze_far", std::to_string(c.avatar.gaze_far), "gaze_near or more");
    positive("grid.half_side", c.grid.half_side);
    positive("grid.cell", c.grid.cell);
    if (c.grid.cell > c.grid.half_side)
        fail("grid.cell", std::to_string(c.grid.cell), "half_side or less");
    positive("mesh.image_size", c.mesh.image_size);
    positive("mesh.views", c.mesh.views);
    positive("mesh.rate_decay", c.mesh.rate_decay);
    positive("gaussians.rate_decay", c.gaussians.rate_decay);
    if (c.gaussians.opacity <= 0 || c.gaussians.opacity >= 1)
        fail("gaussians.opacity", std::to_string(c.gaussians.opacity), "between 0 and 1");
    if (!(c.gaussians.eyeball.thickness > 0 && c.gaussians.eyeball.thickness <= 1))
        fail("gaussians.eyeball.thickness", std::to_string(c.gaussians.eyeball.thickness),
             "above 0, at most 1");
    if (c.gaussians.eyeball.opacity <= 0 || c.gaussians.eyeball.opacity >= 1)
        fail("gaussians.eyeball.opacity", std::to_string(c.gaussians.eyeball.opacity),
             "between 0 and 1");
    positive("gaussians.weights.eye_high_every", c.gaussians.weights.eye_high_every);
    positive("gaussians.eyeball.radius", c.gaussians.eyeball.radius);
    if (c.gaussians.upsampler.doublings > 4)
        fail("gaussians.upsampler.doublings", std::to_string(c.gaussians.upsampler.doublings),
             "0 to 4");
}

/// Networks of few enough operations for a processor: the same shapes as the paper's, narrower.
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

} // namespace

nlohmann::ordered_json to_json(const TrainConfig& config) {
    TrainConfig copy = config;
    Writer writer;
    walk(writer, copy);
    return writer.json;
}

void from_json(const nlohmann::ordered_json& json, const std::string& source, TrainConfig& config) {
    require(json.is_object(), source, "got " + std::string(json.type_name()) + ", expected an object");
    Reader reader{source, "", &json};
    walk(reader, config);
    reader.check_all_used();
    check(config, source);
}

TrainConfig preset(const std::string& name) {
    TrainConfig c;
    c.preset = name;
    if (name == "paper") return c;
    require(name == "cpu" || name == "tiny", "preset",
            "got '" + name + "', expected tiny, cpu or paper");
    const bool tiny = name == "tiny";
    // What the paper leaves to a graphics card and days, shortened: narrower networks, fewer
    // Gaussians, one doubling of the image, larger rates that decay.
    c.avatar.feature = 32;
    c.avatar.channels = tiny ? 16 : 8;
    c.avatar.drivers_from_zero = true;
    c.avatar.networks = tiny ? narrow_networks(48, 32) : narrow_networks(64, 64);
    c.grid.cell = tiny ? 3.5 / 16 : 3.5 / 24;
    c.mesh.steps = tiny ? 400 : 900;
    c.mesh.views = 2;
    c.mesh.image_size = tiny ? 96 : 128;
    c.mesh.rate_decay = 0.1;
    c.mesh.landmarks_follow_gaze = true;
    c.mesh.fit_steps = tiny ? 1500 : 3000;
    AvatarTrainConfig& g = c.gaussians;
    g.steps = tiny ? 1200 : 6000;
    g.mouth_points = tiny ? 300 : 600;
    g.spacing = tiny ? 0.02 : 0.012;
    g.spacing_slope = 0.2;
    g.rate_decay = 0.05;
    g.augment = false;
    g.checkpoint_every = tiny ? 400 : 1000;
    g.panel_every = tiny ? 400 : 500;
    g.eyeball.points = tiny ? 700 : 2500;
    g.weights.eye_average = EyeAverage::mask;
    g.weights.eye_low = g.weights.eye_high = 0.2;
    g.weights.dssim = 0.2;
    g.weights.blank = 0.1;
    g.weights.blank_eyeballs = true;
    g.weights.face_alone = 1.0;
    g.weights.eye_high_every = 3;
    g.eyeball.max_growth = 0.7;
    g.eyeball.thickness = 0.1;
    g.weights.eyes_from_eye_terms = true;
    g.weights.eye_smooth = 0.2;
    g.rates.upsampler = 1e-3;
    g.rates.networks = 1e-3;
    g.rates.opacity = 1e-2;
    g.rates.scale = 3e-3;
    g.rates.position = 3e-4;
    g.rates.feature = 2e-3;
    g.rates.rotation = 2e-3;
    g.rates.delta_pose = 1e-5;
    g.rates.eye_feature = 1e-2;
    g.rates.kappa = 1e-3;
    g.rates.eye_offset = 0;
    g.upsampler.capacity = 8;
    g.upsampler.doublings = tiny ? 1 : 0;
    g.upsampler.norm = Normalization::none;
    g.upsampler.skip = true;
    return c;
}

} // namespace rye::trainer
