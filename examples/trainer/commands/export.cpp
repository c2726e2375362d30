// SPDX-License-Identifier: Apache-2.0
/// `rye export`: the Gaussians of a trained head as a file for splat viewers: PLY, .splat, SPZ, GLB
/// or USDA, by the name's extension. These formats have no upsampler: colours are those of the
/// low-resolution render. Beside it, bases for a viewer that moves its Gaussians.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <iostream>
#include <memory>

#include <CLI/CLI.hpp>

#include <rye/io/atomic_file.hpp>
#include <rye/io/splats.hpp>
#include <rye/math/harmonics.hpp>
#include <rye/math/rotation.hpp>
#include <rye/math/scalar.hpp>

#include "commands/commands.hpp"
#include "commands/export_avatar.hpp"
#include "commands/lights_option.hpp"
#include "commands/options.hpp"
#include "data/deflate.hpp"
#include "data/degrees.hpp"
#include "data/driver_table.hpp"
#include "data/memory_limit.hpp"
#include "data/out_format.hpp"
#include "data/threads.hpp"
#include "data/zstd.hpp"
#include "drawing/linear_bases.hpp"
#include "drawing/playable.hpp"
#include "drawing/shown.hpp"

namespace rye::trainer {
namespace {

struct ExportOptions {
    std::filesystem::path run, capture, out, bases;
    AvatarExportOptions avatar;
    std::string frame, stream = "both", axes = "ply";
    std::vector<std::string> expression; ///< NAME=VALUE
    std::vector<double> left, right;  ///< pitch, yaw [deg]
    std::vector<double> sweep;        ///< radius [deg], time codes; empty: none
    bool canonical = false;
    int sh = 0;
    int spz_version = 3;
    int threads = 0;
};

/// Value of the constant harmonic: rgb = 0.5 + C0 f_dc.
constexpr float sh_constant_value = 0.28209479177387814f;

/// Returns the stored form of activated Gaussians; `flip` rotates y up, z toward the viewer into
/// the PLY's y down, z forward (half a turn about x). Harmonics up to `degree` are 0.
GaussianCloud<float> cloud_of(const Gaussians<float>& g, bool flip, int degree) {
    GaussianCloud<float> c;
    c.mean = g.mean;
    c.rotation = g.rotation;
    if (flip) {
        c.mean.bottomRows(2) *= -1.0f;
        for (Index i = 0; i < c.rotation.cols(); ++i)
            c.rotation.col(i) = quat_product<float>(Quat<float>(0, 1, 0, 0), g.rotation.col(i));
    }
    for (Index i = 0; i < c.rotation.cols(); ++i)
        c.rotation.col(i) = quat_normalized<float>(c.rotation.col(i));
    c.log_scale = g.scale.unaryExpr([](float s) { return std::log(std::max(s, 1e-9f)); });
    // Clamped, so that opaque and invisible Gaussians stay finite: float has 24 bits.
    c.logit_opacity = g.opacity.unaryExpr(
        [](float a) { return logit(std::clamp(a, 6e-8f, 1 - 6e-8f)); });
    c.sh_constant = (g.feature.topRows(3).array() - 0.5f) / sh_constant_value;
    c.sh_rest.setZero(3 * (sh_count(degree) - 1), g.mean.cols());
    return c;
}

/// Returns the options. Throws an Error for a combination of --out and --axes that would be upside
/// down: SPZ, GLB and USDA state their axes, unlike PLY and .splat; and for an option of another
/// format. A pipe or device gets a PLY.
SplatFileOptions file_options(const ExportOptions& o) {
    SplatFileOptions options;
    std::error_code none;
    const bool pipe =
        std::filesystem::exists(o.out, none) && !std::filesystem::is_regular_file(o.out, none);
    if (!pipe) options.kind = written_splat_kind(o.out, "rye export: --out", ".avatar");
    require(o.axes == "ply" || options.kind == SplatKind::ply || options.kind == SplatKind::splat,
            "rye export", "--axes world: the format of ", o.out.string(),
            " has axes of its own (y up, z toward the viewer), expected a .ply or .splat");
    require(o.sh == 0 || options.kind != SplatKind::splat, "rye export", "--sh ", o.sh,
            ": a .splat has no harmonics, expected 0");
    require(o.spz_version == 3 || options.kind == SplatKind::spz, "rye export", "--spz-version ",
            o.spz_version, ": ", o.out.string(), " is no .spz");
    require(o.sweep.empty() || options.kind == SplatKind::usda, "rye export", "--gaze-sweep: ",
            o.out.string(), " holds one moment, expected a .usda");
    if (o.spz_version == 4) options.kind = SplatKind::spz4;
    options.zstd = zstd_compressor();
    options.ply.degree = o.sh;
    options.ply.comment = o.axes == "ply" ? "Vertical axis: y" : "axes: y up, z toward the viewer";
    options.deflate = zlib_deflate;
    return options;
}

/// Returns the largest differences by the file's rounding; empty for formats that store floats.
std::string rounding(const GaussianCloud<float>& cloud, const Bytes& bytes, SplatKind kind) {
    const bool spz = kind == SplatKind::spz || kind == SplatKind::spz4;
    if (kind != SplatKind::splat && !spz) return "";
    const std::string who = "rye export";
    const ZstdDecompress zstd = zstd_decompressor();
    const GaussianCloud<float> read =
        spz ? parse_spz<float>(bytes, who, memory_limit(), zstd ? zstd : read_stored_zstd)
            : parse_splat<float>(bytes, who);
    const auto worst = [](const Columns<float>& a, const Columns<float>& b) {
        return a.size() == 0 ? 0.0 : static_cast<double>((a - b).cwiseAbs().maxCoeff());
    };
    const auto changed =
        ((cloud.sh_constant - read.sh_constant).cwiseAbs().array() > 0.5f / 127 / sh_constant_value)
            .colwise()
            .any()
            .count();
    std::array<char, 200> text;
    std::snprintf(
        text.data(), text.size(),
        "rounded: position by at most %.2g, log scale %.2g, colour %.2g; %td Gaussians "
        "have colours beyond the format's and are clamped\n",
        worst(cloud.mean, read.mean), worst(cloud.log_scale, read.log_scale),
        worst(cloud.sh_constant, read.sh_constant) * static_cast<double>(sh_constant_value),
        changed);
    return text.data();
}

/// Returns drivers of each time code: both eyes on a circle about their gazes, from the subject's
/// left over up and right; those given where no sweep is asked for.
std::vector<Drivers<float>> swept(const Drivers<float>& drivers, const std::vector<double>& sweep) {
    if (sweep.empty()) return {drivers};
    constexpr double widest = 45, most = 1000;
    require(sweep.size() == 2 && sweep[0] > 0 && sweep[0] <= widest && sweep[1] >= 2 &&
                sweep[1] <= most && sweep[1] == std::floor(sweep[1]),
            "--gaze-sweep", "expected RADIUS,FRAMES: degrees above 0 to ", widest,
            ", and a whole number of 2 to ", most);
    std::vector<Drivers<float>> all;
    for (double k = 0; k < sweep[1]; ++k) {
        const double angle = 360 * degree * k / sweep[1];
        all.push_back(drivers);
        for (std::size_t eye = 0; eye < 2; ++eye) {
            const Vec2<double> from = pitch_yaw(Vec3<double>(drivers.gaze[eye].cast<double>()));
            all.back().gaze[eye] =
                gaze_vector(from[0] + sweep[0] * degree * std::sin(angle),
                            from[1] + sweep[0] * degree * std::cos(angle))
                    .cast<float>();
        }
    }
    return all;
}

/// Returns the drivers with coefficients, NAME=VALUE, in their place. Throws an Error for a word
/// of another form, an unknown name or a value that is no number.
Drivers<float> expressed(const Drivers<float>& drivers, const std::vector<std::string>& words,
                         const std::vector<std::string>& names) {
    if (words.empty()) return drivers;
    const std::string who = "--expression";
    std::string header, values;
    for (const std::string& word : words) {
        const std::size_t at = word.find('=');
        require(at != std::string::npos, who, "got '", word, "', expected NAME=VALUE");
        header += (header.empty() ? "" : ",") + word.substr(0, at);
        values += (values.empty() ? "" : ",") + word.substr(at + 1);
    }
    const DriverNames known{static_cast<int>(drivers.expression.size()), names};
    return parse_drivers(header + "\n" + values + "\n", who, known, drivers).front();
}

/// Throws an Error for --bases with options that leave no one splat file for them.
void check_bases_option(const ExportOptions& o) {
    if (o.bases.empty()) return;
    require(extension_of(o.bases) == ".safetensors", "rye export", "--bases: got the name ",
            o.bases.string(), ", expected one that ends in .safetensors");
    require(extension_of(o.out) != ".avatar", "rye export", "--bases: ", o.out.string(),
            " moves by itself, expected a splat file");
    require(o.sweep.empty() && o.stream == "both", "rye export",
            "--bases: got --gaze-sweep or --stream, expected all Gaussians of one moment");
}

/// Writes the bases of the splat file that these drivers make, and prints their size.
void export_bases(const ExportOptions& o, const TrainState& state, const Capture& capture,
                  const Drivers<float>& rest, bool half_turn) {
    const DriverRanges<float> ranges = driver_ranges(capture, state.config.gaze_axis, rest);
    const SplatBases b =
        linear_bases({state, rest, ranges, capture.expression_names, half_turn});
    write_bases(o.bases, b);
    const double share = static_cast<double>(b.index.size()) /
                         static_cast<double>(std::max<std::size_t>(1, b.bases.size())) /
                         static_cast<double>(b.gaussians);
    std::printf("%s: %zu bases, each of %.1f %% of the Gaussians, %ju bytes\n", o.bases.c_str(),
                b.bases.size(), 100 * share,
                static_cast<std::uintmax_t>(std::filesystem::file_size(o.bases)));
}

void export_splats(const ExportOptions& o) {
    set_threads(o.threads);
    check_bases_option(o);
    if (extension_of(o.out) == ".avatar")
        return export_avatar({o.run, o.capture, o.out, o.frame, o.avatar.camera,
                              o.avatar.full_precision, o.avatar.lights});
    require(o.avatar.lights.empty(), "rye export",
            "--lights: a splat file has no highlights, "
            "expected an .avatar");
    const SplatFileOptions options = file_options(o);
    const TrainState state = load_trained(o.run);
    Drivers<float> drivers;
    Capture capture;
    if (!o.canonical || !o.bases.empty() || !o.expression.empty())
        capture = driving_capture(o.run, state, o.capture);
    if (o.canonical)
        drivers = neutral_drivers<float>(state.config.avatar);
    else
        drivers = frame_drivers(capture, frame_index(capture, o.frame), state.config.gaze_axis);
    drivers = expressed(drivers, o.expression, capture.expression_names);
    if (!o.left.empty()) drivers.gaze[0] = gaze_option(o.left, "--gaze-left");
    if (!o.right.empty()) drivers.gaze[1] = gaze_option(o.right, "--gaze-right");
    if (state.avatar.has_view_color())
        std::cout << o.run.string()
                  << ": view_color is left out, a splat file has the head from everywhere alike\n";
    const Index face = state.avatar.face.position.cols();
    std::vector<GaussianCloud<float>> frames;
    const std::vector<Drivers<float>> sweep = swept(drivers, o.sweep);
    for (const Drivers<float>& moment : sweep) {
        Gaussians<float> g = driven_gaussians(state, moment);
        if (o.stream == "face") g = copy_of(view_of(g).columns(0, face));
        if (o.stream == "eyes") g = copy_of(view_of(g).columns(face, g.count() - face));
        // A number takes up to 12 bytes of text, twice while the text grows.
        require_memory(saturated_product(static_cast<std::uint64_t>(g.count()), 24 * 14 * sweep.size()),
                       memory_limit(), o.out.string(), std::to_string(sweep.size()) + " frames");
        frames.push_back(cloud_of(g, o.axes == "ply", o.sh));
    }
    const GaussianCloud<float>& cloud = frames.front();
    const std::string text =
        options.kind == SplatKind::usda
            ? usda_text(std::span<const GaussianCloud<float>>(frames)) : std::string();
    const Bytes bytes = text.empty() ? splat_file_bytes(cloud, options) : Bytes();
    const ByteSpan content = text.empty() ? ByteSpan(bytes) : as_bytes(text);
    write_atomic(o.out, content);
    std::cout << o.out.string() << ": " << cloud.count() << " Gaussians, " << content.size()
              << " bytes\n" << rounding(cloud, bytes, options.kind) << std::flush;
    if (o.bases.empty()) return;
    const bool ply = options.kind == SplatKind::ply || options.kind == SplatKind::splat;
    export_bases(o, state, capture, drivers, ply && o.axes == "ply");
}

} // namespace

void add_export(CLI::App& app) {
    auto o = std::make_shared<ExportOptions>();
    CLI::App* c = app.add_subcommand("export", "Write a trained head as a splat file, or as a whole "
                                               "avatar");
    c->add_option("--run", o->run, "Folder of the run")
        ->required()
        ->check(folder_check("the folder of a run with its checkpoint"));
    c->add_option("--capture", o->capture,
                  "Folder of a capture whose frames drive (default: the run's own)");
    c->add_option("--frame", o->frame, "Frame that drives the head (default: the first test frame)");
    c->add_flag("--canonical", o->canonical, "Neutral expression, no head pose, eyes ahead, instead");
    c->add_option("--expression", o->expression,
                  "Coefficients in place of the frame's: NAME=VALUE,..., by the capture's names or "
                  "expression_0 to ...")
        ->delimiter(',');
    c->add_option("--gaze-left", o->left, "Subject's left eye: PITCH,YAW in degrees")->delimiter(',');
    c->add_option("--gaze-right", o->right, "Subject's right eye: PITCH,YAW in degrees")->delimiter(',');
    c->add_option("--gaze-sweep", o->sweep,
                  "NAME.usda: RADIUS,FRAMES: both eyes once round a circle of RADIUS degrees about "
                  "their gazes, in FRAMES time codes")
        ->delimiter(',');
    c->add_option("--stream", o->stream, "Which Gaussians")
        ->check(CLI::IsMember({"both", "face", "eyes"}))
        ->capture_default_str();
    c->add_option("--axes", o->axes, "ply: y down, z forward, as viewers expect; world: the capture's")
        ->check(CLI::IsMember({"ply", "world"}))
        ->capture_default_str();
    c->add_option("--sh", o->sh, "Degree of harmonics to pad with zeros, for readers that want 3")
        ->check(from_to(0, 3))
        ->capture_default_str();
    c->add_option("--spz-version", o->spz_version, "NAME.spz: 3, or 4, which fewer viewers read")
        ->check(from_to(3, 4))
        ->capture_default_str();
    c->add_option("--bases", o->bases,
                  "File to write beside --out, NAME.safetensors: how its Gaussians change with "
                  "each coefficient and gaze, for viewers that add such changes");
    c->add_option("--camera", o->avatar.camera,
                  "NAME.avatar: its default camera (default: the most frontal)");
    c->add_flag("--full-precision", o->avatar.full_precision,
                "NAME.avatar: 32 bits a number instead of 16 where that costs nothing visible");
    add_lights(*c, o->avatar.lights);
    c->add_option("--out,--ply", o->out,
                  "File to write: .ply, .splat, .spz, .glb, .usda, or .avatar, the whole avatar")
        ->required();
    add_memory(*c);
    add_threads(*c, o->threads);
    c->callback([o] { export_splats(*o); });
}

} // namespace rye::trainer
