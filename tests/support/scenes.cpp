// SPDX-License-Identifier: Apache-2.0
#include "scenes.hpp"

namespace rye::test {

template Scenery<float> random_scene(Index, Index, std::uint64_t, double);
template Scenery<double> random_scene(Index, Index, std::uint64_t, double);
template std::vector<Scenery<float>> hard_scenes(Index);
template std::vector<Scenery<double>> hard_scenes(Index);
template Gaussians<float> noise_like(const Gaussians<float>&, std::uint64_t);
template Gaussians<double> noise_like(const Gaussians<double>&, std::uint64_t);

} // namespace rye::test
