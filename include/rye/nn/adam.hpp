// SPDX-License-Identifier: Apache-2.0
/// rye/nn/adam.hpp: the Adam optimiser over the fields of a parameter struct.
/// p -= rate / c1 m / (sqrt(v / c2) + eps), c_i = 1 - beta_i^t in double as -expm1(t log beta_i).
/// Every field counts its own steps, so bias correction is right for fields that start late. A
/// gradient that is not finite cancels the whole step before anything is changed.
/// Source: Kingma and Ba, "Adam", 2015, algorithm 1, in PyTorch's order of operations.
#pragma once

#include <atomic>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include <rye/backend/backend.hpp>
#include <rye/core/fields.hpp>
#include <rye/nn/elementwise.hpp>

namespace rye {

/// Settings of Adam; its rate is an argument of each step.
struct AdamConfig {
    double beta1 = 0.9;
    double beta2 = 0.999;
    double eps = 1e-8;
};

/// One number's step, for numbers and lanes.
template <class T>
struct AdamFormula {
    T b1, d1, b2, d2, eps; ///< beta1, 1 - beta1, beta2, 1 - beta2

    RYE_HD explicit AdamFormula(const AdamConfig& c)
        : b1(T(c.beta1)),
          d1(T(1.0 - c.beta1)),
          b2(T(c.beta2)),
          d2(T(1.0 - c.beta2)),
          eps(T(c.eps)) {}

    template <class V>
    [[gnu::always_inline]] RYE_HD V mean(const V& m, const V& g) const {
        return b1 * m + d1 * g;
    }
    template <class V>
    [[gnu::always_inline]] RYE_HD V square(const V& v, const V& g) const {
        return b2 * v + d2 * g * g;
    }
    /// The parameter after the step. size: rate / c1, root: 1 / sqrt(c2).
    template <class V>
    [[gnu::always_inline]] RYE_HD V moved(const V& p, const V& m, const V& v, const T& size,
                                          const T& root) const {
        using std::sqrt;
        return p - size * m / (sqrt(v) * root + eps);
    }
};

/// size and root of AdamFormula::moved for step t = 1, 2, ... at a rate.
template <class T>
struct AdamStep {
    T size, root;

    RYE_HD AdamStep(const AdamConfig& config, double rate, std::int64_t step) {
        using std::expm1, std::log, std::sqrt;
        const double t = static_cast<double>(step);
        const double c1 = -expm1(t * log(config.beta1));
        const double c2 = -expm1(t * log(config.beta2));
        size = T(rate / c1);
        root = T(1.0 / sqrt(c2));
    }
};

/// The optimiser: its settings, and moments of the same shapes as the parameters.
template <class P>
struct Adam {
    P m;                            ///< mean of gradients
    P v;                            ///< mean of squared gradients
    std::int64_t step = 0;          ///< steps applied so far
    std::vector<std::int64_t> field_steps; ///< the same per field, in the order of fields()
    AdamConfig config = {};

    Adam() = default;
    explicit Adam(const P& p, const AdamConfig& c = {})
        : m(zeros_like(p)), v(zeros_like(p)), config(c) {}
};

/// Outcome of a step: applied, or not.
struct AdamReport {
    bool applied = true;         ///< false: a gradient was not finite and nothing has changed
    std::string first_bad_field; ///< empty if applied
};

namespace detail {

/// Elements per chunk of an elementwise pass.
inline constexpr Index adam_grain = 8192;

/// By one vectorised sum: 0 x is 0 for every finite x and NaN for all others.
template <class T>
bool all_finite(const T* x, Index n) {
    return (Eigen::Map<const VecX<T>>(x, n).array() * T(0)).sum() == T(0);
}

} // namespace detail

/// Applies one step. `rate(name)` is the learning rate of a field; with rate 0 a field keeps its
/// value and its moments, and its gradient is not read.
template <class P, class Rate, Backend B>
    requires std::is_invocable_r_v<double, Rate, const std::string&> AdamReport
    adam_step(const B& backend, P& p, const P& g, Adam<P>& state, const Rate& rate) {
        const AdamConfig& config = state.config;
        std::vector<double> rates;
        std::vector<std::string> names;
        P::fields(
            [&](const std::string& name, const auto&) {
                names.push_back(name);
                rates.push_back(rate(name));
            },
            g);
        std::vector<std::atomic<bool>> bad(rates.size());
        std::vector<detail::ArrayWork> arrays;
        P::fields(
            [&](const std::string&, const auto& a) {
                const std::size_t i = arrays.size();
                arrays.push_back({rates[i] == 0.0 ? 0 : a.size(), [&a, &bad, i](Index b, Index e) {
                                      if (!detail::all_finite(a.data() + b, e - b)) bad[i] = true;
                                  }});
            },
            g);
        for_chunks(backend.threads, arrays, detail::adam_grain);
        for (std::size_t i = 0; i < bad.size(); ++i)
            if (bad[i]) return {false, names[i]};

        state.field_steps.resize(rates.size(), state.step);
        ++state.step;
        arrays.clear();
        P::fields(
            [&](const std::string&, auto& a, const auto& ga, auto& m, auto& v) {
                using T = typename std::remove_cvref_t<decltype(a)>::Scalar;
                const std::size_t i = arrays.size();
                arrays.push_back({0, nullptr});
                if (rates[i] == 0.0) return;
                RYE_ASSERT(T(config.eps) > T(0), "adam_step: eps is 0 in this precision");
                RYE_ASSERT(a.size() == ga.size() && a.size() == m.size() && a.size() == v.size(),
                           "adam_step: parameter, gradient and moments differ in shape");
                const AdamStep<T> now(config, rates[i], ++state.field_steps[i]);
                const AdamFormula<T> formula(config);
                arrays.back() = {
                    a.size(), [&a, &ga, &m, &v, now, formula](Index b, Index e) {
                        const Index n = e - b;
                        T *pa = a.data() + b, *pm = m.data() + b, *pv = v.data() + b;
                        const T* pg = ga.data() + b;
                        detail::transform_array<B>(
                            n, pm, [&](auto x, auto y) { return formula.mean(x, y); }, pm, pg);
                        detail::transform_array<B>(
                            n, pv, [&](auto x, auto y) { return formula.square(x, y); }, pv, pg);
                        detail::transform_array<B>(
                            n, pa,
                            [&](auto x, auto mi, auto vi) {
                                return formula.moved(x, mi, vi, now.size, now.root);
                            },
                            pa, pm, pv);
                    }};
            },
            p, g, state.m, state.v);
        for_chunks(backend.threads, arrays, detail::adam_grain);
        return {};
    }

} // namespace rye
