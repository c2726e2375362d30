// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/offload.hpp: a backend of the host whose networks run on a device where they pass
/// many points; all else, and small passes, are the host's.
///     NetworkOffload<CudaDevice> networks(CudaDevice(), queue, staging);
///     const OffloadBackend backend{XsimdBackend{}, networks};
///     mlp_forward(backend, mlp, points, frame, &trace);    // and mlp_vjp: arrays of the host
/// After this header functions that take a backend find the networks of an OffloadBackend by
/// overload; nothing changes for others. One thread at a time.
#pragma once

#include <concepts>
#include <map>
#include <memory>

#include <rye/nn/cuda/offloaded_network.hpp>

namespace rye {

/// Passes so far, of networks that a NetworkOffload was asked for.
struct OffloadCounts {
    std::uint64_t forward = 0, vjp = 0;           ///< on the device
    std::uint64_t host_forward = 0, host_vjp = 0; ///< on the host
    std::uint64_t sent = 0, fetched = 0;          ///< bytes
};

/// Networks of the host on a device. They are told apart by where they lie in memory; parameters
/// are compared with what was sent, and sent where they differ.
template <class Device_, class Tiles_ = MlpTiles<1, 256, 128>>
class NetworkOffload {
  public:
    using Device = Device_;
    using Tiles = Tiles_;

    Index least_points = 192; ///< passes of fewer are the host's; at least 1

    /// `staging` is memory of the host that copies run through: page-locked, or they are slow.
    NetworkOffload(const Device& device, const CudaQueue& queue, const DeviceArena& staging)
        : transfer_(device, queue, staging) {}
    NetworkOffload(const NetworkOffload&) = delete;
    NetworkOffload& operator=(const NetworkOffload&) = delete;

    /// Returns true if a pass of so many points runs on the device: there are enough, and the
    /// network fits the tiles.
    bool takes(const MlpShape& s, Index points) const {
        constexpr int widest = std::max(Tiles::width, Tiles::inputs);
        return DeviceMlp<Device, Tiles>::fits(s) && s.point_inputs() > 0 &&
               points >= std::max<Index>(least_points, 1) &&
               static_cast<std::uint64_t>(points) * static_cast<std::uint64_t>(widest) <
                   std::uint64_t(1) << 32U;
    }

    /// See mlp_forward.
    template <class A, Threads P>
    Columns<float> forward(const P& threads, const Mlp<float, A>& m,
                           const ColumnsView<float>& points, const VecX<float>& frame,
                           MlpTrace<float>* trace) {
        ++counts_.forward;
        return network(m).forward(threads, m, points, frame, trace, trace ? ++passes_ : 0);
    }
    /// The first output at points (D x N) whose positional codes are the inputs, 1 x N.
    template <class A, Threads P>
    Columns<float> first_output(const P& threads, const Mlp<float, A>& m,
                                const ColumnsView<float>& points, int frequencies) {
        ++counts_.forward;
        return network(m).first_output(threads, m, points, frequencies);
    }
    /// See mlp_vjp. Error if what the pass kept was overwritten by later ones, or the parameters
    /// have changed since then.
    template <class A, Threads P>
    void vjp(const P& threads, const Mlp<float, A>& m, Index pass, const ColumnsView<float>& g_out,
             const MlpGradient<float, A>& g) {
        ++counts_.vjp;
        for (const auto& [place, passes] : networks_)
            if (passes->has(pass))
                if (auto* const found = dynamic_cast<Network<A>*>(passes.get()))
                    return found->vjp(threads, m, pass, g_out, g);
        throw Error("mlp_vjp on a device: pass " + std::to_string(pass) +
                    " is not kept, expected one of the last " +
                    std::to_string(Network<A>::most_kept) + " of its network");
    }

    void count_host_forward() { ++counts_.host_forward; }
    void count_host_vjp() { ++counts_.host_vjp; }
    OffloadCounts counts() const {
        OffloadCounts c = counts_;
        c.sent = transfer_.sent;
        c.fetched = transfer_.fetched;
        return c;
    }

    /// Gives back all that is kept of networks.
    void clear() { networks_.clear(); }

  private:
    template <class A>
    using Network = detail::OffloadedNetwork<Device, Tiles, A>;

