// SPDX-License-Identifier: Apache-2.0
#include "data/config.hpp"

#include <doctest/doctest.h>

#include "../support/hostile.hpp"
#include "commands/options.hpp"
#include "model/run_size.hpp"
#include "tiny_run.hpp"

using namespace rye;
using namespace rye::trainer;
using Json = nlohmann::ordered_json;

namespace {

/// Calls f(path, leaf) for every number of a configuration.
template <class F>
void for_numbers(const Json& json, const std::string& path, const F& f) {
    for (const auto& [key, value] : json.items()) {
        const std::string name = path.empty() ? key : path + "." + key;
        if (value.is_object()) for_numbers(value, name, f);
        else if (value.is_number()) f(name, value);
    }
}

/// {"a": {"b": value}} of "a.b".
Json one_field(const std::string& path, const Json& value) {
    const std::size_t dot = path.find('.');
    if (dot == std::string::npos) return {{path, value}};
    return {{path.substr(0, dot), one_field(path.substr(dot + 1), value)}};
}

TrainConfig with(const Json& json) {
    TrainConfig c = preset("tiny");
    from_json(json, "settings.json", c);
    return c;
}

} // namespace

TEST_CASE("config: no number is taken out of its range, and the message names the field") {
    int numbers = 0;
    for_numbers(to_json(preset("cpu")), "", [&](const std::string& name, const Json& now) {
        ++numbers;
        INFO(name);
        CHECK_NOTHROW(with(one_field(name, now)));
        const std::string words = "settings.json: field '" + name + "': got ";
        CHECK_FAULT(with(one_field(name, -1)), words + "-1, expected");
        CHECK_FAULT(with(one_field(name, 1e300)), words + "1e+300, expected");
        CHECK_FAULT(with(one_field(name, "many")), words);
        CHECK_FAULT(with(one_field(name, nullptr)), words + "null");
        if (now.is_number_integer() && name != "seed")
            CHECK_FAULT(with(one_field(name, 2'000'000'000)), words);
    });
    CHECK(numbers > 60);
}

TEST_CASE("config: density is off in every preset, and asks for what it needs") {
    for (const std::string& name : preset_names()) CHECK(preset(name).gaussians.density.every == 0);
    CHECK_FAULT(with({{"gaussians", {{"density", {{"every", 100}, {"first", 500}, {"last", 400}}}}}}),
                "settings.json: field 'gaussians.density.last': got 400, expected "
                "gaussians.density.first (500) or more");
    CHECK_FAULT(
        with({{"gaussians", {{"density", {{"every", 100}}}, {"rates", {{"position", 0}}}}}}),
        "field 'gaussians.density.every': got 100, expected 0, as gaussians.rates.position is 0");
    CHECK_FAULT(with(one_field("gaussians.density.grow", 1.5)), "expected a number from 0 to 1");
    TrainConfig c = with({{"gaussians", {{"steps", 1000}, {"mouth_points", 100'000}}}});
    const RunSize plain = run_size(c, tiny_state().subject, 64, 64);
    CHECK(plain.most == plain.gaussians);
    from_json({{"gaussians", {{"density", {{"every", 100}, {"most", 1'000'000}}}}}}, "x.json", c);
    const RunSize more = run_size(c, tiny_state().subject, 64, 64);
    CHECK(more.gaussians == plain.gaussians);
    CHECK(more.most > 1.2 * more.gaussians); // five times a twentieth, of the face alone
    CHECK(more.bytes > plain.bytes);
    CHECK(text_of(more).find(" at most ") != std::string::npos);
}

TEST_CASE("config: priors of the face are off in every preset, and do not go with density") {
    for (const char* name : {"tiny", "cpu", "gpu", "paper"}) {
        const AvatarLossConfig w = preset(name).gaussians.weights;
        CHECK((w.face_smooth == 0 && w.face_mirror == 0));
    }
    for (const std::string field : {"face_smooth", "face_mirror"}) {
        CHECK_NOTHROW(with(one_field("gaussians.weights." + field, 1)));
        CHECK_FAULT(
            with({{"gaussians", {{"density", {{"every", 50}}}, {"weights", {{field, 1}}}}}}),
            "settings.json: field 'gaussians.weights." + field +
                "': got 1, expected 0, as gaussians.density.every is 50");
    }
}

TEST_CASE("config: settings that once began a training and then ended it") {
    CHECK_FAULT(with(one_field("gaussians.checkpoint_every", 0)),
                "field 'gaussians.checkpoint_every': got 0, expected a whole number from 1 to ");
    CHECK_FAULT(with(one_field("gaussians.spacing", 1e-9)),
                "field 'gaussians.spacing': got 1e-09, expected a number that is 0, or from 0.0001");
    CHECK_FAULT(with(one_field("gaussians.steps", 2'000'000'000)),
                "got 2000000000, expected a whole number from 0 to 1000000000");
    CHECK(with(one_field("gaussians.spacing", 0)).gaussians.spacing == 0);
    const std::string deep(100'000, 'x');
    CHECK_FAULT(with(one_field("gaussians.steps", deep)), "xxx...");
}

TEST_CASE("config: every seed is taken, and read again from what is written") {
    for (const std::uint64_t seed : {std::uint64_t(5'000'000'000), ~std::uint64_t(0)}) {
        const TrainConfig c = with(one_field("seed", seed));
        CHECK(c.seed == seed);
        CHECK(with(Json::parse(to_json(c).dump())).seed == seed);
    }
}

TEST_CASE("config: --seed takes what a seed can be, and nothing that would be taken for another") {
    CHECK(parsed_seed("0", "--seed") == 0);
    CHECK(parsed_seed("5000000000", "--seed") == 5'000'000'000);
    CHECK(parsed_seed("18446744073709551615", "--seed") == ~std::uint64_t(0));
    for (const char* text : {"-3", "18446744073709551616", "99999999999999999999999", "1e3", "", "7x"})
        CHECK_FAULT(parsed_seed(text, "--seed"), std::string("--seed: got '") + text + "', expected");
}

TEST_CASE("run size: presets fit where they are meant to, and what cannot fit is refused at once") {
    const TrainState s = tiny_state();
    const auto size = [&](const Json& json, const char* from = "tiny") {
        TrainConfig c = preset(from);
        from_json(json, "settings.json", c);
        return run_size(c, s.subject, 512, 512);
    };
    CHECK_NOTHROW(require_room(size(Json::object()), 1e9, "x"));
    CHECK_NOTHROW(require_room(size(Json::object(), "cpu"), 2e9, "x"));
    CHECK_NOTHROW(require_room(size(Json::object(), "paper"), 16e9, "x"));
    for (const Json& json :
         {Json{{"gaussians", {{"spacing", 1e-4}, {"spacing_slope", 0}}}, {"grid", {{"cell", 0.02}}}},
          one_field("grid.cell", 0.002), one_field("gaussians.mouth_points", 10'000'000),
          one_field("avatar.networks.geometry", std::vector<int>(64, 65536))}) {
        INFO(json.dump());
        CHECK_FAULT(require_room(size(json), 1e9, "settings.json"),
                    "settings.json: got settings of a run of ");
    }
}
