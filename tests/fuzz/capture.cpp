// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/capture.cpp: any text as the capture.json of a valid capture of one frame.
#include "fuzz.hpp"

#include "../programs/tiny_capture.hpp"
#include "data/capture.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    static const fuzz::Folder folder;
    static const trainer::TinyCapture tiny = [] {
        const trainer::TinyCapture made(folder.path);
        for (int f = 1; f < trainer::TinyCapture::frames; ++f)
            for (const char* part : {"images", "cameras", "params"})
                std::filesystem::remove_all(folder.path / part / trainer::TinyCapture::frame(f));
        return made;
    }();
    tiny.write_text("capture.json", {reinterpret_cast<const char*>(data), size});
    std::vector<trainer::Problem> problems;
    fuzz::attempt([&] { trainer::read_capture(folder.path, {}, &problems); }, "capture.json");
    return 0;
}
