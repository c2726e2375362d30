// SPDX-License-Identifier: Apache-2.0
/// device/parts.hpp: the parts of model/chosen_parts.hpp on a device, with kernels and
/// memory of the part that an avatar's parameters hold.
#pragma once

#include <memory>
#include <variant>

#include <rye/avatar/cuda/eye_parts.hpp>

#include "model/effects.hpp"

namespace rye {

template <GazeMechanism... M>
inline constexpr bool part_has_kernels<trainer::OneMechanism<M...>> = (part_has_kernels<M> && ...);
template <EyeAppearance... A>
inline constexpr bool part_has_kernels<trainer::OneAppearance<A...>> = (part_has_kernels<A> && ...);

/// Mechanism held at construction; functions as FixedEye's.
template <GazeMechanism... M, class Device>
class DeviceGazeMechanism<trainer::OneMechanism<M...>, Device> {
  public:
    using Parameters = typename trainer::OneMechanism<M...>::template Parameters<float>;
    DeviceGazeMechanism(const Device& device, const Parameters& host) {
        Parameters::visit(host, [&]<std::size_t k>() {
            using Own = std::tuple_element_t<k, std::tuple<DeviceGazeMechanism<M, Device>...>>;
            held_.template emplace<k>(std::make_unique<Own>(device, std::get<k>(host.held)));
        });
    }
    template <class Of>
    void set(const CudaQueue& queue, const Of& of) {
        std::visit([&](auto& m) { m->set(queue, of); }, held_);
    }
    void turn_into(const CudaQueue& queue, const DeviceEyeFrame& frame) {
        std::visit([&](auto& m) { m->turn_into(queue, frame); }, held_);
    }
    const float* turns() const {
        return std::visit([](const auto& m) { return m->turns(); }, held_);
    }
    template <class To>
    void vjp_into(const CudaQueue& queue, const To& to, const DeviceEyeFrame& frame,
                  const DeviceTurnSums& sums) {
        std::visit([&](auto& m) { m->vjp_into(queue, to, frame, sums); }, held_);
    }
    std::size_t bytes() const {
        return std::visit([](const auto& m) { return m->bytes(); }, held_);
    }

  private:
    std::variant<std::unique_ptr<DeviceGazeMechanism<M, Device>>...> held_;
};

/// Appearance held at construction; functions as FreeFeatures'.
template <EyeAppearance... A, class Device, class Networks>
class DeviceEyeAppearance<trainer::OneAppearance<A...>, Device, Networks> {
  public:
    using Parameters = typename trainer::OneAppearance<A...>::template Parameters<float>;
    DeviceEyeAppearance(const Device& device, const Parameters& host, DeviceMlpScratch& scratch) {
        Parameters::visit(host, [&]<std::size_t k>() {
            using Own =
                std::tuple_element_t<k, std::tuple<DeviceEyeAppearance<A, Device, Networks>...>>;
            held_.template emplace<k>(
                std::make_unique<Own>(device, std::get<k>(host.held), scratch));
        });
    }
    void set_fixed(const CudaQueue& queue, const EyeballPoints& points) {
        std::visit([&](auto& a) { a->set_fixed(queue, points); }, held_);
    }
    template <class Of>
    void set(const CudaQueue& queue, const Of& of, const DeviceEyeFrame& frame) {
        std::visit([&](auto& a) { a->set(queue, of, frame); }, held_);
    }
    template <class Of>
    void set_frame(const CudaQueue& queue, const Of& of, const DeviceEyeFrame& frame) {
        std::visit([&](auto& a) { a->set_frame(queue, of, frame); }, held_);
    }
    template <class Of>
    void features_into(const CudaQueue& queue, const Of& of, const DeviceEyeFrame& frame,
                       const DeviceColumns<float>& feature, bool keep) {
        std::visit([&](auto& a) { a->features_into(queue, of, frame, feature, keep); }, held_);
    }
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of& of, const To& to, const DeviceEyeFrame& frame,
                  const DeviceColumns<float>& g) {
        std::visit([&](auto& a) { a->vjp_into(queue, of, to, frame, g); }, held_);
    }
    std::size_t bytes() const {
        return std::visit([](const auto& a) { return a->bytes(); }, held_);
    }

  private:
    std::variant<std::unique_ptr<DeviceEyeAppearance<A, Device, Networks>>...> held_;
};

} // namespace rye
