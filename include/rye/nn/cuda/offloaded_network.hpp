// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/offloaded_network.hpp: a network of the host whose passes run on a device: its
/// parameters there, what vjps of its last passes read, and the way of arrays there and back.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include <rye/backend/cuda/each.hpp>
#include <rye/core/parallel.hpp>
#include <rye/nn/cuda/encoding.hpp>
#include <rye/nn/cuda/mlp.hpp>

namespace rye {

namespace detail {

/// Arrays of the host on their way to a device and back, through memory of the host that the
/// device copies from at full speed (page-locked, where the arena gives such memory).
template <class Device>
class HostTransfer {
  public:
    /// `staging`: memory of the host, of any type that is DeviceMemory.
    HostTransfer(const Device& device_, const CudaQueue& queue_, const DeviceArena& staging)
        : device(device_),
          queue(queue_),
          staging_{queue_.stream, staging} {}

    const Device device;
    const CudaQueue queue;
    std::uint64_t sent = 0, fetched = 0; ///< bytes so far

    /// Device memory that the networks of one transfer share while a pass runs.
    DeviceBuffer<float> points, codes, outputs, row;
    DeviceMlpScratch scratch;

    /// Sends what write(p) puts into n numbers at p; goes on beside the copy.
    template <class F>
    void send(Index n, float* to, const F& write) {
        if (n == 0) return;
        float* const at = stage(n);
        write(at);
        device.send_later(queue, to, at, bytes(n));
        sent += bytes(n);
    }
    /// Sends columns.
    template <Threads P>
    void send(const P& threads, const ColumnsView<float>& x, float* to) {
        send(x.size(), to, [&](float* at) {
            each_columns(threads, x.rows(), x.cols(), [&](Index b, Index n) {
                Eigen::Map<Columns<float>>(at + b * x.rows(), x.rows(), n) = x.middleCols(b, n);
            });
        });
    }
    /// Fetches n numbers; waits. Returns where they lie until the next call.
    const float* fetch(const float* from, Index n) {
        float* const at = stage(n);
        device.fetch(queue, at, from, bytes(n)); // behind all that was sent
        fetched += bytes(n);
        used_ = 0;
        return at;
    }
    /// Copies what was fetched into columns, whose shape it has.
    template <Threads P>
    static void copy(const P& threads, const float* from, Columns<float>& x) {
        each_columns(threads, x.rows(), x.cols(), [&](Index b, Index n) {
            x.middleCols(b, n) =
                Eigen::Map<const Columns<float>>(from + b * x.rows(), x.rows(), n);
        });
    }

  private:
    static std::size_t bytes(Index n) { return static_cast<std::size_t>(n) * sizeof(float); }
    /// Room for n numbers that no copy under way reads.
    float* stage(Index n) {
        const std::size_t most = used_ + static_cast<std::size_t>(n);
        if (most > room_.size()) {
            if (used_ > 0) device.fetch(queue, room_.data(), room_.data(), 0); // waits
            used_ = 0;
            room_.reserve(staging_, 2 * most);
        }
        float* const at = room_.data() + used_;
        used_ += static_cast<std::size_t>(n);
        return at;
    }
    /// f(first, count) for pieces of about 64 KiB.
    template <Threads P, class F>
    static void each_columns(const P& threads, Index rows, Index cols, const F& f) {
        const Index piece = std::max<Index>(1, 16384 / std::max<Index>(rows, 1));
        for_chunks(threads, cols, piece, [&](Index b, Index e, Index) { f(b, e - b); });
    }

    CudaQueue staging_;
    DeviceBuffer<float> room_;
    std::size_t used_ = 0; ///< numbers of it that copies under way may read
};

} // namespace detail

/// The number of a pass that ran on a device, in the trace that a host's pass would fill: one array
/// without rows, with that many columns. Numbers begin with 1; 0: the trace is of a host's pass.
inline Index offloaded_pass(const MlpTrace<float>& trace) {
    return trace.hidden.size() == 1 && trace.hidden[0].rows() == 0 ? trace.hidden[0].cols() : 0;
}

namespace detail {

/// A network of any activation.
class OffloadedPasses {
  public:
    virtual ~OffloadedPasses() = default;
    virtual bool has(Index pass) const = 0;
};

/// The number of an array's column-wise first row, of codes or outputs.
struct PickFirstRow {
    static constexpr const char* name = "first row";
    const float* from;
    Index rows;
    float* to;
    RYE_DEVICE void operator()(Index i) const { to[i] = from[i * rows]; }
};

/// A network's parameters in device memory, as of its last pass, and its last passes.
template <class Device, class Tiles, Activation A>
class OffloadedNetwork : public OffloadedPasses {
  public:
    using Transfer = HostTransfer<Device>;
    using Network = Mlp<float, A>;
    static constexpr int most_kept = 2;    ///< passes whose vjps can be asked for
    static constexpr Index block = 131072; ///< points whose codes lie in memory at once

