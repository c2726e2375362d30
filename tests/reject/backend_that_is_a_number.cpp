// SPDX-License-Identifier: Apache-2.0
// The backend is a type with threads; a scalar in its place is an easy slip in a parameter list.
// expect: Backend
#include <rye/backend/scalar.hpp>
#include <rye/nn/mlp.hpp>

rye::Columns<float> evaluate(const rye::Mlp<float>& m, const rye::Columns<float>& points) {
#if REJECT
    return rye::mlp_forward(float{}, m, points, rye::VecX<float>(), nullptr);
#else
    return rye::mlp_forward(rye::ScalarBackend<>{}, m, points, rye::VecX<float>(), nullptr);
#endif
}
