// SPDX-License-Identifier: Apache-2.0
// What a small file may ask for: each reader compares with a limit in bytes before it allocates.
#include <sstream>
#include <string>

#include <doctest/doctest.h>

#include <rye/io/npz.hpp>
#include <rye/io/safetensors.hpp>
#include <rye/io/splats.hpp>
#include <rye/core/random.hpp>

#include "../support/hostile.hpp"

using namespace rye;

namespace {

/// The message, which states that so much memory is needed beyond that limit.
std::string beyond(std::uint64_t need, std::uint64_t most) {
    return "would take " + std::to_string(need) + " bytes of memory, expected at most the limit of " +
           std::to_string(most);
}

GaussianCloud<float> cloud_of(Index n, int degree) {
    GaussianCloud<float> c(n, degree);
    GaussianCloud<float>::fields([](const std::string&, Columns<float>& a) { a.setConstant(0.5F); },
                                 c);
    return c;
}

/// A gzip file that begins with a header of `count` Gaussians and states their size, in so many
/// bytes.
Bytes stated_spz(std::uint32_t count, std::size_t bytes) {
    Bytes data(bytes);
    const Bytes truth = gunzip(spz_bytes(cloud_of(1, 0)), "a");
    std::copy(truth.begin(), truth.begin() + 16, data.begin());
    std::memcpy(data.data() + 8, &count, sizeof count);
    Bytes file = gzip_bytes(data);
    const std::uint32_t size = 16 + 20 * count;
    std::memcpy(file.data() + file.size() - 4, &size, sizeof size);
    return file;
}

/// A stream that cannot seek, as a pipe.
struct Pipe : std::stringbuf {
    using std::stringbuf::stringbuf;
    pos_type seekoff(off_type, std::ios::seekdir, std::ios::openmode) override {
        return pos_type(off_type(-1));
    }
};

} // namespace

TEST_CASE("memory: an SPZ of 923 kB that asks for 3.6 GB is refused before any of it is unpacked") {
    const Bytes file = stated_spz(47'600'000, 923'000);
    CHECK_FAULT(parse_spz<float>(file, "small.spz"),
                "small.spz: its 47600000 Gaussians " +
                    beyond(16 + 47'600'000ULL * (20 + 56), default_memory));
    // With room for them it goes on to the data, which are not there.
    CHECK_FAULT(parse_spz<float>(stated_spz(1000, 900), "small.spz", 1'000'000), "deflate: got 900");
    CHECK_FAULT(gunzip(file, "small.spz", 1000), "small.spz: its data " + beyond(952'000'016, 1000));
}

TEST_CASE("memory: an SPZ within its limit is read, and refused one byte below") {
    const Bytes file = spz_bytes(cloud_of(100, 2));
    const std::uint64_t need = 16 + 100 * (20 + 24) + 100 * (14 + 24) * sizeof(float);
    CHECK(parse_spz<float>(file, "a", need).count() == 100);
    CHECK_FAULT(parse_spz<float>(file, "a", need - 1), beyond(need, need - 1));
    // Twice as much in double.
    CHECK_FAULT(parse_spz<double>(file, "a", need), "a: its 100 Gaussians would take");
}

TEST_CASE("memory: PLY and .splat") {
    std::ostringstream text;
    write_ply(text, cloud_of(100, 1));
    const std::uint64_t need = 100 * 23 * sizeof(float);
    const auto read = [&](std::uint64_t memory) {
        std::istringstream in(text.str());
        return read_ply<float>(in, "a.ply", memory).count();
    };
    CHECK(read(need) == 100);
    CHECK_FAULT(read(need - 1), "read_ply: a.ply: its Gaussians " + beyond(need, need - 1));
    // A number of one byte takes eight.
    std::string small = "ply\nformat binary_little_endian 1.0\nelement vertex 1000\n";
    for (const char* name : {"x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0",
                             "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"})
        small += std::string("property char ") + name + "\n";
    small += "end_header\n" + std::string(14000, '\1');
    std::istringstream chars(small);
    CHECK_FAULT(read_ply<double>(chars, "chars.ply", 100'000), beyond(112'000, 100'000));
    // A pipe is held whole.
    const auto piped = [&](std::uint64_t memory) {
        Pipe buffer(text.str());
        std::istream in(&buffer);
        return read_ply<float>(in, "pipe", memory).count();
    };
    const std::uint64_t held = 100 * (23 + 3) * sizeof(float);
    CHECK(piped(need + held) == 100);
    CHECK_FAULT(piped(need + held - 1), "pipe: its Gaussians would take");
    CHECK_FAULT(piped(held - 1), "pipe: the data of a pipe would take");

    const Bytes splat = splat_bytes(cloud_of(100, 0));
    CHECK(parse_splat<float>(splat, "a", 5600).count() == 100);
    CHECK_FAULT(parse_splat<float>(splat, "a.splat", 5599), "a.splat: its Gaussians " + beyond(5600, 5599));

    const TemporaryFolder folder;
    write_atomic(folder.path / "a.splat", splat);
    CHECK(read_splats<float>(folder.path / "a.splat", 5600).count() == 100);
    CHECK_FAULT(read_splats<float>(folder.path / "a.splat", 5599), beyond(5600, 5599));
    write_atomic(folder.path / "a.spz", stated_spz(47'600'000, 923'000));
    CHECK_FAULT(read_splats<float>(folder.path / "a.spz"), "its 47600000 Gaussians would take");
}

TEST_CASE("memory: npz") {
    const NpyArray array = npy_array<double>(Columns<double>::Zero(3, 100));
    const std::uint64_t one = npy_bytes(array).size();
    const Bytes file = npz_bytes({{"a", array}, {"b", array}});
    CHECK(parse_npz(file, "a.npz", 2 * one).size() == 2);
    CHECK_FAULT(parse_npz(file, "a.npz", 2 * one - 1),
                "a.npz: 'b.npy': the file's arrays to here " + beyond(2 * one, 2 * one - 1));
}

TEST_CASE("memory: a JSON text of two bytes a value, alone and as the header of tensors") {
    std::string text = "[0";
    for (int i = 1; i < 10'000; ++i) text += ",0";
    text += "]";
    CHECK(parse_json(text, "a").get<JsonArray>()->size() == 10'000);
    CHECK_FAULT(parse_json(text, "a.json", 400'000), "bytes of memory, expected at most the limit of 400000");
    CHECK_FAULT(parse_json("{\"a\":1,\"b\":2}", "a.json", 200), "expected at most the limit of 200");
    CHECK_FAULT(parse_json("\"" + std::string(300, 'x') + "\"", "a.json", 200), "limit of 200");
    // 20 MB of header, of which the values would take a hundred times as much.
    std::string header = "{\"a\":[0";
    while (header.size() < 20'000'000) header += ",0";
    header += "]}";
    Bytes file;
    append(file, static_cast<std::uint64_t>(header.size()));
    append(file, as_bytes(header));
    CHECK_FAULT(parse_safetensors(file, "small.safetensors"), "small.safetensors: JSON at byte");
    CHECK_FAULT(parse_safetensors(file, "small.safetensors"),
                "bytes of memory, expected at most the limit of 268435456");
}
