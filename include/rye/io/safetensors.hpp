// SPDX-License-Identifier: Apache-2.0
/// rye/io/safetensors.hpp: named arrays in one file, in the format of Hugging Face.
/// Layout: u64 header length; JSON header, padded with spaces to 8 bytes; the arrays, C order,
/// without holes or overlaps. An array of shape (N, D) is a Columns of D x N.
/// Files written by rye have a checksum in their metadata; the reader rejects a wrong one.
/// Source: github.com/huggingface/safetensors; rejects the same faults as its reference reader.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <limits>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include <rye/io/atomic_file.hpp>
#include <rye/io/bytes.hpp>
#include <rye/io/json.hpp>
#include <rye/io/npy.hpp>
#include <rye/core/checksum.hpp>
#include <rye/core/columns.hpp>
#include <rye/core/error.hpp>

namespace rye {

/// Supported types; named F64, F32, I64, U8, F16 and U32 in files. F16 is IEEE's binary16,
/// Eigen::half.
enum class TensorType { f64, f32, i64, u8, f16, u32 };

namespace detail {

/// Number of supported types.
inline constexpr int tensor_types = 6;

/// Name of a type in files, and its size.
struct TensorTypeInfo {
    const char* name;
    std::size_t size;  ///< [bytes]
};

} // namespace detail

/// Returns the name and size of a type.
constexpr detail::TensorTypeInfo info_of(TensorType type) {
    constexpr std::array<detail::TensorTypeInfo, detail::tensor_types> infos{
        {{"F64", 8}, {"F32", 4}, {"I64", 8}, {"U8", 1}, {"F16", 2}, {"U32", 4}}};
    return infos[static_cast<std::size_t>(type)];
}

/// Returns the type of tensors of T.
template <class T>
constexpr TensorType tensor_type() {
    if constexpr (std::is_same_v<T, double>) return TensorType::f64;
    else if constexpr (std::is_same_v<T, float>) return TensorType::f32;
    else if constexpr (std::is_same_v<T, std::int64_t>) return TensorType::i64;
    else if constexpr (std::is_same_v<T, Eigen::half>) return TensorType::f16;
    else if constexpr (std::is_same_v<T, std::uint32_t>) return TensorType::u32;
    else {
        static_assert(std::is_same_v<T, std::uint8_t>,
                      "tensors hold double, float, Eigen::half, int64, uint32, uint8");
        return TensorType::u8;
    }
}

/// Named array in memory held elsewhere.
struct TensorEntry {
    std::string name;
    TensorType type = TensorType::f32;
    std::vector<Index> shape;  ///< empty for one number
    ByteSpan bytes;            ///< C order
};

/// Returns an entry for `values`, which must outlive it.
template <class T>
TensorEntry tensor_entry(std::string name, std::vector<Index> shape, std::span<const T> values) {
    return {std::move(name), tensor_type<T>(), std::move(shape), std::as_bytes(values)};
}
/// Returns an entry of shape (N, D) for D x N columns, which must outlive it.
template <class T>
TensorEntry tensor_entry(std::string name, const Columns<T>& columns) {
    return tensor_entry<T>(std::move(name), {columns.cols(), columns.rows()},
                           {columns.data(), static_cast<std::size_t>(columns.size())});
}

/// String metadata by key.
using TensorMetadata = std::map<std::string, std::string>;

namespace detail {

/// Metadata key of a file's checksum, which the writer adds and the reader removes.
inline constexpr const char* checksum_key = "checksum";

/// Returns the checksum of metadata and arrays: CRC-32 of a line KEY=WORD for each other word, by
/// key, then of a line NAME TYPE SHAPE CRC for each array, by name, with the CRC-32 of its bytes.
/// It does not depend on the order of the arrays in the file.
inline std::string tensor_checksum(const std::map<std::string, TensorEntry>& tensors,
                                   const TensorMetadata& metadata) {
    std::string text;
    for (const auto& [key, word] : metadata)
        if (key != checksum_key) text += key + "=" + word + "\n";
    for (const auto& [name, t] : tensors)
        text += name + " " + info_of(t.type).name + " " + shape_text(t.shape) + " " +
                std::to_string(crc32(t.bytes)) + "\n";
    return checksum_text(crc32(as_bytes(text)));
}

} // namespace detail

/// Largest header accepted, as in the reference reader.
inline constexpr std::uint64_t max_tensor_header = 100'000'000;

/// Arrays of a file, in memory.
class Safetensors {
public:
    Safetensors() = default;
    Safetensors(std::string who, Bytes data, std::map<std::string, TensorEntry> tensors,
                TensorMetadata metadata, bool checked = false)
        : who_(std::move(who)), data_(std::move(data)), tensors_(std::move(tensors)),
          metadata_(std::move(metadata)), checked_(checked) {}
    // Entries refer to data_, whose storage survives a move but not a copy.
    Safetensors(Safetensors&&) = default;
    Safetensors& operator=(Safetensors&&) = default;

    const std::map<std::string, TensorEntry>& tensors() const { return tensors_; }
    const TensorMetadata& metadata() const { return metadata_; }
    /// Returns true if the file stated its checksum, which was right.
    bool checked() const { return checked_; }
    bool has(const std::string& name) const { return tensors_.count(name) != 0; }

