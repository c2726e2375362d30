// SPDX-License-Identifier: Apache-2.0
// Every policy and every setting on every scene: errors relative to the oracle, and time.
#include <ctime>
#include <map>

#include <rye/gaussian/activate.hpp>
#include <rye/io/ply.hpp>
#include <rye/splat/oracle_vjp.hpp>

#include "errors.hpp"
#include "models.hpp"
#include "policy.hpp"
#include "table.hpp"

namespace rye::bench {
namespace {

/// Clock of this thread alone, so that other load on the machine matters less.
double seconds() {
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

/// At most 3000 of a file's Gaussians, those nearest to their centre, seen from the front.
Scenery ply_scene(const std::string& path) {
    const GaussianCloud<float> cloud = read_ply<float>(path);
    const Vec3<float> centre = cloud.mean.rowwise().mean();
    Scenery s{"ply", activate(cloud, Vec3<float>(centre - Vec3<float>(0, 0, 3))),
              front_camera(215, 0)};
    const Index n = s.gaussians.count(), step = std::max<Index>(1, n / 3000);
    Gaussians<float> some(n / step, 3);
    Gaussians<float>::fields(
        [&](const std::string&, Columns<float>& to, const Columns<float>& from) {
            for (Index i = 0; i < to.cols(); ++i) to.col(i) = from.col(i * step);
        },
        some, s.gaussians);
    s.gaussians = some;
    // Distance: three times the width of the middle half of the points.
    std::vector<float> far(static_cast<std::size_t>(some.count()));
    for (Index i = 0; i < some.count(); ++i)
        far[static_cast<std::size_t>(i)] = (some.mean.col(i) - centre).norm();
    std::nth_element(far.begin(), far.begin() + static_cast<std::ptrdiff_t>(far.size() / 2),
                     far.end());
    const float radius = far[far.size() / 2];
    s.gaussians.scale *= std::cbrt(static_cast<float>(step)); // compensates the subsampling
    s.camera.camera_from_world.translation = -centre + Vec3<float>(0, 0, 3 * radius);
    return s;
}

/// Cotangents of the image and of alpha: standard normal.
Columns<float> weights(Index rows, Index pixels, std::uint64_t stream) {
    Columns<float> w(rows, pixels);
    for (Index p = 0; p < pixels; ++p)
        for (Index c = 0; c < rows; ++c)
            w(c, p) = static_cast<float>(
                Random{4004, stream + 2 * static_cast<std::uint64_t>(c)}.normal(std::uint64_t(p)));
    return w;
}

/// Rows without a time: forms and models without a kernel.
void add_models(const Scenery& s, const Columns<double>& truth, const Columns<double>& fine,
                const Columns<double>& by_peak, std::vector<PriceRow>& rows) {
    const double none = std::nan("");
    const auto add = [&](const char* kind, const char* name, const Columns<double>& image,
                         const Columns<double>& reference) {
        const ImageError e = image_error(image, reference);
        rows.push_back(
            {kind, name, s.name, e.largest, e.rms, e.psnr(), none, none, none, none, none});
    };
    add("form", "factor in plain loops", blend_in_float(s, Form::factor), truth);
    add("form", "conic, a c - b^2", blend_in_float(s, Form::conic), truth);
    Gaussians<double> g;
    convert_fields(g, s.gaussians, [](float x) { return static_cast<double>(x); });
    const Pinhole<double> camera = s.camera.cast<double>();
    const VecX<double> background = s.background.cast<double>();
    add("order", "depth keys of 32 bits", truth, fine);
    add("order", "order by depth against by pixel", fine, by_peak);
    // Every fourth pixel of every fourth row, since rays are slow.
    constexpr int stride = 4;
    const Pinhole<double> sparse = every_pixel(camera, stride);
    const auto order = depth_order(g, camera);
    const auto rays = oracle(g, sparse, background, order, physical_model).feature.pixels;
    OracleModel in_depth_order = physical_model;
    in_depth_order.order = BlendOrder::by_centre;
    const auto sorted = oracle(g, sparse, background, order, in_depth_order).feature.pixels;
    const auto sharp = oracle(g, camera, background, order, {.dilation = 0});
    add("model", "projection, no dilation, against rays",
        strided(sharp.feature.pixels, s.camera.width, stride), sorted);
    add("model", "dilation .3 against none", fine, sharp.feature.pixels);
    add("model", "rays in order of depth against by pixel", sorted, rays);
    add("model", "Exact64 against the physical truth", strided(fine, s.camera.width, stride), rays);
}

} // namespace

std::vector<PriceRow> price_list(const Settings& settings) {
    std::vector<Scenery> scenes = accuracy_scenes();
    if (!settings.ply.empty()) scenes.push_back(ply_scene(settings.ply));
    std::vector<Policy> policies;
    for (const auto& some : {exact_policies(), preset_policies(), rule_policies(),
                             degree_policies(), scalar_policies()})
        policies.insert(policies.end(), some.begin(), some.end());
    std::vector<PriceRow> rows;
    std::map<std::string, std::pair<double, double>> total; // times over all scenes
    for (const Scenery& s : scenes) {
        Gaussians<double> g;
        convert_fields(g, s.gaussians, [](float x) { return static_cast<double>(x); });
        const Pinhole<double> camera = s.camera.cast<double>();
        const VecX<double> background = s.background.cast<double>();
        const auto order = depth_order(s.gaussians, s.camera);
        const Index pixels = Index(s.camera.width) * s.camera.height;
        const Columns<float> w = weights(3, pixels, 0), wa = weights(1, pixels, 200);
        // The order of depths in double may differ; each pixel's own order rarely does.
        const auto fine_order = depth_order(g, camera);
        const OracleModel own_order{.order = BlendOrder::by_peak};
        const OracleCotangent cotangent{w.cast<double>(), wa.cast<double>()};
        std::map<Truth, std::pair<Columns<double>, Gaussians<double>>> truths;
        truths[Truth::float_depths] = {oracle(g, camera, background, order).feature.pixels,
                                       oracle_vjp({g, camera, order, {}}, background, cotangent)};
        truths[Truth::double_depths] =
            fine_order == order
                ? truths[Truth::float_depths]
                : std::pair{oracle(g, camera, background, fine_order).feature.pixels,
                            oracle_vjp({g, camera, fine_order, {}}, background, cotangent)};
        truths[Truth::by_peak] = {oracle(g, camera, background, order, own_order).feature.pixels,
                                  oracle_vjp({g, camera, order, own_order}, background, cotangent)};

        std::vector<Runner> runners;
        for (const Policy& p : policies) runners.push_back(p.bind(s, w, wa));
        std::vector<double> forward(runners.size(), INFINITY), backward(runners.size(), INFINITY);
        for (int r = 0; r < settings.repeats; ++r) // interleaved
            for (std::size_t i = 0; i < runners.size(); ++i) {
                const double a = seconds();
                runners[i].forward();
                const double b = seconds();
                runners[i].backward();
                const double c = seconds();
                forward[i] = std::min(forward[i], b - a);
                backward[i] = std::min(backward[i], c - b);
            }
        for (std::size_t i = 0; i < runners.size(); ++i) {
            const auto& [truth, truth_g] = truths[policies[i].truth];
            const ImageError e = image_error(runners[i].feature(), truth);
            GroupError worst;
            for (const GroupError& group :
                 gradient_errors(runners[i].gradient(), truth_g)) {
                worst.relative = std::max(worst.relative, group.relative);
                worst.cosine = std::min(worst.cosine, group.cosine);
                worst.worst = std::max(worst.worst, group.worst);
                if (s.name == "head" && policies[i].name == "Exact32")
                    std::printf(
                        "head, Exact32, gradient of %-8s relative %.1e, 1 - cosine %.1e, "
                        "worst entry %.1e\n",
                        group.name.c_str(), group.relative, 1 - group.cosine, group.worst);
            }
            rows.push_back({policies[i].group, policies[i].name, s.name, e.largest, e.rms, e.psnr(),
                            worst.relative, worst.cosine, worst.worst, forward[i] / forward[0],
                            (forward[i] + backward[i]) / (forward[0] + backward[0])});
            total[policies[i].name].first += forward[i];
            total[policies[i].name].second += forward[i] + backward[i];
        }
        add_models(s, truths[Truth::float_depths].first, truths[Truth::double_depths].first,
                   truths[Truth::by_peak].first, rows);
        std::printf("%s done\n", s.name.c_str());
        std::fflush(stdout);
    }
    // The worst over all scenes, with the time over all scenes.
    std::vector<PriceRow> worst;
    for (const PriceRow& r : rows) {
        auto w = std::find_if(worst.begin(), worst.end(),
                              [&](const PriceRow& x) { return x.name == r.name; });
        if (w == worst.end()) {
            w = worst.insert(worst.end(), r);
            w->scene = "worst of all";
            const auto& base = total["Exact32"];
            if (total.count(r.name) != 0) {
                w->forward = total[r.name].first / base.first;
                w->both = total[r.name].second / base.second;
            }
        }
        w->largest = std::max(w->largest, r.largest);
        w->rms = std::max(w->rms, r.rms);
        w->psnr = std::min(w->psnr, r.psnr);
        w->g_relative = std::fmax(w->g_relative, r.g_relative);
        w->g_cosine = std::fmin(w->g_cosine, r.g_cosine);
        w->g_worst = std::fmax(w->g_worst, r.g_worst);
    }
    rows.insert(rows.end(), worst.begin(), worst.end());
    return rows;
}

} // namespace rye::bench