    OffloadedNetwork(Transfer& transfer, const MlpShape& shape)
        : transfer_(transfer),
          sent_(shape),
          kept_{{transfer, shape}, {transfer, shape}},
          loose_(transfer, shape) {}

    bool has(Index number) const override {
        return std::any_of(kept_, kept_ + most_kept,
                           [&](const Pass& p) { return p.number == number; });
    }

    /// Returns true if networks of that shape have their passes here.
    bool is(const MlpShape& s) const {
        const MlpShape& own = sent_.shape;
        return s.dims == own.dims && s.frame_inputs == own.frame_inputs && s.skip() == own.skip();
    }

    /// Does what mlp_forward does; a trace is given the number `number`, and takes the place of the
    /// pass that it had, or else of the oldest.
    template <Threads P>
    Columns<float> forward(const P& threads, const Network& m, const ColumnsView<float>& points,
                           const VecX<float>& frame, MlpTrace<float>* trace, Index number) {
        Pass& pass = trace != nullptr ? place_of(offloaded_pass(*trace)) : loose_;
        prepare(threads, pass, m, frame);
        const Index n = points.cols();
        const DeviceColumns<float> in = room(transfer_.points, points.rows(), n),
                                   out = room(transfer_.outputs, m.shape.outputs(), n);
        transfer_.send(threads, points, in.data);
        pass.mlp.forward_into(transfer_.queue, in, out, trace != nullptr);
        Columns<float> y(out.rows, out.cols);
        Transfer::copy(threads, transfer_.fetch(out.data, y.size()), y);
        if (trace != nullptr) {
            pass.number = number;
            trace->hidden.assign(1, Columns<float>(0, number));
        }
        return y;
    }

    /// The first output at points (D x N, on the host) whose codes are made on the device, 1 x N.
    template <Threads P>
    Columns<float> first_output(const P& threads, const Network& m,
                                const ColumnsView<float>& points, int frequencies) {
        prepare(threads, loose_, m, VecX<float>());
        const CudaQueue& queue = transfer_.queue;
        const Index n = points.cols(), rows = points.rows(), outputs = m.shape.outputs();
        float* const x = room(transfer_.points, rows, n).data;
        float* const y = room(transfer_.row, 1, n).data;
        transfer_.send(threads, points, x);
        for (Index b = 0; b < n; b += block) {
            const Index count = std::min(block, n - b);
            const DeviceColumns<float> code =
                room(transfer_.codes, encoded_size(rows, frequencies), count);
            const DeviceColumns<float> out = room(transfer_.outputs, outputs, count);
            launch_each(transfer_.device, queue, rows * count,
                        EncodeNumber{x + b * rows, static_cast<std::uint32_t>(rows), frequencies,
                                     code.data});
            loose_.mlp.forward_into(queue, code, out, false);
            launch_each(transfer_.device, queue, count, PickFirstRow{out.data, outputs, y + b});
        }
        Columns<float> first(1, n);
        Transfer::copy(threads, transfer_.fetch(y, n), first);
        return first;
    }

    /// Does what mlp_vjp does, for the pass of that number. Throws an Error if the network has had
    /// more passes since then than are kept, or its parameters have changed.
    template <Threads P>
    void vjp(const P& threads, const Network& m, Index number, const ColumnsView<float>& g_out,
             const MlpGradient<float, A>& g) {
        Pass& pass = *std::find_if(kept_, kept_ + most_kept,
                                   [&](const Pass& p) { return p.number == number; });
        require(pass.parameters == version_ && same(m), "mlp_vjp on a device",
                "the network's parameters are others than in the pass of this trace, expected the "
                "same until its vjp");
        const CudaQueue& queue = transfer_.queue;
        const MlpShape& s = m.shape;
        const Index n = g_out.cols(), p = s.point_inputs();
        const DeviceColumns<float> cotangent = room(transfer_.outputs, s.outputs(), n);
        transfer_.send(threads, g_out, cotangent.data);
        const auto numbers = static_cast<Index>(size()),
                   of_points = g.points != nullptr ? p * n : 0;
        gradient_.reserve(queue, static_cast<std::size_t>(numbers + of_points) + 4);
        transfer_.device.fill(queue, gradient_.data(), 0, size() * sizeof(float));
        const DeviceColumns<float> to_points{gradient_.data() + numbers, p, n};
        float* const to_frame = to_points.data - padded(s.frame_inputs);
        pass.mlp.vjp_into(
            queue, cotangent,
            {views(gradient_.data()), g.points != nullptr ? to_points : DeviceColumns<float>{},
             g.frame != nullptr && s.frame_inputs > 0 ? to_frame : nullptr});
        const float* at = transfer_.fetch(gradient_.data(), numbers + of_points);
        if (g.points != nullptr) {
            g.points->resize(p, n);
            Transfer::copy(threads, at + numbers, *g.points);
        }
        Network::fields(
            [&](const std::string&, Columns<float>& a) {
                a += Eigen::Map<const Columns<float>>(at, a.rows(), a.cols());
                at += padded(a.size());
            },
            g.params);
        if (g.frame != nullptr) *g.frame = Eigen::Map<const VecX<float>>(at, s.frame_inputs);
    }

