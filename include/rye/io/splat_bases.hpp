// SPDX-License-Identifier: Apache-2.0
/// rye/io/splat_bases.hpp: linear bases beside a splat file, for viewers without networks: how
/// its Gaussians change with an expression and a gaze. A safetensors file; docs/formats.md states
/// how a viewer applies it. Frame and units: the splat file's own; angles in degrees.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <rye/io/json.hpp>
#include <rye/io/safetensors.hpp>
#include <rye/core/format.hpp>
#include <rye/math/linalg.hpp>

namespace rye {

namespace detail {

/// Name of the format in the file's metadata.
inline constexpr const char* bases_format = "rye-bases";
/// Version of the format.
inline constexpr const char* bases_version = "1";

} // namespace detail

/// Numbers of a change: centre 3, rotation vector 3 (turns from the left), logarithms of the scales
/// 3, red, green, blue, opacity.
inline constexpr Index basis_numbers = 13;

/// One basis: the change of the Gaussians when a driver, otherwise at rest, goes to `at`. It counts
/// with the weight max(0, (driver - rest) / (at - rest)), so that a driver may have one each way.
struct SplatBasis {
    std::string driver; ///< a coefficient, or gaze_left_pitch, gaze_left_yaw, ... [degrees]
    double rest = 0, at = 1;
};

/// Gaussians [first, first + count) that turn about a centre with a gaze.
struct TurningEye {
    Index first = 0, count = 0;
    Vec3<double> centre = Vec3<double>::Zero();
    std::array<double, 2> gaze{};  ///< pitch and yaw of the splat file [degrees]
    std::array<double, 2> kappa{}; ///< added to a gaze for the axis that turns [degrees]
};

/// Bases of a splat file.
struct SplatBases {
    Index gaussians = 0;                          ///< of the splat file
    std::vector<SplatBasis> bases;                ///< B
    std::vector<std::uint32_t> begin{0};          ///< B + 1: where the entries of a basis begin
    std::vector<std::uint32_t> index;             ///< E: Gaussians, ascending in a basis
    Columns<Eigen::half> change;                  ///< basis_numbers x E
    std::array<TurningEye, 2> eyes;               ///< the subject's left, right
    Vec4<double> head = Vec4<double>(1, 0, 0, 0); ///< (w, x, y, z): the file's axes from the head's
};

namespace detail {

/// Throws an Error("who: ...") for bases that a viewer could not apply: names that are empty or no
/// UTF-8, two bases of a driver toward the same side, numbers that are not finite, an index beyond
/// the Gaussians.
inline void check_bases(const std::string& who, const SplatBases& b) {
    const auto finite = [&](const std::string& field, double x) {
        require(std::isfinite(x), who, field, ": got ", number_text(x),
                ", expected a finite number");
    };
    constexpr std::uint32_t most = std::numeric_limits<std::uint32_t>::max();
    require(b.gaussians >= 0 && std::cmp_less_equal(b.gaussians, most), who,
            "'gaussians': got ", b.gaussians, ", expected 0 to 4294967295");
    std::set<std::pair<std::string, bool>> sides;
    for (std::size_t k = 0; k < b.bases.size(); ++k) {
        const SplatBasis& basis = b.bases[k];
        const std::string field = "'bases': basis " + std::to_string(k);
        require(!basis.driver.empty(), who, field, ": its driver has no name");
        require_utf8(basis.driver, who + ": " + field);
        finite(field + ": 'rest'", basis.rest);
        finite(field + ": 'at'", basis.at);
        require(basis.at != basis.rest, who, field, ": 'at' is 'rest', ", number_text(basis.at),
                ", expected another number");
        require(sides.emplace(basis.driver, basis.at > basis.rest).second, who, field,
                ": a second one of '", basis.driver, "' toward this side");
    }
    require(b.begin.size() == b.bases.size() + 1, who, "'begin': got ", b.begin.size(),
            " numbers, expected ", b.bases.size() + 1);
    require(b.begin.front() == 0 && b.begin.back() == b.index.size(), who, "'begin': got ",
            b.begin.front(), " to ", b.begin.back(), ", expected 0 to ", b.index.size());
    require(
        b.change.rows() == basis_numbers && b.change.cols() == static_cast<Index>(b.index.size()),
        who, "'change': got ", b.change.cols(), " x ", b.change.rows(), ", expected ",
        b.index.size(), " x ", basis_numbers);
    for (std::size_t k = 0; k < b.bases.size(); ++k)
        require(b.begin[k] <= b.begin[k + 1], who, "'begin': number ", k + 1, " is ",
                b.begin[k + 1], ", expected at least ", b.begin[k]);
    for (std::size_t k = 0; k < b.bases.size(); ++k)
        for (std::size_t e = b.begin[k]; e < b.begin[k + 1]; ++e)
            require(b.index[e] < static_cast<std::uint64_t>(b.gaussians) &&
                        (e == b.begin[k] || b.index[e] > b.index[e - 1]),
                    who, "'index': entry ", e, " of basis ", k, " is ", b.index[e],
                    ", expected ascending numbers below ", b.gaussians);
    for (Index i = 0; i < b.change.size(); ++i) {
        const auto x = static_cast<float>(b.change.data()[i]);
        require(std::isfinite(x), who, "'change': number ", i % basis_numbers, " of entry ",
                i / basis_numbers, " is ", number_text(x), ", expected a finite number");
    }
    for (std::size_t e = 0; e < 2; ++e) {
        const TurningEye& eye = b.eyes[e];
        const std::string field = "'eyes': eye " + std::to_string(e);
        require(eye.first >= 0 && eye.count >= 0 && eye.first <= b.gaussians &&
                    eye.count <= b.gaussians - eye.first,
                who, field, ": got Gaussians from ", eye.first, " on, ", eye.count, ", of ",
                b.gaussians);
        for (const double x : {eye.centre[0], eye.centre[1], eye.centre[2], eye.gaze[0],
                               eye.gaze[1], eye.kappa[0], eye.kappa[1]})
            finite(field, x);
    }
    double square = 0;
    for (Index k = 0; k < 4; ++k) square += b.head[k] * b.head[k];
    require(std::abs(square - 1) <= 1e-3, who, "'head': got a quaternion of the squared length ",
            number_text(square), ", expected 1");
}

/// Reads JSON of the file's metadata; its errors name the key.
class BasesJson {
  public:
    BasesJson(const Safetensors& file, std::string who, const std::string& key)
        : who_(std::move(who) + ": metadata '" + key + "'"),
          json_(parse_json(file.word(key), who_)) {}

