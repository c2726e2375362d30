// SPDX-License-Identifier: Apache-2.0
// Activations, encoding, the optimiser (F1-F5, F13, F15).
#include <limits>

#include <rye/backend/scalar.hpp>
#include <rye/math/scalar.hpp>
#include <rye/nn/adam.hpp>
#include <rye/nn/encoding.hpp>

#include "report.hpp"

namespace rye::hard {
namespace {

/// Error in units in the last place of the exact value.
template <class S>
double ulps(double got, long double truth) {
    using R = real_t<S>;
    const double least = double(std::numeric_limits<R>::min());
    int e = 0;
    std::frexp(std::max(double(std::abs(truth)), least), &e);
    return std::abs(static_cast<double>(got - truth)) / std::ldexp(2 * unit<S>, e - 1);
}

template <class S>
void f1_f2(Report& report) {
    using R = real_t<S>;
    double sig = 0, soft = 0, back = 0, naive_soft = 0, naive_rest = 0;
    bool monotone = true;
    double last = -1;
    for (double x = -86; x <= 86; x += 0.37) {
        const R r = static_cast<R>(x);
        const long double v = r, e = std::exp(-std::abs(v));
        const long double s = v < 0 ? e / (1 + e) : 1 / (1 + e);
        worsen(sig, ulps<S>(first(sigmoid(S(r))), s));
        const long double l = std::max(v, 0.0L) + std::log1p(e);
        const double got = first(softplus(S(r)));
        worsen(soft, ulps<S>(got, l));
        monotone = monotone && got >= last;
        last = got;
        worsen(naive_soft, ulps<S>(double(std::log(R(1) + std::exp(r))), l));
        // log(1 - sigmoid(x)) = -softplus(x)
        worsen(naive_rest, ulps<S>(double(std::log(R(1) - R(first(sigmoid(S(r)))))), -l));
        if (std::abs(x) < 12 && sizeof(R) == 4) {
            const double round = first(logit(sigmoid(S(r))));
            worsen(back, std::abs(round - double(r)) /
                             (4 * unit<S> * std::max(1.0, std::exp(std::abs(x)))));
        }
    }
    report.at_most("F1", kind_of<S>(), "sigmoid on [-86, 86] [ulp]", 3, sig);
    report.at_most("F1", kind_of<S>(), "logit(sigmoid(x)) - x, |x| < 12 [4u max(1, e^|x|)]", 1,
                   back);
    const R inf = std::numeric_limits<R>::infinity();
    report.holds("F1", kind_of<S>(), "+-inf: 1 and 0; 89: finite; NaN stays",
                 first(sigmoid(S(inf))) == 1 && first(sigmoid(S(-inf))) == 0 &&
                     std::isfinite(first(sigmoid(S(R(-89))))) &&
                     std::isnan(first(sigmoid(S(R(NAN))))));
    report.textbook("F1", kind_of<S>(), "log(1 - sigmoid(x)) [ulp]", 3, naive_rest);
    report.at_most("F2", kind_of<S>(), "softplus on [-86, 86] [ulp]", 3, soft);
    report.holds("F2", kind_of<S>(), "monotone", monotone);
    report.textbook("F2", kind_of<S>(), "log(1 + e^x) [ulp]", 3, naive_soft);
}

template <class T>
void f3(Report& report) {
    double worst = 0, angle = 0;
    for (const double x : {1e-8, 1.0, 4.0, -4.0, -1.0, 2.7}) {
        Columns<T> v(1, 1);
        v(0, 0) = static_cast<T>(x);
        const Columns<T> y = positional_encoding(v, 11);
        for (int k = 0; k <= 10; ++k) {
            const double arg = std::ldexp(double(v(0, 0)), k);
            worsen(worst, std::abs(double(y(1 + 2 * k, 0)) - std::sin(arg)));
            worsen(worst, std::abs(double(y(2 + 2 * k, 0)) - std::cos(arg)));
            // With the factor pi, 2^k pi x is rounded before the sine.
            const T p = static_cast<T>(3.14159265358979324) * static_cast<T>(arg);
            const long double true_arg = 3.14159265358979323846L * arg;
            worsen(angle, std::abs(double(std::sin(p)) - double(std::sin(true_arg))));
        }
    }
    const double demanded = sizeof(T) == 4 ? 1e-6 : 2e-15;
    report.at_most("F3", kind_of<T>(), "k to 10, |x| to 4: sines and cosines", demanded, worst);
    report.textbook("F3", kind_of<T>(), "sin(2^k pi x) with a rounded argument", demanded, angle);
}

template <class T>
struct One {
    Columns<T> w = Columns<T>::Constant(1, 1, T(1));
    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        f(std::string("w"), p.w...);
    }
};

template <class T>
void f4_f5_f13(Report& report) {
    const auto rate = [](const std::string&) { return 1e-3; };
    One<T> p, g;
    g.w.setZero();
    Adam<One<T>> state(p);
    for (int i = 0; i < 10; ++i) adam_step(ScalarBackend<>{}, p, g, state, rate);
    report.holds("F4", kind_of<T>(), "gradient 0 for 10 steps: parameters keep their bits",
                 p.w(0, 0) == T(1));
    // fp16 holds nothing below 6e-8: eps = 1e-8 becomes 0, and 0 / (sqrt(0) + 0) is NaN.
    const T half_eps = T(1e-8) < T(5.96e-8) ? T(0) : T(1e-8);
    report.textbook_fails("F4", kind_of<T>(), "eps 1e-8 rounded to half precision",
                          std::isfinite(T(0) / (std::sqrt(T(0)) + half_eps)));
    double worst = 0, naive = 0;
    for (const double t : {1.0, 2.0, 10.0, 1000.0, 1e5}) {
        const long double truth = -std::expm1(t * std::log(0.999L));
        worsen(worst, double(std::abs(-std::expm1(t * std::log(0.999)) / truth - 1)));
        const T beta = T(0.999);
        worsen(naive, double(std::abs((T(1) - std::pow(beta, static_cast<T>(t))) / truth - 1)));
    }
    report.at_most("F5", kind_of<T>(), "1 - beta^t, t 1 to 1e5, relative", 4e-13, worst);
    if (sizeof(T) == 4) report.textbook("F5", kind_of<T>(), "1 - beta^t in float", 4e-13, naive);
    // The first step moves by the rate whatever the size of the gradient.
    double first_step = 0;
    for (const double size : {1e-6, 1.0, 1e6}) {
        One<T> q, h;
        h.w(0, 0) = static_cast<T>(size);
        Adam<One<T>> fresh(q, {.eps = 1e-15});
        adam_step(ScalarBackend<>{}, q, h, fresh, rate);
        worsen(first_step, std::abs(double(T(1) - q.w(0, 0)) / 1e-3 - 1));
    }
    report.at_most("F5", kind_of<T>(), "first step, gradient 1e-6 to 1e6: rate, relative", 1e-4,
                   first_step);
    // F13
    bool skipped = true;
    for (const double bad : {std::numeric_limits<double>::infinity(), std::nan("")}) {
        One<T> q, h;
        h.w(0, 0) = static_cast<T>(bad);
        Adam<One<T>> fresh(q);
        const AdamReport r = adam_step(ScalarBackend<>{}, q, h, fresh, rate);
        skipped = skipped && !r.applied && r.first_bad_field == "w" && q.w(0, 0) == T(1) &&
                  fresh.step == 0 && fresh.m.w(0, 0) == T(0);
    }
    report.holds("F13", kind_of<T>(), "gradient inf, NaN: step skipped, named, state untouched",
                 skipped);
    const T inf = std::numeric_limits<T>::infinity();
    report.textbook_fails("F13", kind_of<T>(), "clip by 1 / |g| of an infinite gradient",
                          std::isfinite(inf * (T(1) / inf)));
}

template <class S>
void f15(Report& report) {
    using R = real_t<S>;
    const S nan(static_cast<R>(NAN));
    report.holds("F15", kind_of<S>(), "relu and leaky relu of NaN: NaN",
                 std::isnan(first(relu(nan))) && std::isnan(first(leaky_relu(nan))));
    report.textbook_fails("F15", kind_of<S>(), "max(0, NaN) shows it",
                          std::isnan(std::max(R(0), R(NAN))));
}

} // namespace

void networks(Report& report) {
    every_scalar([&]<class S>() {
        f1_f2<S>(report);
        f15<S>(report);
    });
    const auto both = [&]<class T>() {
        f3<T>(report);
        f4_f5_f13<T>(report);
    };
    both.operator()<float>();
    both.operator()<double>();
}

} // namespace rye::hard
