// SPDX-License-Identifier: Apache-2.0
// Gaussians as OpenUSD's text, read back by a small parser of that part of the language: attributes
// with their types, values, metadata and time samples.
#include <rye/io/usda.hpp>

#include <map>
#include <vector>

#include <doctest/doctest.h>

#include <rye/core/parse.hpp>

#include "../support/clouds.hpp"
#include "../support/hostile.hpp"

using namespace rye;
using test::cloud_of, test::largest, test::opacities;

namespace {

/// An attribute: its type, value or samples as the numbers in their order, and metadata.
struct Attribute {
    std::string type;
    std::vector<double> value;
    std::map<double, std::vector<double>> samples;
    std::map<std::string, std::string> metadata;
};

/// Reads a file of one prim: words, numbers, quoted texts, brackets.
class UsdaReader {
  public:
    explicit UsdaReader(const std::string& text) : text_(text) {
        REQUIRE(text_.starts_with("#usda 1.0\n"));
        at_ = 10;
        metadata(layer);
        REQUIRE(word() == "def");
        prim_type = word();
        prim_name = word();
        take('{');
        while (!peek('}')) attribute();
        take('}');
        skip();
        CHECK(at_ == text_.size());
    }
    std::map<std::string, std::string> layer;
    std::string prim_type, prim_name;
    std::map<std::string, Attribute> attributes;

  private:
    void skip() {
        while (at_ < text_.size() && std::isspace(static_cast<unsigned char>(text_[at_]))) ++at_;
    }
    bool peek(char c) {
        skip();
        return at_ < text_.size() && text_[at_] == c;
    }
    void take(char c) {
        INFO("at ", text_.substr(at_, 60));
        REQUIRE(peek(c));
        ++at_;
    }
    std::string word() {
        skip();
        std::string w;
        while (at_ < text_.size() &&
               std::string_view(" \n(){},=").find(text_[at_]) == std::string_view::npos)
            w += text_[at_++];
        return w;
    }
    void metadata(std::map<std::string, std::string>& into) {
        if (!peek('(')) return;
        take('(');
        while (!peek(')')) {
            const std::string name = word();
            take('=');
            into[name] = word();
        }
        take(')');
    }
    std::vector<double> numbers() {
        std::vector<double> list;
        int depth = 0;
        do {
            skip();
            const char c = text_[at_];
            if (c == '[' || c == '(')
                ++depth, ++at_;
            else if (c == ']' || c == ')')
                --depth, ++at_;
            else if (c == ',')
                ++at_;
            else {
                const std::size_t end = text_.find_first_of("[](), \n", at_);
                const auto x = parse_double(text_.substr(at_, end - at_));
                REQUIRE(x.has_value());
                list.push_back(*x);
                at_ = end;
            }
        } while (depth > 0);
        return list;
    }
    void attribute() {
        std::string type = word();
        if (type == "uniform") type += " " + word();
        std::string name = word();
        const std::string samples = ".timeSamples";
        const bool timed = name.ends_with(samples);
        if (timed) name.resize(name.size() - samples.size());
        Attribute& a = attributes[name];
        CHECK((a.type.empty() || a.type == type));
        a.type = type;
        if (!timed) {
            if (peek('=')) {
                take('=');
                if (peek('"'))
                    a.metadata["value"] = word();
                else
                    a.value = numbers();
            }
            metadata(a.metadata);
            return;
        }
        take('=');
        take('{');
        while (!peek('}')) {
            skip();
            const std::size_t end = text_.find(':', at_);
            const auto time = parse_double(text_.substr(at_, end - at_));
            REQUIRE(time.has_value());
            at_ = end + 1;
            a.samples[*time] = numbers();
            take(',');
        }
        take('}');
    }

    std::string text_;
    std::size_t at_ = 0;
};

Columns<double> columns(const std::vector<double>& list, Index rows) {
    REQUIRE(static_cast<Index>(list.size()) % rows == 0);
    return Eigen::Map<const Columns<double>>(list.data(), rows,
                                             static_cast<Index>(list.size()) / rows);
}

} // namespace

TEST_CASE("usda: a Gaussian as written down") {
    GaussianCloud<double> c(1, 0);
    c.mean << 1, -2, 0.25;
    c.log_scale << std::log(0.5), 0, std::log(4);
    c.rotation << 2, 0, 0, 0;
    c.logit_opacity << 0;
    c.sh_constant << 0, 1, -1.5;
    CHECK(usda_text<double>({&c, 1}) == R"(#usda 1.0
(
    defaultPrim = "Splats"
    metersPerUnit = 1
    upAxis = "Y"
)

def ParticleField3DGaussianSplat "Splats"
{
    float3[] extent = [(-11, -10, -12.25), (13, 14, 11.75)]
    point3f[] positions = [(1, 2, -0.25)]
    quatf[] orientations = [(1, 0, 0, 0)]
    float3[] scales = [(0.5, 1, 4)]
    float[] opacities = [0.5]
    uniform int radiance:sphericalHarmonicsDegree = 0
    float3[] radiance:sphericalHarmonicsCoefficients = [(0, 1, -1.5)] (
        elementSize = 1
        interpolation = "vertex"
    )
    uniform token projectionModeHint = "perspective"
    uniform token sortingModeHint = "zDepth"
}
)");
}

