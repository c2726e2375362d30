// SPDX-License-Identifier: Apache-2.0
/// rye/loss/cuda/terms.hpp: parts shared by the losses of pictures in device memory: partial sums
/// in double, and the report of an objective: the values of its terms, their weighted total, and
/// the first term that is not finite. The report stays on the device until it is fetched.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <rye/backend/cuda/picture.hpp>
#include <rye/backend/cuda/sums.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

/// Term of an objective, of value offset + factor (sum of `chunks` partial sums).
struct DeviceLossTerm {
    const double* partial = nullptr;
    Index chunks = 0;
    double factor = 0, offset = 0;
    double weight = 0; ///< in the objective
};

/// Memory of one term's partial sums.
class LossSums {
  public:
    double* reserve(const CudaQueue& queue, Index chunks) {
        partial_.reserve(queue, static_cast<std::size_t>(chunks) + 1);
        return partial_.data();
    }
    std::size_t bytes() const { return partial_.bytes(); }

  private:
    DeviceBuffer<double> partial_;
};

/// Values of up to 12 terms and their weighted total.
struct LossReport {
    static constexpr int most = 12;
    float value[most] = {};
    float total = 0;
    std::int32_t bad = -1; ///< index of the first term that is not finite, or -1

    bool finite() const { return bad < 0; }
};

/// Kernel that adds up the terms' partial sums in a fixed order.
struct LossReportKernel {
    static constexpr const char* name = "report of losses";
    static constexpr int threads = 256, blocks = 1;
    struct Shared {
        double sum[threads];
        double total;
        int bad;
    };
    DeviceLossTerm term[LossReport::most];
    int count;
    LossReport* report;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        block.each_thread([&](int t) {
            if (t == 0) shared.total = 0, shared.bad = -1;
        });
        for (int k = 0; k < count; ++k) {
            const DeviceLossTerm& own = term[k];
            block.each_thread([&](int t) {
                const Index share = (own.chunks + threads - 1) / threads;
                const Index end = rye::min(own.chunks, (t + 1) * share);
                double sum = 0;
                for (Index i = t * share; i < end; ++i) sum += own.partial[i];
                shared.sum[t] = sum;
            });
            add_up(block, shared.sum);
            block.each_thread([&](int t) {
                if (t != 0) return;
                const double value = own.offset + own.factor * shared.sum[0];
                report->value[k] = static_cast<float>(value);
                shared.total += own.weight * value;
                if (!(value * 0 == 0) && shared.bad < 0) shared.bad = k; // 0 x is 0 if x is finite
            });
        }
        block.each_thread([&](int t) {
            if (t != 0) return;
            for (int k = count; k < LossReport::most; ++k) report->value[k] = 0;
            report->total = static_cast<float>(shared.total);
            report->bad = shared.bad;
        });
    }
};

/// Report of an objective in device memory.
template <class Device>
class DeviceLossReport {
  public:
    explicit DeviceLossReport(const Device& device) : device_(device) {}

    /// Enqueues the sums of the terms. Throws an Error for more than LossReport::most terms.
    void sum_into(const CudaQueue& queue, const std::vector<DeviceLossTerm>& terms) {
        require(terms.size() <= std::size_t(LossReport::most), "DeviceLossReport", "got ",
                terms.size(), " terms, ", LossReport::most, " are the most");
        report_.reserve(queue, 1);
        LossReportKernel kernel{{}, static_cast<int>(terms.size()), report_.data()};
        for (std::size_t k = 0; k < terms.size(); ++k) kernel.term[k] = terms[k];
        device_.launch(queue, 1, kernel);
    }
    /// Returns the latest report; waits. Throws an Error if there is none.
    LossReport fetch(const CudaQueue& queue) const {
        LossReport r;
        require(report_.data() != nullptr, "DeviceLossReport", "nothing was summed yet");
        device_.fetch(queue, &r, report_.data(), sizeof r);
        return r;
    }
    /// Returns the report in device memory, for kernels that read it; null before the first
    /// sum_into.
    const LossReport* data() const { return report_.data(); }
    std::size_t bytes() const { return report_.bytes(); }

  private:
    Device device_;
    DeviceBuffer<LossReport> report_;
};

} // namespace rye