    template <class A>
    Network<A>& network(const Mlp<float, A>& m) {
        std::unique_ptr<detail::OffloadedPasses>& place = networks_[&m];
        auto* found = dynamic_cast<Network<A>*>(place.get());
        if (found == nullptr || !found->is(m.shape)) {
            auto made = std::make_unique<Network<A>>(transfer_, m.shape);
            found = made.get();
            place = std::move(made);
        }
        return *found;
    }

    detail::HostTransfer<Device> transfer_;
    std::map<const void*, std::unique_ptr<detail::OffloadedPasses>> networks_;
    OffloadCounts counts_;
    Index passes_ = 0;
};

/// The host's backend, with its networks' passes on a device.
template <Backend Host, class Networks>
struct OffloadBackend : Host {
    Networks* networks; ///< shared by copies

    OffloadBackend(const Host& host, Networks& n) : Host(host), networks(&n) {}
    const Host& host() const { return *this; }
};

/// An OffloadBackend.
template <class B>
concept OffloadsNetworks = Backend<B> && requires(const B& b, const MlpShape& shape) {
    { b.host() } -> Backend;
    { b.networks->takes(shape, Index(1)) } -> std::convertible_to<bool>;
};

/// Its host on the calling thread: passes of one network that are side by side cannot all be kept.
template <OffloadsNetworks B>
auto one_thread(const B& backend) {
    return one_thread(backend.host());
}

/// mlp_forward of an OffloadBackend. A trace of a pass on the device holds its number alone, and a
/// device keeps what the vjps of a network's last two traced passes read.
template <class T, class A, OffloadsNetworks B>
Columns<T> mlp_forward(const B& backend, const Mlp<T, A>& m,
                       const std::type_identity_t<ColumnsView<T>>& points,
                       const std::type_identity_t<VecX<T>>& frame,
                       std::type_identity_t<MlpTrace<T>>* trace) {
    if constexpr (std::same_as<T, float>) {
        RYE_ASSERT(points.rows() == m.shape.point_inputs(), "mlp_forward: points have other rows");
        RYE_ASSERT(frame.size() == m.shape.frame_inputs, "mlp_forward: frame has another size");
        if (backend.networks->takes(m.shape, points.cols()))
            return backend.networks->forward(backend.threads, m, points, frame, trace);
    }
    backend.networks->count_host_forward();
    return mlp_forward<T>(backend.host(), m, points, frame, trace);
}

/// mlp_vjp of an OffloadBackend, where the pass of its trace was.
template <class T, class A, OffloadsNetworks B>
void mlp_vjp(const B& backend, const Mlp<T, A>& m, const std::type_identity_t<MlpPass<T>>& pass,
             const std::type_identity_t<ColumnsView<T>>& g_out,
             const std::type_identity_t<MlpGradient<T, A>>& g) {
    if constexpr (std::same_as<T, float>) {
        if (const Index number = offloaded_pass(pass.trace); number != 0)
            return backend.networks->vjp(backend.threads, m, number, g_out, g);
    }
    backend.networks->count_host_vjp();
    mlp_vjp<T>(backend.host(), m, pass, g_out, g);
}

/// mlp_forward_around of an OffloadBackend: what is around the pass is done on the host.
template <class T, class A, OffloadsNetworks B, class Before, class After>
void mlp_forward_around(const B& backend, const Mlp<T, A>& m,
                        const std::type_identity_t<ColumnsView<T>>& points,
                        const std::type_identity_t<VecX<T>>& frame,
                        std::type_identity_t<MlpTrace<T>>* trace, Columns<T>& y,
                        const Before& before, const After& after) {
    const auto around = [&](const auto& f) {
        for_chunks(backend.threads, points.cols(), 768, [&](Index b, Index e, Index) { f(b, e); });
    };
    around(before);
    y = mlp_forward<T>(backend, m, points, frame, trace);
    around(after);
}

/// mlp_vjp_around of an OffloadBackend: what is around the pass is done on the host.
template <class T, class A, OffloadsNetworks B, class Before, class After>
void mlp_vjp_around(const B& backend, const Mlp<T, A>& m,
                    const std::type_identity_t<MlpPass<T>>& pass,
                    const std::type_identity_t<ColumnsView<T>>& g_out,
                    const std::type_identity_t<MlpGradient<T, A>>& g, const Before& before,
                    const After& after) {
    const auto around = [&](const auto& f) {
        for_chunks(backend.threads, g_out.cols(), 768, [&](Index b, Index e, Index) { f(b, e); });
    };
    around(before);
    mlp_vjp<T>(backend, m, pass, g_out, g);
    around(after);
}

} // namespace rye