    const TensorEntry& at(const std::string& name) const {
        const auto found = tensors_.find(name);
        require(found != tensors_.end(), who_, "the tensor '", name, "' is missing");
        return found->second;
    }
    /// Returns a metadata value; throws an Error if it is missing.
    const std::string& word(const std::string& key) const {
        const auto found = metadata_.find(key);
        require(found != metadata_.end(), who_, "the metadata '", key, "' is missing");
        return found->second;
    }
    /// Returns the values of a tensor; throws an Error for another type or shape.
    template <class T>
    std::vector<T> values(const std::string& name, const std::vector<Index>& shape) const {
        const TensorEntry& t = at(name);
        require(
            t.shape == shape, [&] { return who_ + ": " + name; }, "got shape ",
            [&] { return shape_text(t.shape); }, ", expected ", [&] { return shape_text(shape); });
        std::vector<T> out(check_type<T>(t) / sizeof(T));
        if (!out.empty()) std::memcpy(out.data(), t.bytes.data(), t.bytes.size());
        return out;
    }
    /// Returns a tensor of shape (N, D) as D x N.
    template <class T>
    Columns<T> columns(const std::string& name) const {
        const TensorEntry& t = at(name);
        require(
            t.shape.size() == 2, [&] { return who_ + ": " + name; }, "got shape ",
            [&] { return shape_text(t.shape); }, ", expected two extents");
        Columns<T> out(t.shape[1], t.shape[0]);
        if (check_type<T>(t) > 0) std::memcpy(out.data(), t.bytes.data(), t.bytes.size());
        return out;
    }
    /// Returns a tensor of shape (cols, rows) as rows x cols.
    template <class T>
    Columns<T> columns(const std::string& name, Index rows, Index cols) const {
        const std::vector<Index>&got = at(name).shape, expected{cols, rows};
        require(
            got == expected, [&] { return who_ + ": " + name; }, "got shape ",
            [&] { return shape_text(got); }, ", expected ", [&] { return shape_text(expected); });
        return columns<T>(name);
    }

private:
    /// Returns the size of a tensor's elements [bytes]; throws an Error for another type.
    template <class T>
    std::size_t check_type(const TensorEntry& t) const {
        require(
            t.type == tensor_type<T>(), [&] { return who_ + ": " + t.name; }, "got type ",
            info_of(t.type).name, ", expected ", info_of(tensor_type<T>()).name);
        return t.bytes.size();
    }

