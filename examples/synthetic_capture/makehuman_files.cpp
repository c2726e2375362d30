// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/makehuman_files.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>

#include <rye/io/gzip.hpp>
#include <rye/core/error.hpp>
#include <rye/core/parse.hpp>

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

/// Longest file that is read, unpacked [bytes].
constexpr std::uint64_t longest = 1ULL << 28U;

/// Returns the next word of a line, and removes it from the line.
std::string_view word(std::string_view& line) {
    const std::size_t begin = std::min(line.find_first_not_of(" \t\r"), line.size());
    const std::size_t end = std::min(line.find_first_of(" \t\r", begin), line.size());
    const std::string_view found = line.substr(begin, end - begin);
    line.remove_prefix(end);
    return found;
}

/// Calls f(line, who) for each line, where `who` names the file and the line.
template <class F>
void for_lines(std::string_view text, const std::string& name, F&& f) {
    for (int number = 1; !text.empty(); ++number) {
        const std::string_view line = text.substr(0, text.find('\n'));
        text.remove_prefix(std::min(line.size() + 1, text.size()));
        f(line, name + ": line " + std::to_string(number));
    }
}

double number(std::string_view digits, const char* what, const std::string& who) {
    const std::optional<double> x = parse_double(digits);
    require(x && std::isfinite(*x), who, "got the ", what, " '", digits,
            "', expected a finite number");
    return *x;
}

/// A whole number from `first` to `last`.
Index index(std::string_view digits, Index first, Index last, const char* what,
            const std::string& who) {
    long long i = 0;
    const auto [end, status] = std::from_chars(digits.data(), digits.data() + digits.size(), i);
    require(
        status == std::errc() && end == digits.data() + digits.size() && i >= first && i <= last,
        who, "got the ", what, " '", digits, "', expected ", first, " to ", last);
    return static_cast<Index>(i);
}

Quad quad(std::string_view line, Index vertices, Index uvs, const std::string& who) {
    Quad q;
    std::size_t n = 0;
    for (std::string_view c = word(line); !c.empty(); c = word(line), ++n) {
        if (n >= 4) continue;
        const std::size_t slash = c.find('/');
        require(slash != std::string_view::npos, who, "got the corner '", c,
                "', expected a vertex and a texture coordinate, such as 7/9");
        const std::string_view rest = c.substr(slash + 1);
        q.vertex[n] = index(c.substr(0, slash), 1, vertices, "vertex", who) - 1;
        q.uv[n] = index(rest.substr(0, rest.find('/')), 1, uvs, "texture coordinate", who) - 1;
    }
    require(n == 4, who, "got a face of ", n, " corners, expected 4");
    return q;
}

} // namespace

QuadMesh parse_quads(std::string_view text, const std::string& name) {
    std::vector<double> xyz, uv;
    QuadMesh mesh;
    std::size_t group = 0;
    for_lines(text, name, [&](std::string_view line, const std::string& who) {
        const std::string_view kind = word(line);
        if (kind == "v")
            for (int d = 0; d < 3; ++d) xyz.push_back(number(word(line), "coordinate", who));
        if (kind == "vt")
            for (int d = 0; d < 2; ++d) uv.push_back(number(word(line), "texture coordinate", who));
        if (kind == "g") {
            const std::string_view title = word(line);
            const auto at = std::find(mesh.groups.begin(), mesh.groups.end(), title);
            group = static_cast<std::size_t>(at - mesh.groups.begin());
            if (at == mesh.groups.end()) mesh.groups.emplace_back(title);
        }
        if (kind != "f") return;
        if (mesh.groups.empty()) mesh.groups.emplace_back();
        mesh.faces.push_back(
            quad(line, static_cast<Index>(xyz.size() / 3), static_cast<Index>(uv.size() / 2), who));
        mesh.group.push_back(group);
    });
    require(!mesh.faces.empty(), name, "has no faces, expected an OBJ mesh of quads");
    mesh.vertices = Eigen::Map<const Points>(xyz.data(), 3, static_cast<Index>(xyz.size() / 3));
    mesh.uv = Eigen::Map<const Columns<double>>(uv.data(), 2, static_cast<Index>(uv.size() / 2));
    return mesh;
}

Points parse_target(std::string_view text, Index count, const std::string& name) {
    Points moved = Points::Zero(3, count);
    for_lines(text, name, [&](std::string_view line, const std::string& who) {
        line = line.substr(0, line.find('#'));
        const std::string_view first = word(line);
        if (first.empty()) return;
        const Index vertex = index(first, 0, count - 1, "vertex", who);
        for (int d = 0; d < 3; ++d) moved(d, vertex) = number(word(line), "displacement", who);
        require(word(line).empty(), who, "got more than a vertex and three displacements");
    });
    return moved;
}

std::string read_plain_or_gz(const fs::path& path) {
    fs::path packed = path;
    packed += ".gz";
    const bool plain = fs::exists(path);
    require(plain || fs::exists(packed), path.string(), "no such file, nor one ending in .gz");
    const fs::path& there = plain ? path : packed;
    Bytes bytes = read_file(there, longest);
    if (is_gzip(bytes)) bytes = gunzip(bytes, there.string(), longest);
    return std::string(as_text(bytes));
}

} // namespace rye::trainer
