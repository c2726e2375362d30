// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/config.cpp: any text as a run's configuration; a valid one must survive writing and
/// reading.
#include "fuzz.hpp"

#include "data/config.hpp"
#include "data/json.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    using Json = nlohmann::ordered_json;
    const std::string text(reinterpret_cast<const char*>(data), size);
    fuzz::attempt([&] {
        trainer::TrainConfig config = trainer::preset("tiny"), again = trainer::preset("paper");
        trainer::from_json(trainer::parse_json_text<Json>(text, fuzz::name,
                                                          trainer::JsonComments::skipped),
                           fuzz::name, config);
        const std::string written = trainer::to_json(config).dump();
        trainer::from_json(trainer::parse_json_text<Json>(written, fuzz::name), fuzz::name, again);
        fuzz::demand(trainer::to_json(again).dump() == written, "it comes back");
    });
    return 0;
}
