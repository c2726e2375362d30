// SPDX-License-Identifier: Apache-2.0
/// data/json_fields.hpp: fields of untrusted JSON, each with a required type. `who` names the file
/// and the object of the field. Throws an Error with who, the field, its value and the expected
/// one.
#pragma once

#include <cmath>
#include <string>

#include "data/json.hpp"

namespace rye::trainer {

/// Returns a value as JSON, shortened if it is long.
template <class Json>
std::string json_excerpt(const Json& value) {
    constexpr std::size_t longest = 80;
    const std::string text = value.dump(-1, ' ', true);
    return text.size() <= longest ? text : text.substr(0, longest) + "...";
}

/// Returns a finite number.
template <class Json>
double json_number(const Json& value, const std::string& who) {
    require(
        value.is_number() && std::isfinite(value.template get<double>()), who, "got ",
        [&] { return json_excerpt(value); }, ", expected a finite number");
    return value.template get<double>();
}

/// Returns the finite number of a field, or `otherwise` if there is no such field.
template <class Json>
double json_number(const Json& object, const std::string& key, double otherwise,
                   const std::string& who) {
    return object.contains(key) ? json_number(object.at(key), who + ": " + key) : otherwise;
}

/// Returns the text of a field, or `otherwise` if there is no such field.
template <class Json>
std::string json_text(const Json& object, const std::string& key, const std::string& otherwise,
                      const std::string& who) {
    if (!object.contains(key)) return otherwise;
    const Json& value = object.at(key);
    require(
        value.is_string(), who + ": " + key, "got ", [&] { return json_excerpt(value); },
        ", expected a text in quotation marks");
    return value.template get<std::string>();
}

/// Returns the list of a field, which must exist.
template <class Json>
const Json& json_list(const Json& object, const char* key, const std::string& who,
                      const char* expected) {
    require(
        object.is_object(), who, "got ", [&] { return json_excerpt(object); },
        ", expected an object with ", key);
    require(object.contains(key), who + ": " + key, "is missing, expected ", expected);
    require(
        object.at(key).is_array(), who + ": " + key, "got ",
        [&] { return json_excerpt(object.at(key)); }, ", expected ", expected);
    return object.at(key);
}

} // namespace rye::trainer
