// SPDX-License-Identifier: Apache-2.0
#include <rye/io/safetensors.hpp>

#include <array>
#include <filesystem>
#include <string>

#include <doctest/doctest.h>

#include "../support/hostile.hpp"

using namespace rye;

namespace {

Bytes file_with(const std::string& header, std::size_t data_bytes) {
    Bytes out;
    append(out, static_cast<std::uint64_t>(header.size()));
    append(out, as_bytes(header));
    out.resize(out.size() + data_bytes);
    return out;
}

Safetensors parse(const std::string& header, std::size_t data_bytes) {
    return parse_safetensors(file_with(header, data_bytes), "x.safetensors");
}

} // namespace

TEST_CASE("safetensors: what is written is read back, whatever the order and the types") {
    const TemporaryFolder folder;
    const std::filesystem::path path = folder.path / "a.safetensors";
    const Columns<float> weight = Columns<float>::Random(3, 5);
    const Columns<double> moment = Columns<double>::Random(2, 1), none(3, 0);
    const std::vector<std::int64_t> step{-7};
    const std::vector<std::uint8_t> flags{1, 0, 255};
    write_safetensors(path,
                      {tensor_entry<std::uint8_t>("flags", {3}, flags), tensor_entry("w", weight),
                       tensor_entry<std::int64_t>("step", {}, step), tensor_entry("m", moment),
                       tensor_entry("none", none)},
                      {{"format", "rye 1"}, {"words", "\"quoted\"\n\xC3\xA9"}});
    const Safetensors file = read_safetensors(path);
    CHECK(file.tensors().size() == 5);
    CHECK(file.columns<float>("w") == weight);
    CHECK(file.columns<float>("w", 3, 5) == weight);
    CHECK(file.columns<double>("m") == moment);
    CHECK(file.columns<double>("none").cols() == 0);
    CHECK(file.values<std::int64_t>("step", {}) == step);
    CHECK(file.values<std::uint8_t>("flags", {3}) == flags);
    CHECK(file.word("words") == "\"quoted\"\n\xC3\xA9");
    CHECK(file.has("w"));
    CHECK(!file.has("v"));
    // As in the reference writer: data start on a multiple of 8, each array is aligned.
    CHECK(read_at<std::uint64_t>(read_file(path), 0, "x", "x") % 8 == 0);
    for (const auto& [name, t] : file.tensors())
        CHECK(reinterpret_cast<std::uintptr_t>(t.bytes.data()) % info_of(t.type).size == 0);

    const Columns<Eigen::half> half = weight.cast<Eigen::half>();
    write_safetensors(folder.path / "h", {tensor_entry("h", half)});
    const Safetensors halves = read_safetensors(folder.path / "h");
    CHECK(info_of(halves.at("h").type).name == std::string("F16"));
    CHECK(halves.columns<Eigen::half>("h").cast<float>() == half.cast<float>());
    CHECK_FAULT(halves.columns<float>("h"), "h: got type F16, expected F32");

    CHECK_FAULT(file.columns<double>("w"), "w: got type F32, expected F64");
    CHECK_FAULT(file.columns<float>("w", 5, 3), "w: got shape (5, 3), expected (3, 5)");
    CHECK_FAULT(file.values<float>("w", {15}), "got shape (5, 3), expected (15,)");
    CHECK_FAULT(file.columns<float>("v"), "the tensor 'v' is missing");
    CHECK_FAULT(file.columns<std::uint8_t>("flags"), "expected two extents");
    CHECK_FAULT(file.word("who"), "the metadata 'who' is missing");

    // Equal arrays in another order give the same bytes.
    write_safetensors(folder.path / "b", {tensor_entry("m", moment), tensor_entry("w", weight)});
    write_safetensors(folder.path / "c", {tensor_entry("w", weight), tensor_entry("m", moment)});
    CHECK(read_file(folder.path / "b") == read_file(folder.path / "c"));
}

TEST_CASE("safetensors: a moved file keeps its arrays") {
    Safetensors a = parse(R"({"u":{"dtype":"U8","shape":[2],"data_offsets":[0,2]}})", 2);
    const Safetensors b = std::move(a);
    CHECK(b.values<std::uint8_t>("u", {2}) == std::vector<std::uint8_t>{0, 0});
}