TEST_CASE("usda: every attribute is read back as floats hold it, at every degree") {
    for (int degree = 0; degree <= 3; ++degree) {
        const auto c = cloud_of(20, degree);
        UsdaReader file(usda_text<double>({&c, 1}));
        CHECK(file.prim_type == "ParticleField3DGaussianSplat");
        CHECK(file.layer.at("upAxis") == "\"Y\"");
        CHECK(file.layer.count("timeCodesPerSecond") == 0);
        auto& a = file.attributes;
        const Vec3<double> flip(1, -1, -1);
        CHECK(a["positions"].type == "point3f[]");
        CHECK(largest(columns(a["positions"].value, 3) - flip.asDiagonal() * c.mean) <= 1e-5);
        CHECK(a["scales"].type == "float3[]");
        const Columns<double> scale = c.log_scale.array().exp();
        CHECK(largest(columns(a["scales"].value, 3) - scale) <= 2e-6);
        CHECK(a["opacities"].type == "float[]");
        CHECK(largest(columns(a["opacities"].value, 1) - opacities(c)) <= 1e-7);
        CHECK(a["orientations"].type == "quatf[]");
        const Columns<double> q = columns(a["orientations"].value, 4);
        for (Index i = 0; i < 20; ++i) {
            const Mat3<double> f = flip.asDiagonal();
            const Mat3<double> own = quat_matrix(quat_normalized<double>(c.rotation.col(i)));
            CHECK(largest(quat_matrix(Quat<double>(q.col(i))) - f * own * f) <= 1e-6);
        }
        CHECK(a["radiance:sphericalHarmonicsDegree"].type == "uniform int");
        CHECK(a["radiance:sphericalHarmonicsDegree"].value == std::vector<double>{double(degree)});
        const Index each = sh_count(degree);
        CHECK(a["radiance:sphericalHarmonicsCoefficients"].metadata["elementSize"] ==
              std::to_string(each));
        const Columns<double> sh = columns(a["radiance:sphericalHarmonicsCoefficients"].value, 3);
        REQUIRE(sh.cols() == 20 * each);
        for (Index i = 0; i < 20; ++i)
            for (Index k = 0; k < each; ++k)
                for (Index channel = 0; channel < 3; ++channel) {
                    const double expected =
                        k == 0 ? c.sh_constant(channel, i)
                               : detail::sh_half_turn[static_cast<std::size_t>(k - 1)] *
                                     c.sh_rest(channel * (each - 1) + k - 1, i);
                    CHECK(std::abs(sh(channel, i * each + k) - expected) <= 1e-6);
                }
        const Columns<double> box = columns(a["extent"].value, 3);
        for (Index i = 0; i < 20; ++i) {
            const Vec3<double> p = flip.asDiagonal() * c.mean.col(i);
            CHECK((p.array() >= box.col(0).array()).all());
            CHECK((p.array() <= box.col(1).array()).all());
        }
    }
}

TEST_CASE("usda: of several frames, what moves has time samples, and what does not has one value") {
    std::vector<GaussianCloud<double>> frames(3, cloud_of(5, 1));
    frames[1].mean(0, 2) += 1;
    frames[2].rotation.col(0) = Quat<double>(0, 1, 0, 0);
    UsdaReader file(usda_text<double>(frames, 12));
    CHECK(file.layer.at("startTimeCode") == "0");
    CHECK(file.layer.at("endTimeCode") == "2");
    CHECK(file.layer.at("timeCodesPerSecond") == "12");
    auto& a = file.attributes;
    for (const char* moving : {"positions", "orientations"}) {
        CHECK(a[moving].value.empty());
        REQUIRE(a[moving].samples.size() == 3);
    }
    CHECK(largest(columns(a["positions"].samples[1], 3) - columns(a["positions"].samples[0], 3)) ==
          doctest::Approx(1));
    CHECK(a["positions"].samples[2] == a["positions"].samples[0]);
    CHECK(a["orientations"].samples[2][1] == 1);
    for (const char* still : {"scales", "opacities", "radiance:sphericalHarmonicsCoefficients"}) {
        CHECK(a[still].samples.empty());
        CHECK(!a[still].value.empty());
    }
    frames[1].sh_rest(0, 0) += 0.1;
    UsdaReader coloured(usda_text<double>(frames));
    auto& sh = coloured.attributes["radiance:sphericalHarmonicsCoefficients"];
    CHECK(sh.samples.size() == 3);
    CHECK(sh.metadata["elementSize"] == "4");
    CHECK(sh.metadata["interpolation"] == "\"vertex\"");
}

TEST_CASE("usda: wrong clouds are named") {
    const auto text = [](const std::vector<GaussianCloud<double>>& frames) {
        return usda_text<double>(frames);
    };
    CHECK_FAULT(text({}), "usda_text: got no Gaussians");
    CHECK_FAULT(text({GaussianCloud<double>(0, 0)}), "got no Gaussians");
    CHECK_FAULT(text({cloud_of(2, 4)}), "degree 4, expected at most 3");
    CHECK_FAULT(text({cloud_of(2, 1), cloud_of(3, 1)}),
                "frame 1 has 3 Gaussians of degree 1, expected 2");
    auto c = cloud_of(2, 0);
    c.mean(1, 1) = std::nan("");
    CHECK_FAULT(text({c}), "mean of Gaussian 1 is nan");
    c = cloud_of(2, 0);
    c.log_scale(1, 1) = 1e4;
    CHECK_FAULT(text({c}), "scale has a number beyond the range of float");
}
