// SPDX-License-Identifier: Apache-2.0
/// importers/hdf5_file.hpp: arrays of numbers in an HDF5 file, by libhdf5, with h5py's filter LZF.
/// In a build without libhdf5, opening a file is an Error that states how to get it.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <rye/core/columns.hpp>

namespace rye::trainer {

/// Returns true if rye was built with libhdf5.
bool has_hdf5();

/// Open file. Not for concurrent use. Errors name file and array.
class Hdf5File {
  public:
    explicit Hdf5File(const std::filesystem::path& path);
    ~Hdf5File();
    Hdf5File(const Hdf5File&) = delete;
    Hdf5File& operator=(const Hdf5File&) = delete;

    bool has(const std::string& name) const;
    /// Returns the extents of an array.
    std::vector<Index> shape(const std::string& name) const;
    /// Returns the whole array, of any type of number, in C order.
    std::vector<double> numbers(const std::string& name) const;
    /// Returns one entry of the first extent, as bytes; throws an Error for values beyond 0 to 255.
    std::vector<std::uint8_t> bytes(const std::string& name, Index row) const;
    const std::string& name() const { return name_; }

  private:
    struct Handle;
    std::string name_;
    std::unique_ptr<Handle> handle_;
};

/// Decompresses LZF (LibLZF's format); throws an Error that begins with `who` unless the result has
/// exactly `size` bytes.
std::vector<std::uint8_t> decode_lzf(const std::uint8_t* data, std::size_t count, std::size_t size,
                                     const std::string& who);

} // namespace rye::trainer