    std::string who_;
    Bytes data_;
    std::map<std::string, TensorEntry> tensors_;
    TensorMetadata metadata_;
    bool checked_ = false;
};

namespace detail {

inline std::uint64_t tensor_count(const JsonValue& v, const std::string& who) {
    const auto* i = v.get<std::int64_t>();
    require(i && *i >= 0 && *i <= std::numeric_limits<Index>::max(), who, "expected a count");
    return static_cast<std::uint64_t>(*i);
}

inline TensorEntry parse_tensor(const std::string& name, const JsonValue& v, ByteSpan data,
                                const std::string& who) {
    const JsonValue *dtype = v.find("dtype"), *shape = v.find("shape"),
                    *offsets = v.find("data_offsets");
    require(dtype && dtype->get<std::string>() && shape && shape->get<JsonArray>() && offsets &&
                offsets->get<JsonArray>() && offsets->get<JsonArray>()->size() == 2 &&
                v.get<JsonObject>()->size() == 3,
            who, "expected dtype, shape and two data_offsets, and nothing else");
    TensorEntry t;
    t.name = name;
    bool known = false;
    for (int i = 0; i < tensor_types; ++i)
        if (const auto type = static_cast<TensorType>(i);
            *dtype->get<std::string>() == info_of(type).name) {
            t.type = type;
            known = true;
        }
    require(known, who, "got type ", *dtype->get<std::string>(),
            ", expected F64, F32, F16, I64, U32 or U8");
    for (const JsonValue& extent : *shape->get<JsonArray>())
        t.shape.push_back(static_cast<Index>(tensor_count(extent, who)));
    const std::uint64_t size = checked_size(t.shape, info_of(t.type).size, who);
    const std::uint64_t begin = tensor_count(offsets->get<JsonArray>()->at(0), who);
    const std::uint64_t end = tensor_count(offsets->get<JsonArray>()->at(1), who);
    require(
        begin <= end && end - begin == size, who, "shape ", [&] { return shape_text(t.shape); },
        " needs ", size, " bytes, got data_offsets ", begin, " to ", end);
    t.bytes = slice(data, begin, size, who, "its data");
    return t;
}

/// Throws an Error unless the arrays cover the data exactly once.
inline void require_covered(const std::map<std::string, TensorEntry>& tensors, ByteSpan data,
                            const std::string& who) {
    std::vector<std::pair<std::size_t, std::size_t>> ranges;
    for (const auto& [name, t] : tensors) {
        const auto begin = static_cast<std::size_t>(t.bytes.data() - data.data());
        ranges.emplace_back(begin, begin + t.bytes.size());
    }
    std::sort(ranges.begin(), ranges.end());
    std::size_t covered = 0;
    for (const auto& [begin, end] : ranges) {
        require(begin == covered, who, "its tensors overlap or leave a hole at byte ", covered);
        covered = end;
    }
    require(covered == data.size(), who, "its tensors end at byte ", covered,
            " of the data, which have ", data.size());
}

} // namespace detail

/// Parses the bytes of a file; errors begin with `who`. Allocates a copy of the bytes, and at most
/// `memory` bytes for the values of the header. Throws an Error for a wrong checksum.
inline Safetensors parse_safetensors(ByteSpan file, const std::string& who,
                                     std::uint64_t memory = default_memory / 8) {
    const auto length = read_at<std::uint64_t>(file, 0, who, "the length of the header");
    require(length <= max_tensor_header, who, "got a header of ", length,
            " bytes, expected at most 100000000");
    const std::string_view header = as_text(slice(file, 8, length, who, "the header"));
    require(header.starts_with('{'), who, "not a safetensors file: its header is no JSON object");
    const JsonValue json = parse_json(header, who, memory);
    const ByteSpan rest = file.subspan(8 + static_cast<std::size_t>(length));
    Bytes data(rest.begin(), rest.end());  // aligned, unlike `rest`
    std::map<std::string, TensorEntry> tensors;
    TensorMetadata metadata;
    for (const auto& [name, member] : *json.get<JsonObject>()) {
        const std::string label = who + ": " + name;
        require(member.get<JsonObject>(), label, "expected an object");
        if (name != "__metadata__") {
            tensors.emplace(name, detail::parse_tensor(name, member, data, label));
            continue;
        }
        for (const auto& [key, word] : *member.get<JsonObject>()) {
            require(word.get<std::string>(), label, "'", key, "' is no string");
            metadata.emplace(key, *word.get<std::string>());
        }
    }
    detail::require_covered(tensors, data, who);
    const auto checksum = metadata.extract(detail::checksum_key);
    if (!checksum.empty()) {
        const std::string right = detail::tensor_checksum(tensors, metadata);
        require(checksum.mapped() == right, who, "metadata 'checksum': got '", checksum.mapped(),
                "', expected '", right, "': the file is damaged");
    }
    return Safetensors(who, std::move(data), std::move(tensors), std::move(metadata),
                       !checksum.empty());
}

/// Reads a safetensors file. Throws an Error as parse_safetensors does, with the path.
inline Safetensors read_safetensors(const std::filesystem::path& path) {
    return parse_safetensors(read_file(path), path.string());
}

/// Replaces the file at `path` by one with these arrays; on failure leaves it unchanged and throws
/// an Error. Arrays of larger types come first, so that all are aligned. Adds a checksum to the
/// metadata.
inline void write_safetensors(const std::filesystem::path& path, std::vector<TensorEntry> entries,
                              TensorMetadata metadata = {}) {
    std::sort(entries.begin(), entries.end(), [](const TensorEntry& a, const TensorEntry& b) {
        const std::size_t sa = info_of(a.type).size, sb = info_of(b.type).size;
        return sa != sb ? sa > sb : a.name < b.name;
    });
    std::map<std::string, TensorEntry> by_name;
    for (const TensorEntry& t : entries) {
        const std::string label = path.string() + ": " + t.name;
        require(t.name != "__metadata__" && by_name.emplace(t.name, t).second, label,
                "is the name of two tensors, or reserved");
    }
    metadata[detail::checksum_key] = detail::tensor_checksum(by_name, metadata);
    std::string text = "{";
    const auto next_member = [&](const std::string& name) {
        if (text.back() != '{') text += ',';
        text += detail::json_string(name) + ':';
    };
    next_member("__metadata__");
    text += '{';
    for (const auto& [key, word] : metadata) {
        next_member(key);
        text += detail::json_string(word);
    }
    text += '}';
    std::uint64_t offset = 0;
    for (const TensorEntry& t : entries) {
        const std::string label = path.string() + ": " + t.name;
        const std::uint64_t size = checked_size(t.shape, info_of(t.type).size, label);
        std::string shape;
        for (const Index d : t.shape) shape += (shape.empty() ? "" : ",") + std::to_string(d);
        require(
            size == t.bytes.size(), label, "shape ", [&] { return shape_text(t.shape); }, " of ",
            info_of(t.type).name, " needs ", size, " bytes, got ", t.bytes.size());
        next_member(t.name);
        text += std::string(R"({"dtype":")") + info_of(t.type).name + R"(","shape":[)" + shape +
                R"(],"data_offsets":[)" + std::to_string(offset) + "," +
                std::to_string(offset + size) + "]}";
        offset += size;
    }
    text += '}';
    text.append((8 - text.size() % 8) % 8, ' ');
    Bytes length;
    append(length, static_cast<std::uint64_t>(text.size()));
    AtomicFile file(path);
    file.write(length);
    file.write(as_bytes(text));
    for (const TensorEntry& t : entries) file.write(t.bytes);
    file.commit();
}

} // namespace rye
