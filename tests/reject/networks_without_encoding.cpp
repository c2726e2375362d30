// SPDX-License-Identifier: Apache-2.0
// Networks read points through an encoding, which the policy must name.
// expect: NetworkPolicy
#include <rye/rig/parts.hpp>

struct Plain {
    using Activation = rye::LeakyRelu;
#if !REJECT
    using Encoding = rye::PositionalEncoding;
#endif
    static constexpr int skip_layer(const rye::MlpShape&) { return rye::MlpShape::no_skip; }
};

using Mine = rye::More<rye::PaperEffects, rye::NetworksBy<Plain>>;
