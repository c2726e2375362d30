// SPDX-License-Identifier: Apache-2.0
// Every writer and reader of files in the headers, in a host program whose locale writes 1234.5 as
// 1.234,5: the same bytes, the same numbers read, the same messages.
#include <fstream>
#include <map>
#include <sstream>
#include <string>

#include <doctest/doctest.h>

#include <rye/io/avatar_file.hpp>
#include <rye/io/npz.hpp>
#include <rye/io/splats.hpp>
#include <rye/core/random.hpp>

#include "../support/hostile.hpp"
#include "../support/locales.hpp"
#include "../support/tiny_playable.hpp"

using namespace rye;
using namespace rye::test;

namespace {

/// More Gaussians than are written without a separator.
GaussianCloud<float> cloud() {
    GaussianCloud<float> c(1234, 1);
    std::uint64_t k = 0;
    GaussianCloud<float>::fields(
        [&](const std::string&, Columns<float>& a) {
            for (Index i = 0; i < a.size(); ++i)
                a.data()[i] = static_cast<float>(Random{3, 1}.normal(k++));
        },
        c);
    return c;
}

Bytes bytes_of(const std::string& text) {
    const ByteSpan span = as_bytes(text);
    return {span.begin(), span.end()};
}

/// The bytes of a file of each kind.
std::map<std::string, Bytes> written(const std::filesystem::path& folder) {
    std::map<std::string, Bytes> files;
    const GaussianCloud<float> c = cloud();
    for (const SplatKind kind :
         {SplatKind::ply, SplatKind::splat, SplatKind::spz, SplatKind::glb}) {
        SplatFileOptions options;
        options.kind = kind;
        files["splats " + std::to_string(static_cast<int>(kind))] = splat_file_bytes(c, options);
    }
    std::ostringstream stream;
    stream.width(20);
    stream.fill('*');
    stream.setf(std::ios::showpos | std::ios::hex);
    write_ply(stream, c, {.degree = 3, .comment = "1,5 of 1.234"});
    files["ply to a stream"] = bytes_of(stream.str());
    {
        std::ofstream file(folder / "c.ply", std::ios::binary);
        write_ply(file, c);
    }
    files["ply to a file"] = read_file(folder / "c.ply");
    PlayableAvatar<float> p = tiny_playable(true);
    p.config.gaze_near = 0.02;
    p.config.exp_far = 12345.678;
    p.config.deform_scale = 0.1;
    write_avatar(folder / "a.avatar", p);
    files["avatar"] = read_file(folder / "a.avatar");
    write_safetensors(folder / "t",
                      {tensor_entry("mean", c.mean), tensor_entry("scale", c.log_scale)},
                      {{"count", "1234"}});
    files["safetensors"] = read_file(folder / "t");
    write_npy(folder / "n.npy", npy_array<float>(c.mean));
    files["npy"] = read_file(folder / "n.npy");
    write_npz(folder / "n.npz", {{"mean", npy_array<float>(c.mean)}});
    files["npz"] = read_file(folder / "n.npz");
    files["settings"] = bytes_of(detail::settings_text({p.config, p.avatar.upsampler.shape}));
    return files;
}

/// The message of reading something wrong.
template <class F>
std::string said(F&& f) {
    try {
        f();
    } catch (const Error& e) {
        return e.what();
    }
    return "nothing";
}

/// Whatever the readers make of the files, as one row of bytes.
Bytes read_back(const std::map<std::string, Bytes>& files, const std::filesystem::path& folder) {
    Bytes all;
    const auto add = [&](const auto& a) {
        for (Index i = 0; i < a.size(); ++i) append(all, static_cast<double>(a(i)));
    };
    const auto add_cloud = [&](const GaussianCloud<float>& c) {
        GaussianCloud<float>::fields(
            [&](const std::string&, const Columns<float>& a) { add(a.reshaped()); }, c);
    };
    const auto file = [&](const std::string& name, const Bytes& bytes) {
        write_atomic(folder / name, bytes, Durability::atomic_only);
        return folder / name;
    };
    add_cloud(read_splats<float>(file("a.ply", files.at("ply to a file"))));
    std::istringstream stream{std::string(as_text(files.at("ply to a stream")))};
    add_cloud(read_ply<float>(stream, "stream"));
    add_cloud(read_splats<float>(file("A.SPLAT", files.at("splats 1"))));
    add_cloud(read_splats<float>(file("a.spz", files.at("splats 2"))));
    std::string text = "ply\nformat ascii 1.0\nelement vertex 2\n";
    for (const char* name : {"x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0",
                             "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"})
        text += std::string("property float ") + name + "\n";
    text += "end_header\n";
    for (int i = 0; i < 2; ++i) text += "1.5 -1234.25 1e3 .5 0 0 1 -3.125 -3 -3 1 0 0 0\n";
    std::istringstream ascii(text);
    add_cloud(read_ply<float>(ascii, "ascii"));
    const PlayableAvatar<float> p =
        parse_avatar<float>(files.at("avatar"), "a.avatar");
    add(p.avatar.face.position.reshaped());
    for (const double x : {p.config.gaze_near, p.config.exp_far, p.config.deform_scale})
        append(all, x);
    const Safetensors tensors = parse_safetensors(files.at("safetensors"), "t");
    add(tensors.columns<float>("mean", 3, 1234).reshaped());
    for (const float x : parse_npy(files.at("npy"), "n").values<float>("n")) append(all, x);
    for (const float x : parse_npz(files.at("npz"), "n").at("mean").values<float>("n"))
        append(all, x);
    const JsonValue json = parse_json("[1234.5, -0.125, 1234567]", "j");
    append(all, *json.get<JsonArray>()->at(0).get<double>());
    append(all, *json.get<JsonArray>()->at(1).get<double>());
    append(all, *json.get<JsonArray>()->at(2).get<std::int64_t>());
    append(all, as_bytes(said([] { parse_json("[1234,5", "j"); })));
    append(all, as_bytes(said([&] { parse_splat<float>(Bytes(1234567), "s.splat"); })));
    append(all, as_bytes(said([&] {
               GaussianCloud<float> far = cloud();
               far.mean(0, 0) = 12345678.5F;
               spz_bytes(far);
           })));
    return all;
}

void check_same(const std::map<std::string, Bytes>& expected, const Bytes& numbers) {
    const TemporaryFolder folder;
    const auto files = written(folder.path);
    for (const auto& file : expected) {
        INFO(file.first);
        CHECK(files.at(file.first) == file.second);
    }
    CHECK(read_back(expected, folder.path) == numbers);
}

} // namespace

TEST_CASE("locale: no file, number or message depends on that of the host program") {
    const TemporaryFolder folder;
    const auto files = written(folder.path);
    const Bytes numbers = read_back(files, folder.path);
    CHECK(as_text(files.at("settings")).find("\"deform_scale\":0.1,") != std::string_view::npos);
    {
        const GroupingLocale grouping;
        std::ostringstream shows;
        shows << 1234.5;
        REQUIRE(shows.str() == "1.234,5");
        check_same(files, numbers);
    }
    {
        const GermanLocale german;
        if (!german.set()) return;
        char text[16];
        std::snprintf(text, sizeof text, "%.1f", 1.5);
        REQUIRE(std::string(text) == "1,5");
        check_same(files, numbers);
    }
}
