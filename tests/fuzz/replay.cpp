// SPDX-License-Identifier: Apache-2.0
/// replay FOLDER...: runs each file of FOLDER/<target>/ once by that target, for compilers without
/// libFuzzer. A fault ends the program.
#include <iostream>
#include <map>

#include <rye/io/bytes.hpp>

using Target = int (*)(const std::uint8_t*, std::size_t);

// Each target's LLVMFuzzerTestOneInput, renamed by the build.
#define RYE_TARGET(name) extern "C" int fuzz_##name(const std::uint8_t* data, std::size_t size);
RYE_TARGETS
#undef RYE_TARGET

int main(int count, char** words) {
#define RYE_TARGET(name) {#name, fuzz_##name},
    const std::map<std::string, Target> targets{RYE_TARGETS};
    int files = 0;
    for (int i = 1; i < count; ++i)
        for (const auto& [name, target] : targets) {
            const std::filesystem::path folder = std::filesystem::path(words[i]) / name;
            if (!std::filesystem::is_directory(folder)) continue;
            for (const auto& entry : std::filesystem::directory_iterator(folder)) {
                std::cout << entry.path().string() << std::endl;  // before it can crash
                const rye::Bytes bytes = rye::read_file(entry.path());
                target(reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size());
                ++files;
            }
        }
    std::cout << files << " inputs read or refused as they should be\n";
    return files == 0 ? 1 : 0;
}
