// SPDX-License-Identifier: Apache-2.0
#include "importers/hdf5_file.hpp"

#include <cstring>

#include <rye/io/bytes.hpp>
#include <rye/io/npy.hpp>
#include <rye/core/error.hpp>
#include <rye/core/memory.hpp>

#include "data/memory_limit.hpp"

#ifdef RYE_HDF5
#include <hdf5.h>
#endif

namespace rye::trainer {

std::vector<std::uint8_t> decode_lzf(const std::uint8_t* data, std::size_t count, std::size_t size,
                                     const std::string& who) {
    // The longest copy, 264 bytes, takes 3: a small file cannot state a large size.
    require(size / 88 <= count, who, "states ", size, " bytes from ", count,
            " of LZF data, expected at most 88 times as many");
    std::vector<std::uint8_t> out;
    out.reserve(size);
    std::size_t at = 0;
    const auto take = [&] {
        require(at < count, who, "its LZF data end too early");
        return data[at++];
    };
    while (at < count) {
        const std::uint8_t control = take();
        if (control < 32) { // literal bytes
            const std::size_t run = std::size_t(control) + 1;
            require(run <= count - at && run <= size - out.size(), who, "its LZF data are damaged");
            out.insert(out.end(), data + at, data + at + run);
            at += run;
            continue;
        }
        std::size_t length = control >> 5U;
        if (length == 7) length += take();
        length += 2;
        const std::size_t back = (std::size_t(control & 31U) << 8U) + take() + 1;
        require(back <= out.size() && length <= size - out.size(), who, "its LZF data are damaged");
        for (std::size_t i = 0; i < length; ++i) out.push_back(out[out.size() - back]);
    }
    require(out.size() == size, who, "its LZF data make ", out.size(), " bytes, expected ", size);
    return out;
}

#ifdef RYE_HDF5
namespace {

constexpr H5Z_filter_t lzf_filter = 32000; // h5py's, registered with the HDF Group

/// Decompresses LZF; does not compress. cd_values[2] is the size of a chunk.
std::size_t undo_lzf(unsigned flags, std::size_t parameters, const unsigned values[],
                     std::size_t count, std::size_t* room, void** buffer) {
    if ((flags & H5Z_FLAG_REVERSE) == 0 || parameters < 3) return 0;
    try {
        const std::vector<std::uint8_t> out =
            decode_lzf(static_cast<const std::uint8_t*>(*buffer), count, values[2], "chunk");
        void* memory = H5allocate_memory(out.size(), false);
        if (memory == nullptr) return 0;
        std::memcpy(memory, out.data(), out.size());
        H5free_memory(*buffer);
        *buffer = memory;
        *room = out.size();
        return out.size();
    } catch (const std::exception&) {
        return 0; // the library reports a failed filter
    }
}

void prepare_library() {
    static const bool once = [] {
        H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
        const H5Z_class2_t lzf{H5Z_CLASS_T_VERS, lzf_filter, 0,       1, "lzf",
                               nullptr,          nullptr,    undo_lzf};
        H5Zregister(&lzf);
        return true;
    }();
    static_cast<void>(once);
}

/// Identifier of the library, closed at the end of the scope.
struct Id {
    hid_t id;
    herr_t (*close)(hid_t);
    ~Id() {
        if (id >= 0) close(id);
    }
    Id(hid_t i, herr_t (*c)(hid_t)) : id(i), close(c) {}
    Id(const Id&) = delete;
    Id& operator=(const Id&) = delete;
};

} // namespace

struct Hdf5File::Handle {
    hid_t file;
    std::string name;