    /// Device memory that is held, without what networks share [bytes].
    std::size_t bytes() const {
        std::size_t all = parameters_.bytes() + gradient_.bytes() + loose_.mlp.bytes();
        for (const Pass& p : kept_) all += p.mlp.bytes() + p.frame.bytes();
        return all;
    }

  private:
    using DeviceNetwork = DeviceMlp<Device, Tiles, A>;

    struct Pass {
        Pass(Transfer& transfer, const MlpShape& shape) : mlp(transfer.device, shape) {
            mlp.share(transfer.scratch);
        }
        DeviceNetwork mlp;
        DeviceBuffer<float> frame;
        std::uint64_t parameters = 0; ///< version that it has
        Index number = 0;
    };

    static Index padded(Index n) { return (n + 3) / 4 * 4; } ///< arrays begin at whole vectors
    DeviceColumns<float> room(DeviceBuffer<float>& buffer, Index rows, Index cols) const {
        buffer.reserve(transfer_.queue, static_cast<std::size_t>(rows * cols) + 4);
        return {buffer.data(), rows, cols};
    }
    /// Numbers of all arrays, and of the frame inputs behind them.
    std::size_t size() const {
        Index all = padded(sent_.shape.frame_inputs);
        Network::fields([&](const std::string&, const auto& a) { all += padded(a.size()); }, sent_);
        return static_cast<std::size_t>(all);
    }
    DeviceMlpParameters views(float* at) const {
        return device_parameters(sent_, [&](const Columns<float>& a) {
            // Asked for in the order of the layers, weights first, as fields() has them.
            const DeviceColumns<float> view{at, a.rows(), a.cols()};
            at += padded(a.size());
            return view;
        });
    }
    bool same(const Network& m) const {
        bool equal = true;
        Network::fields(
            [&](const std::string&, const Columns<float>& a, const Columns<float>& b) {
                equal = equal && a.size() == b.size() &&
                        std::memcmp(a.data(), b.data(),
                                    static_cast<std::size_t>(a.size()) * sizeof(float)) == 0;
            },
            m, sent_);
        return equal;
    }
    Pass& place_of(Index number) {
        Pass* const same = std::find_if(kept_, kept_ + most_kept, [&](const Pass& p) {
            return number != 0 && p.number == number;
        });
        if (same != kept_ + most_kept) return *same;
        return *std::min_element(kept_, kept_ + most_kept,
                                 [](const Pass& a, const Pass& b) { return a.number < b.number; });
    }
    /// Parameters, where they have changed, and frame inputs.
    template <Threads P>
    void prepare(const P& threads, Pass& pass, const Network& m, const VecX<float>& frame) {
        const CudaQueue& queue = transfer_.queue;
        pass.number = 0; // until it has passed
        if (!whole_ || !same(m)) {
            whole_ = false;
            sent_ = m;
            ++version_;
            parameters_.reserve(queue, size() + 4);
            const auto numbers = static_cast<Index>(size());
            transfer_.send(numbers, parameters_.data(), [&](float* at) {
                std::fill_n(at, numbers, 0.0F);
                Network::fields(
                    [&](const std::string&, const Columns<float>& a) {
                        std::copy_n(a.data(), a.size(), at);
                        at += padded(a.size());
                    },
                    m);
            });
            whole_ = true;
        }
        const float* values = nullptr;
        if (frame.size() > 0) {
            pass.frame.reserve(queue, static_cast<std::size_t>(frame.size()));
            transfer_.send(threads, frame, pass.frame.data());
            values = pass.frame.data();
        }
        if (pass.parameters == version_) {
            pass.mlp.set_frame(queue, values);
        } else {
            pass.mlp.set(queue, views(parameters_.data()), values);
            pass.parameters = version_;
        }
    }

    Transfer& transfer_;
    Network sent_;              ///< the parameters of version_
    std::uint64_t version_ = 0; ///< 0: none were sent
    bool whole_ = false;        ///< true if all of that version were sent
    DeviceBuffer<float> parameters_, gradient_;
    Pass kept_[most_kept];
    Pass loose_; ///< pass without a trace
};

} // namespace detail

} // namespace rye