    const JsonValue& value() const { return json_; }
    const std::string& who() const { return who_; }
    const JsonArray& list(const JsonValue* v, std::size_t count = std::size_t(-1)) const {
        const JsonArray* const items = v == nullptr ? nullptr : v->get<JsonArray>();
        require(items != nullptr && (count == std::size_t(-1) || items->size() == count), who_,
                "expected a list", count == std::size_t(-1) ? "" : " of " + std::to_string(count));
        return *items;
    }
    double number(const JsonValue* v) const {
        const auto* const whole = v == nullptr ? nullptr : v->get<std::int64_t>();
        const auto* const real = v == nullptr ? nullptr : v->get<double>();
        require(whole != nullptr || real != nullptr, who_, "a number is missing");
        return whole != nullptr ? static_cast<double>(*whole) : *real;
    }
    Index count(const JsonValue* v) const {
        const auto* const whole = v == nullptr ? nullptr : v->get<std::int64_t>();
        require(whole != nullptr && *whole >= 0, who_, "expected a count");
        return static_cast<Index>(*whole);
    }
    template <class To>
    void numbers(const JsonValue* v, std::size_t count, To&& to) const {
        const JsonArray& items = list(v, count);
        for (std::size_t i = 0; i < count; ++i) to(i, number(&items[i]));
    }

