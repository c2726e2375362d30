// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/lists.hpp: lists of the indices at which numbers are positive, ascending, made
/// on the device by counts, a scan and places, for several arrays at once. The length of a list is
/// known to the device alone.
#pragma once

#include <cstdint>

#include <rye/backend/cuda.hpp>
#include <rye/core/array.hpp>

namespace rye {

namespace detail {

/// Arrays of `size` numbers, at most as many as `most`, and the lists of their positive ones.
struct DeviceListArrays {
    static constexpr int most = 4;
    const float* number[most];
    std::uint32_t* list[most];
    int arrays;
    Index size;
    std::uint32_t* before; ///< [arrays, blocks] listed indices of the block, then before it
    std::uint32_t* count;  ///< [arrays] length of the list
};

/// Counts the listed indices of each block.
struct ListCountKernel {
    static constexpr const char* name = "lists, counts";
    static constexpr int threads = 256, blocks = 4;
    struct Shared {
        std::uint32_t place[threads];
    };
    DeviceListArrays a;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index blocks_all = (a.size + threads - 1) / threads;
        for (int k = 0; k < a.arrays; ++k) {
            block.each_thread([&](int t) {
                const Index i = Index(block.index()) * threads + t;
                shared.place[t] = i < a.size && a.number[k][i] > 0.0F ? 1U : 0U;
            });
            const std::uint32_t all = block.exclusive_sums(shared.place);
            block.each_thread([&](int t) {
                if (t == 0) a.before[k * blocks_all + block.index()] = all;
            });
        }
    }
};

/// Counts the listed indices before each block, and in all; a block does an array.
struct ListScanKernel {
    static constexpr const char* name = "lists, scan";
    static constexpr int threads = 256, blocks = 1;
    struct Shared {
        std::uint32_t place[threads];
    };
    DeviceListArrays a;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index all = (a.size + ListCountKernel::threads - 1) / ListCountKernel::threads;
        std::uint32_t* const own = a.before + block.index() * all;
        std::uint32_t sum = 0;
        for (Index from = 0; from < all; from += threads) {
            block.each_thread(
                [&](int t) { shared.place[t] = from + t < all ? own[from + t] : 0U; });
            const std::uint32_t here = block.exclusive_sums(shared.place);
            block.each_thread([&](int t) {
                if (from + t < all) own[from + t] = sum + shared.place[t];
            });
            sum += here;
        }
        block.each_thread([&](int t) {
            if (t == 0) a.count[block.index()] = sum;
        });
    }
};

/// Puts every index in its place.
struct ListPlaceKernel {
    static constexpr const char* name = "lists, places";
    static constexpr int threads = 256, blocks = 4;
    struct Shared {
        std::uint32_t place[threads];
    };
    DeviceListArrays a;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index blocks_all = (a.size + threads - 1) / threads;
        for (int k = 0; k < a.arrays; ++k) {
            const auto listed = [&](int t) {
                const Index i = Index(block.index()) * threads + t;
                return i < a.size && a.number[k][i] > 0.0F;
            };
            block.each_thread([&](int t) { shared.place[t] = listed(t) ? 1U : 0U; });
            block.exclusive_sums(shared.place);
            block.each_thread([&](int t) {
                if (listed(t))
                    a.list[k][a.before[k * blocks_all + block.index()] + shared.place[t]] =
                        static_cast<std::uint32_t>(Index(block.index()) * threads + t);
            });
        }
    }
};

/// Returns the place of an index in an ascending list of `count`; `count` where the list does not
/// have it.
RYE_HD inline std::uint32_t place_in_list(const std::uint32_t* list, std::uint32_t count,
                                          std::uint32_t index) {
    std::uint32_t begin = 0, end = count;
    while (begin < end) {
        const std::uint32_t middle = begin + (end - begin) / 2;
        if (list[middle] < index)
            begin = middle + 1;
        else
            end = middle;
    }
    return begin < count && list[begin] == index ? begin : count;
}

} // namespace detail

/// Lists on a device, with the memory that they are in.
template <class Device>
class DeviceLists {
  public:
    explicit DeviceLists(const Device& device) : device_(device) {}

    /// Makes the lists of `arrays` arrays of `size` numbers, on the stream.
    void make(const CudaQueue& queue,
              const Array<const float*, detail::DeviceListArrays::most>& number, int arrays,
              Index size) {
        const Index blocks =
            (size + detail::ListCountKernel::threads - 1) / detail::ListCountKernel::threads;
        lists_.reserve(queue,
                       static_cast<std::size_t>(arrays) * static_cast<std::size_t>(size) + 1);
        before_.reserve(queue, static_cast<std::size_t>(arrays * (blocks + 1)) + 1);
        arrays_ = {};
        arrays_.arrays = arrays;
        arrays_.size = size;
        arrays_.before = before_.data();
        arrays_.count = before_.data() + arrays * blocks;
        for (int k = 0; k < arrays; ++k) {
            arrays_.number[k] = number[std::size_t(k)];
            arrays_.list[k] = lists_.data() + k * size;
        }
        device_.launch(queue, blocks, detail::ListCountKernel{arrays_});
        device_.launch(queue, arrays, detail::ListScanKernel{arrays_});
        device_.launch(queue, blocks, detail::ListPlaceKernel{arrays_});
    }

    /// Returns array k's list, or the place of its length, both in device memory.
    const std::uint32_t* list(int k) const { return arrays_.list[k]; }
    const std::uint32_t* count(int k) const { return arrays_.count + k; }
    /// Copies the length of each list. Waits.
    void fetch_counts(const CudaQueue& queue, std::uint32_t* to) const {
        device_.fetch(queue, to, arrays_.count,
                      static_cast<std::size_t>(arrays_.arrays) * sizeof(std::uint32_t));
    }
    std::size_t bytes() const { return lists_.bytes() + before_.bytes(); }

  private:
    Device device_;
    detail::DeviceListArrays arrays_{};
    DeviceBuffer<std::uint32_t> lists_, before_;
};

} // namespace rye
