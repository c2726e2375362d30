// SPDX-License-Identifier: Apache-2.0
// Losses and metrics of empty or equal inputs (F6-F12, F16).
#include <limits>

#include <rye/loss/mesh_terms.hpp>
#include <rye/loss/perceptual.hpp>
#include <rye/loss/photometric.hpp>
#include <rye/loss/ssim.hpp>

#include "report.hpp"

namespace rye::hard {
namespace {

template <class T>
Image<T> picture(int kind) {
    Image<T> a(24, 20, 3);
    for (int y = 0; y < 20; ++y)
        for (int x = 0; x < 24; ++x)
            for (int c = 0; c < 3; ++c) {
                const auto i = std::uint64_t((y * 24 + x) * 3 + c);
                const double u = Random{6, std::uint64_t(kind)}.uniform(i);
                const double v = kind == 0   ? 0.6
                                 : kind == 1 ? 0.6 + 1e-7 * u
                                 : kind == 2 ? x / 24.0
                                             : u;
                a.at(x, y)[c] = static_cast<T>(v);
            }
    return a;
}

/// Eq. 13 in long double, window by window.
template <class T>
double reference_ssim(const Image<T>& a, const Image<T>& b, double& naive_variance) {
    long double sum = 0;
    int n = 0;
    double w[11], total = 0;
    for (int i = 0; i < 11; ++i) total += w[i] = std::exp(-0.5 * (i - 5) * (i - 5) / 2.25);
    for (int y = 0; y + 11 <= a.height; ++y)
        for (int x = 0; x + 11 <= a.width; ++x)
            for (int c = 0; c < 3; ++c, ++n) {
                long double m[5] = {};
                float f = 0, f2 = 0;
                for (int j = 0; j < 11; ++j)
                    for (int i = 0; i < 11; ++i) {
                        const long double k = w[i] * w[j] / (total * total);
                        const long double p = a.at(x + i, y + j)[c], q = b.at(x + i, y + j)[c];
                        m[0] += k * p, m[1] += k * q, m[2] += k * p * p, m[3] += k * q * q;
                        m[4] += k * p * q;
                        f += static_cast<float>(k) * static_cast<float>(p);
                        f2 += static_cast<float>(k) * static_cast<float>(p * p);
                    }
                const long double vx = m[2] - m[0] * m[0], vy = m[3] - m[1] * m[1];
                const long double xy = m[4] - m[0] * m[1];
                worsen(naive_variance, std::abs(double(f2 - f * f) - double(vx)));
                sum += (2 * m[0] * m[1] + 1e-4L) * (2 * xy + 9e-4L) /
                       ((m[0] * m[0] + m[1] * m[1] + 1e-4L) * (vx + vy + 9e-4L));
            }
    return static_cast<double>(sum / n);
}

template <class T>
void f6_f7(Report& report) {
    double worst = 0, naive = 0;
    bool own = true, bounded = true;
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) {
            const Image<T> a = picture<T>(i), b = picture<T>(j);
            const double s = ssim(ScalarBackend<>{}, a, b, {});
            worsen(worst, std::abs(s - reference_ssim(a, b, naive)));
            bounded = bounded && s <= 1;
            if (i == j) own = own && s == 1;
        }
    report.at_most("F6", kind_of<T>(), "flat, flat + 1e-7, ramp, random: against long double", 1e-6,
                   worst);
    report.holds("F6", kind_of<T>(), "ssim(x, x) = 1 exactly; never above 1", own && bounded);
    report.textbook("F6", kind_of<T>(), "E[x^2] - E[x]^2 in float: error of the variance", 1e-8,
                    naive);
    const Image<T> a = picture<T>(3);
    Image<T> near = a, one = a;
    near.pixels(0, 7) = std::nextafter(near.pixels(0, 7), T(2));
    one.pixels(1, 9) += static_cast<T>(1.0 / 255);
    const double off = double(one.pixels(1, 9)) - double(a.pixels(1, 9));
    const double formula = -10 * std::log10(off * off / double(a.pixels.size()));
    const Columns<T> all;
    report.holds("F7", kind_of<T>(), "identical: +inf; 1 ulp: finite",
                 std::isinf(psnr<T>(a.pixels, a.pixels, all)) &&
                     std::isfinite(psnr<T>(a.pixels, near.pixels, all)));
    report.at_most("F7", kind_of<T>(), "one pixel off by 1/255 [dB]", 1e-9,
                   std::abs(psnr<T>(a.pixels, one.pixels, all) - formula));
    report.textbook_fails("F7", kind_of<T>(), "20 log10(1 / sqrt(MSE)) of identical images",
                          std::isfinite(20 * std::log10(1 / std::sqrt(T(0)))));
}

template <class T>
void f8_f9(Report& report) {
    const Columns<T> none = Columns<T>::Zero(1, 9), full = Columns<T>::Ones(1, 9);
    const Columns<T> faint = Columns<T>::Constant(1, 9, T(1e-30));
    const auto iou = [&](const Columns<T>& a, const Columns<T>& b) {
        return detail::silhouette_term<T>(ScalarBackend<>{}, a, b, full);
    };
    const auto ee = iou(none, none), ea = iou(none, full), aa = iou(full, full),
               ff = iou(faint, none);
    report.holds("F8", kind_of<T>(),
                 "empty and empty agree; empty and full 1; equal 0; faint finite",
                 ee.value == T(0) && ee.count == 0 && std::abs(double(ea.value) - 1) < 1e-6 &&
                     std::abs(double(aa.value)) < 1e-6 && std::isfinite(ff.value) &&
                     ff.gradient.allFinite() && ee.gradient.isZero(0));
    const T zero = none(0, 0);
    report.textbook_fails("F8", kind_of<T>(), "intersection / union of empty masks",
                          std::isfinite(zero / zero));
    const LossTerm<T> nothing = detail::landmark_term<T>(Columns<T>(1, 0));
    const auto blink = masked_l1<T>(ScalarBackend<>{}, picture<T>(3).pixels, picture<T>(2).pixels,
                                    Columns<T>(Columns<T>::Zero(1, 480)));
    report.holds("F9", kind_of<T>(), "mean over nothing: value 0, count 0; blink: gradient 0",
                 nothing.value == T(0) && nothing.count == 0 && blink.value == T(0) &&
                     blink.gradient.isZero(0));
    const T count = T(0);
    report.textbook_fails("F9", kind_of<T>(), "sum / count of nothing",
                          std::isfinite(count / count));
}

template <class T>
void f10_f11_f16(Report& report) {
    Columns<T> d(1, 3);
    const T tiny = flushed() ? std::numeric_limits<T>::min() : std::numeric_limits<T>::denorm_min();
    d << T(0), tiny, T(-tiny);
    const auto l = detail::landmark_term<T>(d);
    report.holds("F10", kind_of<T>(), "|x| at 0: slope 0; at +-denormal: +-1/n",
                 l.gradient(0, 0) == T(0) && l.gradient(0, 1) > T(0) && l.gradient(0, 2) < T(0));
    report.textbook_fails("F10", kind_of<T>(), "x / |x| at 0", std::isfinite(d(0, 0) / d(0, 0)));
    const Image<T> flat = picture<T>(0);
    const auto p = PyramidGradientLoss()(ScalarBackend{}, flat, flat);
    report.holds("F11", kind_of<T>(), "equal features: loss 0, gradient 0",
                 p.value == T(0) && p.gradient.isZero(0));
    report.holds("F16", kind_of<T>(), "constant image: gradient of differences 0",
                 p.gradient.isZero(0));
    report.textbook_fails("F16", kind_of<T>(), "1 / (2 sqrt(dx^2 + dy^2)) of a constant image",
                          std::isfinite(T(0) * (T(0.5) / std::sqrt(T(0)))));
    report.textbook_fails("F11", kind_of<T>(), "f / |f| of the zero feature",
                          std::isfinite(T(0) / std::sqrt(T(0))));
}

template <class T>
void f12(Report& report) {
    const Index n = 1 << 21;
    Columns<T> a(3, n), b = Columns<T>::Zero(3, n);
    long double truth = 0;
    T naive = T(0);
    for (Index i = 0; i < a.size(); ++i) {
        a.data()[i] = static_cast<T>(0.1 * Random{12, 0}.uniform(std::uint64_t(i)));
        truth += a.data()[i];
        naive += a.data()[i];
    }
    const Columns<T> all;
    const auto one = masked_l1<T>(ScalarBackend<Serial>{}, a, b, all);
    const auto many = masked_l1<T>(ScalarBackend<>{}, a, b, all);
    const double mean = static_cast<double>(truth) / double(a.size());
    report.at_most("F12", kind_of<T>(), "mean of 6.3e6 numbers, relative",
                   sizeof(T) == 4 ? 4 * unit<T> : 1e-13, std::abs(double(one.value) / mean - 1));
    report.holds("F12", kind_of<T>(), "the same bits with one thread and many",
                 one.value == many.value);
    if (sizeof(T) == 4)
        report.textbook("F12", kind_of<T>(), "one float accumulator, relative", 4 * unit<T>,
                        std::abs(double(naive) / double(a.size()) / mean - 1));
}

} // namespace

void losses(Report& report) {
    const auto both = [&]<class T>() {
        f6_f7<T>(report);
        f8_f9<T>(report);
        f10_f11_f16<T>(report);
        f12<T>(report);
    };
    both.operator()<float>();
    both.operator()<double>();
}

} // namespace rye::hard
