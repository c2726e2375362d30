// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/import_record.cpp: any text as the import.json of an import that goes on.
#include "fuzz.hpp"

#include "importers/import_folder.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    const std::string_view text(reinterpret_cast<const char*>(data), size);
    fuzz::attempt([&] {
        for (const auto& [frame, facts] : trainer::parse_import_record(text, fuzz::name).frames) {
            // As the importers ask for them.
            fuzz::demand(facts.value("views", 0) >= 0 && facts.value("error", 0.0) >= 0 &&
                             facts.value("expression", std::size_t(0)) < 1000000000,
                         "facts are numbers in their range");
            facts.value("gaze", true);
        }
    });
    return 0;
}
