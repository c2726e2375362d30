// SPDX-License-Identifier: Apache-2.0
/// rye/core/fields.hpp: walks over the trainable arrays of a parameter struct.
/// A parameter struct P<T> names its arrays once, in
///     template <class F, class... P> static void fields(F&& f, P&&... p)
/// which calls f(name, p.array...) for each array, every one a Columns<T>. Gradients and optimiser
/// moments are further objects of the same struct, so one walk visits a parameter together with its
/// gradient and its moments; checkpoints, Adam, finite checks and dot products are such walks.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/core/parallel.hpp>

namespace rye {

namespace detail {

/// Visits the arrays of nested parameter structs under "prefix.name".
template <class P, class F, class... Ps>
void nested_fields(const std::string& prefix, F&& f, Ps&&... ps) {
    P::fields([&](const std::string& name, auto&&... arrays) { f(prefix + "." + name, arrays...); },
              std::forward<Ps>(ps)...);
}

} // namespace detail

/// Returns a struct of the same shapes, all zero: a gradient accumulator, or a moment.
template <class P>
P zeros_like(const P& p) {
    P z = p;
    P::fields([](const std::string&, auto& a) { a.setZero(); }, z);
    return z;
}

namespace detail {

/// Sets every array of p to zeros.
template <Threads Th, class P>
void set_zero(const Th& threads, P& p) {
    std::vector<ArrayWork> arrays;
    P::fields(
        [&](const std::string&, auto& a) {
            arrays.push_back(
                {a.size(), [&a](Index b, Index e) { a.reshaped().segment(b, e - b).setZero(); }});
        },
        p);
    for_chunks(threads, arrays, 16384);
}

} // namespace detail

/// Adds src to dst, array by array.
template <class P>
void add_fields(P& dst, const P& src) {
    P::fields([](const std::string&, auto& a, const auto& b) { a += b; }, dst, src);
}

/// Returns the number of trainable scalars.
template <class P>
Index count_fields(const P& p) {
    Index n = 0;
    P::fields([&](const std::string&, const auto& a) { n += a.size(); }, p);
    return n;
}

/// Writes each array of src, converted by `convert(scalar)`, into the same array of dst (resized).
/// Used to lift parameters from float to double or to duals.
template <class Dst, class Src, class Convert>
void convert_fields(Dst& dst, const Src& src, const Convert& convert) {
    Dst::fields(
        [&](const std::string&, auto& d, const auto& s) { d = s.unaryExpr(convert).eval(); }, dst,
        src);
}

} // namespace rye
