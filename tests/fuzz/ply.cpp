// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/ply.cpp: any bytes as a PLY file, from seekable and non-seekable streams.
#include "fuzz.hpp"

#include <sstream>

#include <rye/io/ply.hpp>

struct Pipe : std::stringbuf {
    using std::stringbuf::stringbuf;
    pos_type seekoff(off_type, std::ios::seekdir, std::ios::openmode) override { return -1; }
};

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    const std::string text(reinterpret_cast<const char*>(data), size);
    fuzz::attempt([&] {
        std::istringstream in(text);
        const auto cloud = read_ply<float>(in, fuzz::name);
        fuzz::demand(cloud.mean.allFinite() && cloud.rotation.allFinite(), "numbers are finite");
    });
    fuzz::attempt([&] {
        Pipe pipe(text, std::ios::in);
        std::istream in(&pipe);
        read_ply<double>(in, fuzz::name);
    });
    return 0;
}