  private:
    std::string who_;
    JsonValue json_;
};

template <class Numbers>
std::string numbers_text(const Numbers& numbers, int count) {
    std::string text = "[";
    for (int k = 0; k < count; ++k)
        text += (k == 0 ? "" : ",") + number_text(numbers.data()[k]);
    return text + "]";
}

} // namespace detail

/// Replaces the file at `path` by one with these bases; on failure leaves it unchanged and throws
/// an Error. Checks them first (check_bases).
inline void write_bases(const std::filesystem::path& path, const SplatBases& b) {
    detail::check_bases(path.string() + ": not written", b);
    std::string bases = "[", eyes = "[";
    for (const SplatBasis& basis : b.bases)
        bases += (bases.size() == 1 ? "" : ",") + std::string(R"({"driver":)") +
                 detail::json_string(basis.driver) + R"(,"rest":)" + number_text(basis.rest) +
                 R"(,"at":)" + number_text(basis.at) + "}";
    for (const TurningEye& eye : b.eyes)
        eyes += (eyes.size() == 1 ? "" : ",") + std::string(R"({"first":)") +
                std::to_string(eye.first) + R"(,"count":)" + std::to_string(eye.count) +
                R"(,"centre":)" + detail::numbers_text(eye.centre, 3) + R"(,"gaze":)" +
                detail::numbers_text(eye.gaze, 2) + R"(,"kappa":)" +
                detail::numbers_text(eye.kappa, 2) + "}";
    const auto count = [](const std::vector<std::uint32_t>& list) {
        return static_cast<Index>(list.size());
    };
    write_safetensors(path,
                      {tensor_entry<std::uint32_t>("begin", {count(b.begin)}, b.begin),
                       tensor_entry<std::uint32_t>("index", {count(b.index)}, b.index),
                       tensor_entry("change", b.change)},
                      {{"format", detail::bases_format},
                       {"version", detail::bases_version},
                       {"gaussians", std::to_string(b.gaussians)},
                       {"bases", bases + "]"},
                       {"eyes", eyes + "]"},
                       {"head", detail::numbers_text(b.head, 4)}});
}

/// Returns the bases in a file's bytes. Throws an Error "who: ..." for a file of another kind or
/// version, for a damaged one, and for whatever check_bases rejects.
inline SplatBases parse_bases(ByteSpan bytes, const std::string& who) {
    const Safetensors file = parse_safetensors(bytes, who);
    const auto found = file.metadata().find("format");
    require(found != file.metadata().end() && found->second == detail::bases_format, who,
            "metadata 'format': got ",
            (found == file.metadata().end() ? std::string("none") : "'" + found->second + "'"),
            ", expected '", detail::bases_format, "'");
    require(file.word("version") == detail::bases_version, who, "metadata 'version': got '",
            file.word("version"), "', expected '", detail::bases_version, "'");
    SplatBases b;
    const detail::BasesJson total(file, who, "gaussians"), head(file, who, "head"),
        bases(file, who, "bases"), eyes(file, who, "eyes");
    b.gaussians = total.count(&total.value());
    head.numbers(&head.value(), 4,
                 [&](std::size_t k, double x) { b.head[static_cast<Index>(k)] = x; });
    for (const JsonValue& v : bases.list(&bases.value())) {
        const JsonValue* const name = v.find("driver");
        require(name != nullptr && name->get<std::string>() != nullptr, bases.who(),
                "a 'driver' is missing");
        b.bases.push_back(
            {*name->get<std::string>(), bases.number(v.find("rest")), bases.number(v.find("at"))});
    }
    const JsonArray& both = eyes.list(&eyes.value(), 2);
    for (std::size_t e = 0; e < 2; ++e) {
        TurningEye& eye = b.eyes[e];
        eye.first = eyes.count(both[e].find("first"));
        eye.count = eyes.count(both[e].find("count"));
        eyes.numbers(both[e].find("centre"), 3,
                     [&](std::size_t k, double x) { eye.centre[static_cast<Index>(k)] = x; });
        eyes.numbers(both[e].find("gaze"), 2, [&](std::size_t k, double x) { eye.gaze[k] = x; });
        eyes.numbers(both[e].find("kappa"), 2, [&](std::size_t k, double x) { eye.kappa[k] = x; });
    }
    b.begin = file.values<std::uint32_t>("begin", {static_cast<Index>(b.bases.size()) + 1});
    b.change = file.columns<Eigen::half>("change");
    b.index = file.values<std::uint32_t>("index", {b.change.cols()});
    detail::check_bases(who, b);
    return b;
}

/// Returns the bases in a file. Throws an Error as parse_bases does, with the path.
inline SplatBases read_bases(const std::filesystem::path& path) {
    return parse_bases(read_file(path), path.string());
}

} // namespace rye
