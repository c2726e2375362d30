// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/experiments.cpp: any text as a list of `rye compare`; what is read survives writing.
#include "fuzz.hpp"

#include "data/experiments.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    const std::string_view text(reinterpret_cast<const char*>(data), size);
    fuzz::attempt([&] {
        trainer::Experiment e = trainer::parse_experiment(text, fuzz::name);
        fuzz::demand(!e.rows.empty() && !e.columns.empty(), "rows and columns");
        const std::string written = trainer::to_json(e).dump();
        const trainer::Experiment again = trainer::parse_experiment(written, fuzz::name);
        fuzz::demand(trainer::to_json(again).dump() == written, "it comes back");
        trainer::configure(e, {"", {}, "", 1});
    });
    return 0;
}