    /// Returns the extents, after a check that the array has numbers of a bounded size.
    std::vector<hsize_t> extents(hid_t set, const std::string& array) const {
        const std::string who = name + ": " + array;
        const Id type(H5Dget_type(set), H5Tclose), space(H5Dget_space(set), H5Sclose);
        const H5T_class_t kind = H5Tget_class(type.id);
        require(kind == H5T_INTEGER || kind == H5T_FLOAT, who, "expected an array of numbers");
        const int rank = H5Sget_simple_extent_ndims(space.id);
        require(rank >= 0 && rank <= 8, who, "got ", rank, " extents, expected at most 8");
        std::vector<hsize_t> shape(static_cast<std::size_t>(rank));
        if (rank > 0) H5Sget_simple_extent_dims(space.id, shape.data(), nullptr);
        checked_size(shape, 8, who);
        return shape;
    }
    hid_t open(const std::string& array) const {
        const hid_t set = H5Dopen2(file, array.c_str(), H5P_DEFAULT);
        require(set >= 0, name + ": " + array, "is missing from the file");
        return set;
    }
};

bool has_hdf5() { return true; }

Hdf5File::Hdf5File(const std::filesystem::path& path) : name_(path.string()) {
    prepare_library();
    rye::detail::regular_file_size(path);
    const hid_t file = H5Fopen(name_.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT);
    require(file >= 0, name_, "is not an HDF5 file, or is damaged");
    handle_ = std::make_unique<Handle>(Handle{file, name_});
}

Hdf5File::~Hdf5File() {
    if (handle_) H5Fclose(handle_->file);
}

bool Hdf5File::has(const std::string& array) const {
    return H5Lexists(handle_->file, array.c_str(), H5P_DEFAULT) > 0;
}

std::vector<Index> Hdf5File::shape(const std::string& array) const {
    const Id set(handle_->open(array), H5Dclose);
    std::vector<Index> shape;
    for (const hsize_t n : handle_->extents(set.id, array)) shape.push_back(static_cast<Index>(n));
    return shape;
}

std::vector<double> Hdf5File::numbers(const std::string& array) const {
    const Id set(handle_->open(array), H5Dclose);
    const std::vector<hsize_t> shape = handle_->extents(set.id, array);
    const std::uint64_t size = checked_size(shape, 8, name_ + ": " + array);
    require_memory(size, memory_limit(), name_ + ": " + array, "the array");
    std::vector<double> values(static_cast<std::size_t>(size / 8));
    require(H5Dread(set.id, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()) >= 0,
            name_ + ": " + array, "cannot be read: it is damaged, or of an unknown compression");
    return values;
}

std::vector<std::uint8_t> Hdf5File::bytes(const std::string& array, Index row) const {
    const std::string who = name_ + ": " + array + ": row " + std::to_string(row);
    const Id set(handle_->open(array), H5Dclose);
    std::vector<hsize_t> shape = handle_->extents(set.id, array);
    require(!shape.empty() && row >= 0 && static_cast<hsize_t>(row) < shape[0], who,
            "is not in the array");
    shape[0] = 1;
    const std::uint64_t size = checked_size(shape, 1, who);
    require_memory(saturated_product(size, 1 + sizeof(std::int32_t)), memory_limit(), who, "it");
    std::vector<hsize_t> start(shape.size(), 0);
    start[0] = static_cast<hsize_t>(row);
    const Id file_space(H5Dget_space(set.id), H5Sclose);
    H5Sselect_hyperslab(file_space.id, H5S_SELECT_SET, start.data(), nullptr, shape.data(),
                        nullptr);
    const Id memory(H5Screate_simple(static_cast<int>(shape.size()), shape.data(), nullptr),
                    H5Sclose);
    std::vector<std::int32_t> values(static_cast<std::size_t>(size));
    require(H5Dread(set.id, H5T_NATIVE_INT32, memory.id, file_space.id, H5P_DEFAULT,
                    values.data()) >= 0,
            who, "cannot be read: it is damaged, or of an unknown compression");
    std::vector<std::uint8_t> out;
    out.reserve(values.size());
    for (const std::int32_t x : values) {
        require(
            x >= 0 && x <= 255, who, "got ", [&] { return std::to_string(x); },
            ", expected 0 to 255");
        out.push_back(static_cast<std::uint8_t>(x));
    }
    return out;
}

#else

struct Hdf5File::Handle {};

bool has_hdf5() { return false; }

Hdf5File::Hdf5File(const std::filesystem::path& path) : name_(path.string()) {
    throw Error(name_ +
                ": this rye was built without HDF5: install libhdf5-dev (Debian), configure "
                "and build again");
}
Hdf5File::~Hdf5File() = default;
bool Hdf5File::has(const std::string&) const { return false; }
std::vector<Index> Hdf5File::shape(const std::string&) const { return {}; }
std::vector<double> Hdf5File::numbers(const std::string&) const { return {}; }
std::vector<std::uint8_t> Hdf5File::bytes(const std::string&, Index) const { return {}; }

#endif

} // namespace rye::trainer
