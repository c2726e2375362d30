// SPDX-License-Identifier: Apache-2.0
// Whole images: empty scenes, symmetry, order, agreement of backends, threads (B10, B14, B19,
// B20, and I6, I7 of a render).
#include <numeric>

#include "screens.hpp"

namespace rye::hard {
namespace {

template <class T>
bool same(const Raster<T>& a, const Raster<T>& b) {
    return a.feature.pixels == b.feature.pixels && a.alpha.pixels == b.alpha.pixels &&
           a.depth.pixels == b.depth.pixels;
}

struct FineKeys : Balanced {
    static constexpr int depth_bits = 64;
};

template <class B, class T>
void b10(Report& report) {
    // A coplanar grid and depths so close that some floats are equal, in another order.
    auto s = cloud<T>(300, 3, 10);
    for (Index i = 0; i < 300; ++i)
        s.gaussians.mean(2, i) =
            i % 3 == 0
                ? T(0)
                : static_cast<T>(1e-6 * Random{10, 3}.uniform(static_cast<std::uint64_t>(i)));
    // Equal depths are ordered by index, so a permutation that keeps the order of ties changes
    // nothing: here the far half and the tied ones swap places as blocks.
    std::vector<Index> order(300);
    std::iota(order.begin(), order.end(), Index(0));
    std::stable_sort(order.begin(), order.end(), [](Index a, Index b) { return a % 3 < b % 3; });
    auto p = s;
    Gaussians<T>::fields(
        [&](const std::string&, Columns<T>& to, const Columns<T>& from) {
            for (std::size_t i = 0; i < order.size(); ++i)
                to.col(static_cast<Index>(i)) = from.col(order[i]);
        },
        p.gaussians, s.gaussians);
    bool distinct = true; // ties only among the coplanar, whose order is kept
    std::vector<T> z;
    for (Index i = 0; i < 300; ++i)
        if (i % 3 != 0) z.push_back(T(3) + s.gaussians.mean(2, i));
    std::sort(z.begin(), z.end());
    for (std::size_t i = 1; i < z.size(); ++i) distinct = distinct && z[i] != z[i - 1];
    const bool equal = same(draw<B>(s), draw<B>(p));
    if (sizeof(T) == 8) {
        report.holds("B10", kind<B, T>(),
                     "300 depths within 1e-6, a third coplanar: permuted, same", equal && distinct);
    } else {
        // In float depths 3 + 1e-6 u take a handful of values.
        report.textbook_fails("B10", kind<B, T>(), "float keys tell depths 1e-6 apart", distinct);
        const Rasterizer<FineKeys> fine;
        report.holds("B10", kind<B, T>(), "the same with keys of 64 bits: permuted, same bits",
                     same(fine.forward(B{}, s.gaussians, s.camera, s.background),
                          fine.forward(B{}, p.gaussians, p.camera, p.background)));
        const auto again = draw<B>(s);
        report.holds("B10", kind<B, T>(), "the same order given twice: the same bits",
                     same(again, draw<B>(s)));
    }
    auto apart = cloud<T>(300, 3, 11); // distinct depths: any permutation, in float too
    auto turned = apart;
    Gaussians<T>::fields(
        [&](const std::string&, Columns<T>& to, const Columns<T>& from) {
            for (Index i = 0; i < 300; ++i) to.col((i * 7 + 3) % 300) = from.col(i);
        },
        turned.gaussians, apart.gaussians);
    report.holds("B10", kind<B, T>(), "300 random depths: permuted, same bits",
                 same(draw<B>(apart), draw<B>(turned)));
}

template <class B, class T>
void b14(Report& report) {
    bool fine = true;
    const auto whole = [&](const Screen<T>& s) {
        const auto r = draw<B>(s);
        fine = fine && r.feature.pixels.allFinite() &&
               r.feature.size() == Index(s.camera.width) * s.camera.height;
        if (r.feature.size() > 0) fine = fine && pull<B>(s, r).mean.allFinite();
    };
    whole(cloud<T>(0, 3, 1));
    auto behind = cloud<T>(20, 3, 2);
    behind.camera.camera_from_world.translation[2] = T(-9);
    whole(behind);
    auto one = cloud<T>(1, 3, 3);
    one.camera.width = 4096, one.camera.height = 64;
    whole(one);
    for (const int edge : {0, 1, 7, 8, 9, 17}) {
        auto small = cloud<T>(20, 3, 4);
        small.camera.width = edge, small.camera.height = edge == 0 ? 3 : edge + 2;
        whole(small);
    }
    report.holds("B14", kind<B, T>(),
                 "no Gaussian; all behind; 1 on 4096 x 64; edges 0, 1, 7, 8, 9, 17", fine);
}

template <class B, class T>
void b19(Report& report) {
    auto s = layers<T>(1, 1, T(0.5));
    s.camera.width = s.camera.height = 17;
    s.camera.cx = s.camera.cy = T(8.5);
    s.gaussians.scale.setConstant(T(5));
    const auto r = draw<B>(s);
    const Columns<T> a = Eigen::Map<const Columns<T>>(r.alpha.pixels.data(), 17, 17);
    const Columns<T> sideways = a.rowwise().reverse(), upside = a.colwise().reverse();
    report.holds("B19", kind<B, T>(), "isotropic at a pixel's centre: two flips, bit for bit",
                 a == sideways && a == upside);
    // u^2 and v^2 are subtracted one after the other, so a transpose may round otherwise.
    report.at_most("B19", kind<B, T>(), "the transpose", sizeof(T) == 4 ? 1e-6 : 1e-14,
                   double((a - a.transpose()).cwiseAbs().maxCoeff()));
    // Pixel corners in place of centres: the same splat is off by half a pixel.
    auto corner = s;
    corner.camera.cx = corner.camera.cy = T(8);
    const auto c = draw<B>(corner);
    const Columns<T> b = Eigen::Map<const Columns<T>>(c.alpha.pixels.data(), 17, 17);
    const Columns<T> mirrored = b.rowwise().reverse();
    report.textbook_fails("B19", kind<B, T>(), "pixel centres at whole numbers", b == mirrored);
}

template <class B, class T>
void b20(Report& report) {
    const auto s = cloud<T>(200, 3, 20);
    const Balanced exact = Exact32();
    const auto a = pull<Plain>(s, draw<Plain>(s, exact), exact);
    const auto b = pull<B>(s, draw<B>(s, exact), exact);
    double worst = 0;
    Gaussians<T>::fields(
        [&](const std::string&, const Columns<T>& x, const Columns<T>& y) {
            double xy = 0, xx = 0, yy = 0;
            for (Index i = 0; i < x.size(); ++i) {
                const double p = double(x.data()[i]), q = double(y.data()[i]);
                xy += p * q, xx += p * p, yy += q * q;
            }
            worsen(worst, 1 - xy / std::sqrt(xx * yy));
        },
        a, b);
    report.at_most("B20", kind<B, T>(), "gradient against the scalar backend: 1 - cosine", 1e-6,
                   worst);
}

template <class B, class T>
void threads(Report& report) {
    using Threaded = std::conditional_t<std::is_same_v<B, Plain>, ScalarBackend<>, XsimdBackend<>>;
    const auto s = cloud<T>(2500, 3, 30);
    const auto one = draw<B>(s);
    const auto g = pull<B>(s, one);
    bool equal = true;
    for (int i = 0; i < 3; ++i) {
        const auto many = draw<Threaded>(s);
        equal = equal && same(one, many);
        Gaussians<T>::fields(
            [&](const std::string&, const auto& x, const auto& y) { equal = equal && x == y; }, g,
            pull<Threaded>(s, many));
    }
    report.holds("I6", kind<B, T>(), "2500 Gaussians, gradients, 3 runs: one result", equal);
    report.holds("I7", kind<B, T>(), "one thread and many: the same bits, image and gradient",
                 equal);
}

} // namespace

void images(Report& report) {
    every_backend([&]<class B, class T>() {
        b10<B, T>(report);
        b14<B, T>(report);
        b19<B, T>(report);
        b20<B, T>(report);
    });
    threads<Plain, double>(report);
    threads<Wide, float>(report);
    // Sums in the order in which threads finish.
    float up = 0, down = 0;
    for (std::uint64_t i = 0; i < 10000; ++i) {
        up += static_cast<float>(Random{6, 0}.normal(2 * i));
        down += static_cast<float>(Random{6, 0}.normal(2 * (9999 - i)));
    }
    report.textbook_fails("I6", "float", "10000 signed terms added in another order", up == down);
    report.textbook_fails("I7", "float", "a sum whose order follows the threads", up == down);
}

} // namespace rye::hard
