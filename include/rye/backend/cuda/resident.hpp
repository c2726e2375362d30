// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/resident.hpp: the arrays of a parameter struct in one piece of device memory,
/// found by the struct's own arrays: where a function of the host takes `avatar.face.position`,
/// one of the device takes `resident.of(avatar.face.position)`.
#pragma once

#include <string>
#include <vector>

#include <rye/backend/cuda.hpp>
#include <rye/core/fields.hpp>

namespace rye {

/// The arrays of a struct of parameters in device memory. The struct must not move: its arrays are
/// found by their addresses.
template <class P>
class ResidentLayout {
  public:
    struct Slice {
        std::string name;
        const void* array; ///< array of the host's struct
        Index offset, rows, cols;

        Index size() const { return rows * cols; }
    };

    explicit ResidentLayout(const P& host) {
        P::fields(
            [&](const std::string& name, const auto& a) {
                slices_.push_back({name, &a, size_, a.rows(), a.cols()});
                size_ += (a.size() + 3) / 4 * 4; // slices begin at whole vectors
            },
            host);
    }

    const std::vector<Slice>& slices() const { return slices_; }
    Index size() const { return size_; } ///< numbers, with what lies between slices
    const Slice& of(const Columns<float>& array) const {
        for (const Slice& s : slices_)
            if (s.array == &array) return s;
        throw Error("Resident: the array is not one of the struct's " +
                    std::to_string(slices_.size()));
    }

  private:
    std::vector<Slice> slices_;
    Index size_ = 0;
};

/// Parameters, gradients or moments of one layout.
template <class P, class Device>
class Resident {
  public:
    /// Allocates zeros.
    Resident(const Device& device, const CudaQueue& queue, const ResidentLayout<P>& layout)
        : device_(device),
          layout_(&layout) {
        buffer_.reserve(queue, static_cast<std::size_t>(layout.size()) + 4);
        clear(queue);
    }
    Resident(const Device&, const CudaQueue&, const ResidentLayout<P>&&) = delete;

    const ResidentLayout<P>& layout() const { return *layout_; }
    float* data() const { return buffer_.data(); }
    std::size_t bytes() const { return buffer_.bytes(); }

    /// Returns the slice of an array of the struct that the layout was made of.
    DeviceColumns<float> of(const Columns<float>& array) const {
        const auto& s = layout_->of(array);
        return {buffer_.data() + s.offset, s.rows, s.cols};
    }

    void clear(const CudaQueue& queue) { device_.fill(queue, buffer_.data(), 0, buffer_.bytes()); }
    /// Copies from a struct of the same shapes; waits.
    void send(const CudaQueue& queue, const P& host) {
        std::size_t at = 0;
        P::fields(
            [&](const std::string& name, const auto& a) {
                const auto& s = slice(at++, name);
                same(s, name, a);
                device_.send(queue, buffer_.data() + s.offset, a.data(),
                             static_cast<std::size_t>(a.size()) * sizeof(float));
            },
            host);
        all(at);
    }
    /// Copies into a struct of the same shapes; waits.
    void fetch(const CudaQueue& queue, P& host) const {
        std::size_t at = 0;
        P::fields(
            [&](const std::string& name, auto& a) {
                const auto& s = slice(at++, name);
                same(s, name, a);
                device_.fetch(queue, a.data(), buffer_.data() + s.offset,
                              static_cast<std::size_t>(a.size()) * sizeof(float));
            },
            host);
        all(at);
    }

  private:
    void all(std::size_t fields) const {
        require(fields == layout_->slices().size(), "Resident", "the struct has ", fields,
                " fields, the layout ", layout_->slices().size());
    }
    /// Slice number `at`. Throws an Error unless it is of that name: a struct may have fields that
    /// the layout's had not.
    const typename ResidentLayout<P>::Slice& slice(std::size_t at, const std::string& name) const {
        const auto& all = layout_->slices();
        require(at < all.size() && all[at].name == name, "Resident", name,
                " is not the layout's field number ", at);
        return all[at];
    }
    static void same(const typename ResidentLayout<P>::Slice& s, const std::string& name,
                     const Columns<float>& a) {
        require(a.rows() == s.rows && a.cols() == s.cols, "Resident", name, " is ", a.rows(), " x ",
                a.cols(), ", the layout has ", s.rows, " x ", s.cols);
    }

    Device device_;
    const ResidentLayout<P>* layout_;
    DeviceBuffer<float> buffer_;
};

} // namespace rye
