// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>
#include <string>
#include <string_view>

#include <rye/io/bytes.hpp>
#include <rye/core/error.hpp>
#include <rye/core/parse.hpp>

#include "importers/flame.hpp"

namespace rye::trainer {
namespace {

/// Returns the next word of a line, and removes it from the line.
std::string_view word(std::string_view& line) {
    const std::size_t begin = std::min(line.find_first_not_of(" \t\r"), line.size());
    const std::size_t end = std::min(line.find_first_of(" \t\r", begin), line.size());
    const std::string_view found = line.substr(begin, end - begin);
    line.remove_prefix(end);
    return found;
}

/// Returns the index of a vertex from "7", "7/1", "7//3" or "-1".
Index corner(std::string_view text, Index count, const std::string& who) {
    const std::string_view digits = text.substr(0, text.find('/'));
    long long i = 0;
    const auto [end, status] = std::from_chars(digits.data(), digits.data() + digits.size(), i);
    const long long vertex = i > 0 ? i - 1 : static_cast<long long>(count) + i;
    require(status == std::errc() && end == digits.data() + digits.size() && i != 0 &&
                vertex >= 0 && vertex < static_cast<long long>(count),
            who, "got the corner '", text, "', expected a vertex, 1 to ", count);
    return static_cast<Index>(vertex);
}

} // namespace

TriangleMesh<double> parse_obj(std::string_view text, const std::string& name) {
    std::vector<double> xyz;
    TriangleMesh<double> mesh;
    for (int number = 1; !text.empty(); ++number) {
        std::string_view line = text.substr(0, text.find('\n'));
        text.remove_prefix(std::min(line.size() + 1, text.size()));
        const std::string_view kind = word(line);
        if (kind != "v" && kind != "f") continue;
        const std::string who = name + ": line " + std::to_string(number);
        if (kind == "v") {
            for (int d = 0; d < 3; ++d) {
                const std::string_view digits = word(line);
                const std::optional<double> x = parse_double(digits);
                require(x && std::isfinite(*x), who, "got the coordinate '", digits,
                        "', expected a finite number");
                xyz.push_back(*x);
            }
            continue;
        }
        std::vector<Index> polygon;
        const Index count = static_cast<Index>(xyz.size() / 3);
        for (std::string_view c = word(line); !c.empty(); c = word(line))
            polygon.push_back(corner(c, count, who));
        require(polygon.size() >= 3, who, "got a face of ", polygon.size(),
                " corners, expected 3 or more");
        for (std::size_t k = 1; k + 1 < polygon.size(); ++k)
            mesh.faces.push_back({polygon[0], polygon[k], polygon[k + 1]});
    }
    require(!xyz.empty(), name, "has no vertices, expected an OBJ mesh");
    mesh.vertices =
        Eigen::Map<const Columns<double>>(xyz.data(), 3, static_cast<Index>(xyz.size() / 3));
    return mesh;
}

TriangleMesh<double> read_obj(const std::filesystem::path& path) {
    const Bytes bytes = read_file(path, 1ULL << 28U);
    return parse_obj(as_text(bytes), path.string());
}

} // namespace rye::trainer
