// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/expression_shapes.cpp: any bytes as the expression_shapes.npz of a capture with two
/// coefficients, with three vertices a frame and with none.
#include "fuzz.hpp"

#include "data/expression_shapes.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    for (const Index vertices : {3, 0})
        fuzz::attempt([&] {
            const Columns<double> shapes = trainer::parse_expression_shapes(
                fuzz::bytes_of(data, size), fuzz::name, 2, vertices);
            fuzz::demand(shapes.rows() == 2 && shapes.allFinite(), "a finite shape each");
        });
    return 0;
}
