// SPDX-License-Identifier: Apache-2.0
// Extents of Gaussians, tile lists, and their order (B6-B8, B11-B13, B17, B18).
#include <limits>

#include <rye/math/exponential.hpp>
#include <rye/splat/plain/stage.hpp>

#include "report.hpp"

namespace rye::hard {
namespace {

template <class T>
struct One {
    Pinhole<T> camera;
    ScreenGaussian<T> screen;
    Splat<T> splat;
    Footprint<T> footprint;
};

/// A needle or disc on the screen of a 128 x 96 image, through the projection itself.
template <class T>
One<T> one(double cx, double cy, double sx, double sy, double angle, double opacity,
           const Balanced& accuracy) {
    One<T> o;
    o.camera.fx = o.camera.fy = T(100);
    o.camera.width = 128, o.camera.height = 96;
    o.camera.cx = T(64), o.camera.cy = T(48);
    Shape<T> s{Vec3<T>(T((cx - 64) / 100), T((cy - 48) / 100), T(1)),
               Quat<T>(T(std::cos(angle / 2)), T(0), T(0), T(std::sin(angle / 2))),
               Vec3<T>(T(sx / 100), T(sy / 100), T(1e-5))};
    o.screen = project(s, Projector<T>(o.camera, 100, accuracy.dilation));
    o.splat = make_splat(o.screen, T(opacity), accuracy);
    o.footprint = detail::footprint_of<Balanced>(o.screen, o.splat, o.camera.cx, o.camera.cy);
    return o;
}

/// Pixels whose alpha reaches theta although no list has them; and tiles listed needlessly.
template <class T>
void cover(const One<T>& o, Index& misses, Index& tiles, Index& needed, double sigma_box = 0) {
    const Cover<Support::ellipse, T> c{o.footprint, o.camera.width, o.camera.height};
    const Span rows = c.rows();
    for (int ty = 0; ty < 96 / detail::tile_edge; ++ty) {
        Span span;
        if (rows.begin < rows.end && ty >= rows.begin / detail::tile_edge &&
            ty <= (rows.end - 1) / detail::tile_edge)
            span = c.columns(ty, rows);
        for (int tx = 0; tx < 128 / detail::tile_edge; ++tx) {
            bool wanted = false;
            for (int y = ty * detail::tile_edge; y < (ty + 1) * detail::tile_edge; ++y)
                for (int x = tx * detail::tile_edge; x < (tx + 1) * detail::tile_edge; ++x) {
                    const T px = T(x) + T(0.5) - o.camera.cx, py = T(y) + T(0.5) - o.camera.cy;
                    // For the given numbers, without the kernel's rounding.
                    const long double dx = px - static_cast<long double>(o.splat.x);
                    const long double dy = py - static_cast<long double>(o.splat.y);
                    const long double u = o.splat.ux * dx, v = o.splat.vx * dx + o.splat.vy * dy;
                    const bool hit = o.splat.log2_opacity - u * u - v * v >=
                                     static_cast<long double>(o.splat.cut);
                    wanted = wanted || hit;
                    bool listed =
                        tx >= span.begin && tx < span.end && y >= rows.begin && y < rows.end;
                    if (sigma_box > 0)
                        listed = std::abs(x + 0.5 - double(o.footprint.x)) <=
                                     sigma_box * std::sqrt(double(o.footprint.covariance.xx)) &&
                                 std::abs(y + 0.5 - double(o.footprint.y)) <=
                                     sigma_box * std::sqrt(double(o.footprint.covariance.yy));
                    if (hit && !listed) ++misses;
                }
            if (tx >= span.begin && tx < span.end) {
                ++tiles;
                if (wanted) ++needed;
            }
        }
    }
}

template <class T>
void b6_b8(Report& report) {
    Balanced accuracy;
    accuracy.alpha_min = 1.0 / 255;
    const double theta = accuracy.alpha_min;
    Index misses = 0, tiles = 0, needed = 0, box_misses = 0, unused = 0;
    for (const double o : {theta * (1 + 1e-6), 0.01, 0.353, 1.0})
        for (const double sigma : {0.3, 3.0, 300.0})
            for (int at = 0; at < 40; ++at) {
                const double u = Random{6, 0}.uniform(std::uint64_t(at));
                const double v = Random{6, 1}.uniform(std::uint64_t(at));
                const double x = at % 4 == 0 ? 8 * (at / 4) : 128 * u; // on tile corners too
                const double y = at % 4 == 0 ? 8 * (at / 4) : 96 * v;
                const auto g = one<T>(x, y, sigma, sigma, 0.3, o, accuracy);
                cover(g, misses, tiles, needed);
                cover(g, box_misses, unused, unused, 3.0);
            }
    report.at_most("B6", kind_of<T>(), "o to 1, sigma .3 to 300, on corners: pixels missed", 0,
                   double(misses));
    report.textbook("B6", kind_of<T>(), "a box of 3 sigma: pixels missed", 0, double(box_misses));

    // B8: needles of A1 across the image; a tile near the rim may be listed needlessly.
    misses = tiles = needed = 0;
    bool finite = true;
    for (const double sigma : {10.0, 300.0, 3000.0, 3e4})
        for (int at = 0; at < 60; ++at) {
            const auto g = one<T>(8 * (at % 16), 8 * (at % 12), sigma, 1e-3,
                                  6.2831853 * Random{8, 0}.uniform(std::uint64_t(at)), 1, accuracy);
            cover(g, misses, tiles, needed);
            finite = finite && std::isfinite(double(g.footprint.radius));
        }
    report.at_most("B8", kind_of<T>(), "needles 10 to 3e4 px through tile corners: missed", 0,
                   double(misses));
    report.at_most("B8", kind_of<T>(), "the same: tiles listed per tile needed", 1.5,
                   double(tiles) / double(needed));
    // The edge test of B^2 - A C of the conic.
    const auto g = one<T>(64, 48, 3e4, 1e-3, 0.7, 1, accuracy);
    const Sym2<T>& c = g.screen.covariance;
    const T a = c.yy, b = -c.xy, d = c.xx, product = a * d;
    report.textbook("B8", kind_of<T>(), "B^2 - A C of a 3e4 px needle: relative error",
                    sizeof(T) == 4 ? 1e-3 : 1e-9,
                    std::abs(double(b * b - product) / -double(g.screen.determinant) - 1));
}

template <class T>
void b7(Report& report) {
    bool declared = true;
    Balanced accuracy;
    const T theta = T(accuracy.alpha_min), u = std::numeric_limits<T>::epsilon();
    for (const T o : {T(0), T(theta * (T(1) - 4 * u)), theta, T(theta * (T(1) + 4 * u)), T(1)}) {
        Gaussians<T> g(1, 1);
        g.mean << T(0), T(0), T(1);
        g.rotation << T(1), T(0), T(0), T(0);
        g.scale.setConstant(T(0.02));
        g.opacity.setConstant(o);
        g.feature.setConstant(T(1));
        Pinhole<T> camera;
        camera.fx = camera.fy = T(100);
        camera.cx = camera.cy = T(8), camera.width = camera.height = 16;
        RasterScratch<T> scratch;
        scratch.shape(1);
        detail::project_range(SplatInput{view_of(g), camera, accuracy}, {0, 1}, scratch);
        // At the threshold itself the footprint may be the centre alone; beyond, it is drawn.
        if (o < theta) declared = declared && scratch.state[0] == Visibility::hidden;
        if (o > theta * T(1 + 1e-5)) declared = declared && scratch.state[0] == Visibility::visible;
        if (scratch.state[0] == Visibility::visible)
            declared = declared && std::isfinite(double(scratch.footprints[0].radius));
    }
    report.holds("B7", kind_of<T>(), "o in {0, theta(1 -+ 4u), theta, 1}: culled or finite",
                 declared);
    report.textbook_fails("B7", kind_of<T>(), "sqrt(2 ln(o / theta)) for o < theta",
                          std::isfinite(std::sqrt(T(2) * std::log(T(0.5)))));
}

template <class T>
void b11(Report& report) {
    using Bits = decltype(detail::depth_key(T()));
    std::vector<T> x;
    for (std::uint64_t i = 0; i < 200000; ++i) {
        const T v = std::bit_cast<T>(static_cast<Bits>(Random{11, 0}.bits(i)));
        if (!std::isnan(v)) x.push_back(v);
    }
    const T inf = std::numeric_limits<T>::infinity(), tiny = std::numeric_limits<T>::denorm_min();
    for (const T v : {T(0), T(-0.0), tiny, T(-tiny), inf, T(-inf), T(1), T(-1)}) x.push_back(v);
    std::vector<T> sorted = x;
    std::sort(sorted.begin(), sorted.end());
    Index inversions = 0, raw = 0;
    for (std::size_t i = 1; i < sorted.size(); ++i) {
        if (sorted[i - 1] == sorted[i]) continue; // -0 and +0
        if (!(detail::depth_key(sorted[i - 1]) < detail::depth_key(sorted[i]))) ++inversions;
        if (!(std::bit_cast<Bits>(sorted[i - 1]) < std::bit_cast<Bits>(sorted[i]))) ++raw;
    }
    report.at_most("B11", kind_of<T>(), "200000 numbers of random bits and specials: inversions", 0,
                   double(inversions));
    report.textbook("B11", kind_of<T>(), "the bits as they are", 0, double(raw));
}

template <class T>
void b12_b13(Report& report) {
    // Three that cover all tiles: more pairs than the budget is an Error before any allocation.
    std::vector<Span> rows(3, Span{0, 1 << 20});
    Footprint<T> f{T(1 << 19), T(1 << 19), T(4), {T(1e12), T(0), T(1e12)}, T(1e24)};
    TileLists lists;
    const Index all = Index(3) * (64 / detail::tile_edge) * ((1 << 20) / detail::tile_edge);
    bool told = false;
    try {
        detail::BinScratch<std::uint32_t> scratch;
        lists.build<Support::ellipse, T>(
            Serial{}, {64, 1 << 20},
            detail::BinInput{3, [&](Index m) { return rows[std::size_t(m)]; },
                             [](Index m) { return static_cast<std::uint32_t>(m); },
                             [](Index m) { return m; },
                             [&](Index) -> const Footprint<T>& { return f; }},
            all - 1, scratch);
    } catch (const Error&) {
        told = true;
    }
    report.holds("B12", kind_of<T>(),
                 "3 over all of 64 x 2^20 px, a budget of one pair less: Error", told);
    const std::uint32_t wrapped = static_cast<std::uint32_t>(std::uint64_t(1000000) * 8160U);
    report.textbook_fails("B12", kind_of<T>(), "1e6 splats x 8160 tiles in 32 bits",
                          wrapped == std::uint64_t(1000000) * 8160U);
    // B13: counted pairs are emitted pairs, with infinities among the inputs.
    bool equal = true;
    for (std::uint64_t seed = 0; seed < 30; ++seed) {
        std::vector<Footprint<T>> feet;
        std::vector<Span> spans;
        for (std::uint64_t i = 0; i < 50; ++i) {
            const Random r{seed, i};
            const T s = static_cast<T>(std::exp(4 * r.normal(1)));
            const T inf = std::numeric_limits<T>::infinity();
            const Footprint<T> foot{static_cast<T>(100 * r.normal(2)),
                                    static_cast<T>(100 * r.normal(4)),
                                    r.below(6, 9) == 0 ? inf : T(3),
                                    {s, T(0), s},
                                    s * s};
            const Span p = Cover<Support::ellipse, T>{foot, 100, 70}.rows();
            if (p.begin >= p.end) continue;
            feet.push_back(foot);
            spans.push_back(p);
        }
        TileLists t;
        detail::BinScratch<std::uint32_t> scratch;
        t.build<Support::ellipse, T>(
            Serial{}, {100, 70},
            detail::BinInput{
                static_cast<Index>(feet.size()),
                [&](Index m) { return spans[static_cast<std::size_t>(m)]; },
                [](Index m) { return static_cast<std::uint32_t>(m); }, [](Index m) { return m; },
                [&](Index i) -> const Footprint<T>& { return feet[static_cast<std::size_t>(i)]; }},
            Index(1) << 30, scratch);
        Index counted = 0;
        for (std::size_t m = 0; m + 1 < t.first.size(); ++m) counted += t.first[m + 1] - t.first[m];
        equal = equal && counted == t.entries() && static_cast<Index>(t.entry.size()) == counted;
        for (const auto& e : t.entry) equal = equal && e.member < feet.size();
    }
    report.holds("B13", kind_of<T>(), "30 x 50 random extents, some infinite: counted == emitted",
                 equal);
}

template <int Degree>
void b17(Report& report, double demanded) {
    double worst = 0;
    for (double x = -8; x <= 0; x += 1e-5) {
        const float f = static_cast<float>(x);
        worsen(worst, std::abs(double(Exp2Poly<Degree>()(f)) / std::exp2(double(f)) - 1));
    }
    report.at_most("B17", "float",
                   "2^x of degree " + std::to_string(Degree) + " on [-8, 0]; relative error",
                   demanded, worst);
}

template <class T>
void b18(Report& report) {
    bool inside = true;
    const T inf = std::numeric_limits<T>::infinity();
    for (const T low : {T(-1e20), T(-inf), T(0), T(5), T(1e20), inf})
        for (const T high : {T(-1e20), T(-inf), T(0), T(5), T(1e20), inf}) {
            const Span s = pixels_between(low, high, 100);
            inside = inside && s.begin >= 0 && s.begin <= 100 && s.end >= 0 && s.end <= 100;
        }
    report.holds("B18", kind_of<T>(), "bounds to 1e20 and infinity: clamped before the cast",
                 inside);
}

} // namespace

void tiling(Report& report) {
    const auto both = [&]<class T>() {
        b6_b8<T>(report);
        b7<T>(report);
        b11<T>(report);
        b12_b13<T>(report);
        b18<T>(report);
    };
    both.operator()<float>();
    both.operator()<double>();
    b17<3>(report, Exp2Poly<3>::max_relative_error);
    b17<4>(report, Exp2Poly<4>::max_relative_error);
    b17<5>(report, Exp2Poly<5>::max_relative_error);
    b17<6>(report, Exp2Poly<6>::max_relative_error);
    double trick = 0;
    for (double x = -8; x <= 0; x += 1e-3) {
        const auto bits = static_cast<std::int32_t>((x + 126.94269504) * 8388608.0);
        worsen(trick, std::abs(double(std::bit_cast<float>(bits)) / std::exp2(x) - 1));
    }
    report.textbook("B17", "float", "Schraudolph's bits", Exp2Poly<3>::max_relative_error, trick);
    report.holds("B17", "float", "2^-200, 2^NaN: the least, not opaque",
                 Exp2Poly<5>()(-200.0F) < 1e-37F && Exp2Poly<5>()(NAN) < 1e-37F);
}

} // namespace rye::hard
