// SPDX-License-Identifier: Apache-2.0
#include "data/expression_shapes.hpp"

#include <algorithm>
#include <cmath>

#include <rye/io/npz.hpp>
#include <rye/core/error.hpp>

#include "data/memory_limit.hpp"
#include "data/samples.hpp"

namespace rye::trainer {
namespace {

/// Returns points (E, N, 3) as 3 x N for each e.
std::vector<Columns<double>> read_shapes(const NpzArrays& arrays, const std::string& file,
                                         const std::string& name, Index expression) {
    const std::string who = file + ": " + name;
    const auto found = arrays.find(name);
    require(found != arrays.end(), who, "is missing from the file");
    const std::vector<Index>& shape = found->second.shape;
    require(
        shape.size() == 3 && shape[0] == expression && shape[2] == 3, who, "got shape ",
        [&] { return shape_text(shape); }, ", expected (", expression,
        ", N, 3), a shape for each exp_coeff");
    const std::vector<double> values = found->second.values<double>(who);
    require(std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); }),
            who, "has a number that is not finite");
    std::vector<Columns<double>> all;
    for (Index e = 0; e < expression; ++e)
        all.emplace_back(
            Eigen::Map<const Columns<double>>(values.data() + e * 3 * shape[1], 3, shape[1]));
    return all;
}

} // namespace

Columns<double> parse_expression_shapes(ByteSpan bytes, const std::string& who, Index expression,
                                        Index vertices, Index stride) {
    const NpzArrays arrays = parse_npz(bytes, who, memory_limit());
    const auto landmarks = read_shapes(arrays, who, "landmarks", expression);
    std::vector<Columns<double>> dense(static_cast<std::size_t>(expression), Columns<double>(3, 0));
    if (vertices > 0) dense = read_shapes(arrays, who, "vertices", expression);
    Columns<double> all;
    for (std::size_t e = 0; e < landmarks.size(); ++e) {
        require(dense[e].cols() == vertices, who + ": vertices", "got ", dense[e].cols(),
                " vertices, expected the ", vertices, " of vertices.npy");
        const Columns<double> sparse = common_landmarks(landmarks[e], who + ": landmarks");
        const Columns<double> moved = stride > 0 ? chosen_landmarks(sparse, dense[e], stride)
                                                 : chosen_landmarks(sparse, dense[e]);
        if (all.size() == 0) all.resize(expression, moved.size());
        all.row(static_cast<Index>(e)) =
            Eigen::Map<const Eigen::RowVectorXd>(moved.data(), moved.size());
    }
    return all;
}

Columns<double> expression_shapes(const Capture& capture) {
    return expression_shapes(capture, 0);
}
Columns<double> expression_shapes(const Capture& capture, Index stride) {
    const std::filesystem::path file = capture.folder / "expression_shapes.npz";
    if (!std::filesystem::exists(file) || capture.frames.empty()) return {};
    return parse_expression_shapes(read_file(file), file.string(), capture.expression_width(),
                                   capture.frames.front().vertices.cols(), stride);
}

} // namespace rye::trainer
