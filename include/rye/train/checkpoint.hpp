// SPDX-License-Identifier: Apache-2.0
/// rye/train/checkpoint.hpp: parameter structs and optimiser states as named tensors, and back.
/// A Columns of D x N is a tensor of shape (N, D), so that positions are (points, 3) and the weight
/// of a layer is (inputs, outputs).
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include <rye/io/safetensors.hpp>
#include <rye/nn/adam.hpp>

namespace rye {

/// Appends "prefix.name" for every array; the struct must outlive the entries.
template <class P>
void append_fields(const std::string& prefix, const P& p, std::vector<TensorEntry>& entries) {
    P::fields([&](const std::string& name, const auto& a) {
        entries.push_back(tensor_entry(prefix + "." + name, a));
    }, p);
    if constexpr (requires { P::buffers([](const std::string&, const auto&) {}, p); })
        P::buffers([&](const std::string& name, const auto& a) {
            entries.push_back(tensor_entry(prefix + "." + name, a));
        }, p);
}

/// Appends the moments and step counts of an optimiser.
template <class P>
void append_adam(const std::string& prefix, const Adam<P>& adam,
                 std::vector<TensorEntry>& entries) {
    const auto moments = [&](const std::string& which, const P& m) {
        P::fields([&](const std::string& name, const auto& a) {
            entries.push_back(tensor_entry(prefix + "." + which + "." + name, a));
        }, m);
    };
    moments("m", adam.m);
    moments("v", adam.v);
    const auto counts = std::as_bytes(std::span(adam.field_steps));
    entries.push_back({prefix + ".field_steps", TensorType::i64,
                       {static_cast<Index>(adam.field_steps.size())}, counts});
    entries.push_back(
        {prefix + ".step", TensorType::i64, {}, std::as_bytes(std::span(&adam.step, 1))});
}

namespace detail {

/// Loads a tensor into an array; throws an Error if the array has a size already and the tensor
/// another.
template <class T>
void load_array(const Safetensors& file, const std::string& name, Columns<T>& a) {
    a = a.size() > 0 ? file.columns<T>(name, a.rows(), a.cols()) : file.columns<T>(name);
}

} // namespace detail

/// Fills the arrays of `p` (and its buffers) from "prefix.name". Errors name the file and the
/// tensor.
template <class P>
void load_fields(const Safetensors& file, const std::string& prefix, P& p) {
    const auto load = [&](const std::string& name, auto& a) {
        detail::load_array(file, prefix + "." + name, a);
    };
    P::fields(load, p);
    if constexpr (requires { P::buffers(load, p); }) P::buffers(load, p);
}

/// Loads an optimiser's state; `adam` must have been made for parameters of the right shapes.
template <class P>
void load_adam(const Safetensors& file, const std::string& prefix, Adam<P>& adam) {
    P::fields([&](const std::string& name, auto& m, auto& v) {
        detail::load_array(file, prefix + ".m." + name, m);
        detail::load_array(file, prefix + ".v." + name, v);
    }, adam.m, adam.v);
    adam.step = file.values<std::int64_t>(prefix + ".step", {}).front();
    const TensorEntry& counts = file.at(prefix + ".field_steps");
    const std::vector<std::int64_t> steps =
        file.values<std::int64_t>(prefix + ".field_steps", counts.shape);
    adam.field_steps.assign(steps.begin(), steps.end());
}

} // namespace rye