TEST_CASE("safetensors: the reference's list of faults") {
    const auto u8 = [](const std::string& shape, const std::string& offsets) {
        return R"({"u":{"dtype":"U8","shape":)" + shape + R"(,"data_offsets":)" + offsets + "}}";
    };
    CHECK(parse(u8("[2]", "[0,2]") + "     ", 2).tensors().size() == 1);
    CHECK(parse("{}", 0).tensors().empty());
    Bytes huge;
    append(huge, std::uint64_t(100'000'001));
    CHECK_FAULT(parse_safetensors(huge, "x"), "got a header of 100000001 bytes");
    Bytes beyond = file_with("{}", 0);
    beyond[0] = std::byte(3);
    CHECK_FAULT(parse_safetensors(beyond, "x"), "x: truncated: the header");
    CHECK_FAULT(parse_safetensors(ByteSpan(beyond).first(5), "x"), "the length of the header");
    CHECK_FAULT(parse(" {}", 0), "no JSON object");
    CHECK_FAULT(parse("{\xff}", 0), "JSON at byte 1");
    CHECK_FAULT(parse("{\"u\":1}", 0), "expected an object");
    CHECK_FAULT(parse(u8("[2]", "[0,3]"), 3), "needs 2 bytes, got data_offsets 0 to 3");
    CHECK_FAULT(parse(u8("[2]", "[2,0]"), 2), "got data_offsets 2 to 0");
    CHECK_FAULT(parse(u8("[2]", "[1,3]"), 2), "truncated");
    CHECK_FAULT(parse(u8("[2]", "[0,2]"), 3), "end at byte 2 of the data, which have 3");
    CHECK_FAULT(parse(u8("[2]", "[1,3]"), 3), "leave a hole at byte 0");
    CHECK_FAULT(parse(u8("[-2]", "[0,2]"), 2), "expected a count");
    CHECK_FAULT(parse(u8("[2.0]", "[0,2]"), 2), "expected a count");
    CHECK_FAULT(parse(u8("[4294967296,4294967296]", "[0,0]"), 0), "overflows");
    CHECK_FAULT(parse(u8("[4611686018427387904,2,0]", "[0,0]"), 0), "overflows");
    CHECK_FAULT(parse(u8("[2]", "[0]"), 2), "expected dtype, shape and two data_offsets");
    CHECK_FAULT(parse(R"({"u":{"dtype":"BF16","shape":[1],"data_offsets":[0,2]}})", 2),
                "got type BF16, expected F64, F32, F16, I64, U32 or U8");
    CHECK_FAULT(parse(R"({"a":{"dtype":"U8","shape":[2],"data_offsets":[0,2]},)"
                      R"("b":{"dtype":"U8","shape":[2],"data_offsets":[1,3]}})",
                      3),
                "overlap");
    CHECK_FAULT(parse(R"({"a":{"dtype":"U8","shape":[0],"data_offsets":[0,0]},)"
                      R"("a":{"dtype":"U8","shape":[0],"data_offsets":[0,0]}})",
                      0),
                "appears twice");
    CHECK_FAULT(parse(R"({"__metadata__":{"a":1}})", 0), "'a' is no string");
}

TEST_CASE("safetensors: truncated anywhere, it is refused") {
    const Bytes whole = file_with(R"({"u":{"dtype":"U8","shape":[9],"data_offsets":[0,9]}})", 9);
    for (std::size_t n = 0; n < whole.size(); ++n)
        CHECK_FAULT(parse_safetensors(ByteSpan(whole).first(n), "cut"), "cut");
}

TEST_CASE("safetensors: a bad entry leaves the old file as it was") {
    const TemporaryFolder folder;
    const std::filesystem::path path = folder.path / "a.safetensors";
    const Columns<float> w = Columns<float>::Ones(2, 2);
    write_safetensors(path, {tensor_entry("w", w)});
    const Bytes before = read_file(path);
    TensorEntry wrong = tensor_entry("w", w);
    wrong.shape = {5};
    CHECK_FAULT(write_safetensors(path, {wrong}), "w: shape (5,) of F32 needs 20 bytes, got 16");
    CHECK_FAULT(write_safetensors(path, {tensor_entry("w", w), tensor_entry("w", w)}),
                "two tensors");
    CHECK(read_file(path) == before);
    CHECK(files_in(folder.path) == 1);
}

TEST_CASE("safetensors: a flipped bit is refused, and a file without a checksum is told apart") {
    const TemporaryFolder folder;
    const std::filesystem::path path = folder.path / "a.safetensors";
    const Columns<float> w = Columns<float>::Ones(3, 2);
    const std::vector<std::int64_t> step{5};
    write_safetensors(path, {tensor_entry("w", w), tensor_entry<std::int64_t>("step", {}, step)},
                      {{"format", "a"}});
    const Bytes whole = read_file(path);
    const Safetensors file = parse_safetensors(whole, "a");
    CHECK(file.checked());
    CHECK(file.metadata().count("checksum") == 0);
    int told = 0;
    for (std::size_t bit = 0; bit < 8 * whole.size(); ++bit) {
        Bytes bytes = whole;
        bytes[bit / 8] ^= static_cast<std::byte>(1U << (bit % 8));
        try {
            const Safetensors read = parse_safetensors(bytes, "a");
            const Columns<float> got = read.columns<float>("w");
            const auto count = read.values<std::int64_t>("step", {});
            const std::string word = read.word("format");
            CHECK(got == w);
            CHECK(count == step);
            CHECK(word == "a");
        } catch (const Error& e) {
            CHECK(std::string(e.what()).starts_with("a: "));
            ++told;
        }
    }
    CHECK(told > static_cast<int>(8 * whole.size()) / 2);
    CHECK(!parse(R"({"w":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}})", 4).checked());
    CHECK_FAULT(parse(R"({"__metadata__":{"checksum":"01234567"}})", 0), "the file is damaged");
}
