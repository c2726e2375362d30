// SPDX-License-Identifier: Apache-2.0
#include "viewing/viewed.hpp"

#include <algorithm>
#include <array>

namespace rye::trainer {

std::vector<ViewedPrice> prices_of(ViewedScene& scene, ViewWish wish,
                                   const std::vector<std::string>& accuracies) {
    constexpr std::size_t rounds = 3;
    const Pinhole<float> camera = wish.camera;
    std::vector<ViewedPrice> prices;
    std::vector<Image<float>> pictures;
    for (const std::string& name : accuracies) {
        wish.accuracy = name;
        std::array<double, rounds> ms{};
        for (std::size_t i = 0; i < rounds; ++i) {
            // A camera that differs by a little: nothing of the picture before serves.
            wish.camera = camera;
            wish.camera.cx += 1e-3f * static_cast<float>(i + 1);
            ms[i] = scene.draw(wish).ms;
        }
        std::sort(ms.begin(), ms.end());
        wish.camera = camera;
        pictures.push_back(scene.draw(wish).picture);
        prices.push_back({name, ms[rounds / 2], 0, 0});
    }
    for (std::size_t i = 0; i < prices.size(); ++i) {
        const auto difference = (pictures[i].pixels - pictures.back().pixels).cwiseAbs();
        prices[i].most = static_cast<double>(difference.maxCoeff());
        prices[i].mean = static_cast<double>(difference.mean());
    }
    return prices;
}

} // namespace rye::trainer
