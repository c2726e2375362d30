// SPDX-License-Identifier: Apache-2.0
/// seeds FOLDER: writes initial inputs of the fuzz targets, made by the project's own writers, to
/// FOLDER/<target>/, and dictionaries to FOLDER/<target>.dict.
#include <fstream>
#include <iostream>
#include <sstream>

#include <rye/io/avatar_file.hpp>
#include <rye/io/lpips_weights.hpp>
#include <rye/io/npz.hpp>
#include <rye/io/safetensors.hpp>
#include <rye/io/splat_bases.hpp>
#include <rye/io/splats.hpp>

#include "data/config.hpp"
#include "data/driver_table.hpp"
#include "data/experiments.hpp"
#include "data/picture_codecs.hpp"
#include "data/run_frames.hpp"

#include "../io/avatar_version_1.hpp"
#include "../programs/tiny_run.hpp"
#include "../support/tiny_playable.hpp"

namespace {

namespace fs = std::filesystem;
using namespace rye;

fs::path out;

void seed(const std::string& target, const std::string& name, ByteSpan bytes) {
    fs::create_directories(out / target);
    write_atomic(out / target / name, bytes, Durability::atomic_only);
}
void seed(const std::string& target, const std::string& name, const std::string& text) {
    seed(target, name, as_bytes(text));
}

/// libFuzzer's own quotes: bytes in hexadecimal.
void dictionary(const std::string& target, const std::vector<std::string>& words) {
    constexpr std::string_view hex = "0123456789abcdef";
    std::ofstream file(out / (target + ".dict"));
    for (const std::string& word : words) {
        file << '"';
        for (const char c : word) {
            const auto u = static_cast<unsigned char>(c);
            file << "\\x" << hex[u >> 4U] << hex[u & 15U];
        }
        file << "\"\n";
    }
}

void ply() {
    for (const int degree : {0, 1, 3}) {
        GaussianCloud<float> cloud(3, degree);
        GaussianCloud<float>::fields(
            [](const std::string&, Columns<float>& a) { a.setConstant(0.5F); }, cloud);
        std::ostringstream text;
        write_ply(text, cloud);
        seed("ply", "degree" + std::to_string(degree), text.str());
    }
    std::string ascii = "ply\nformat ascii 1.0\nelement camera 1\nproperty int a\nelement vertex 1\n";
    std::vector<std::string> words{"ply\n", "format ascii 1.0\n", "format binary_little_endian 1.0\n",
                                   "element vertex ", "element foo ", "property list uchar int v\n",
                                   "end_header\n", "comment ", "549755813888", "1e300", "nan"};
    for (const char* name : {"x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0",
                             "scale_1", "rot_0", "rot_1", "rot_2", "rot_3"}) {
        words.push_back("property float " + std::string(name) + "\n");
        ascii += words.back();
    }
    for (const char* type : {"char", "uint8", "short", "ushort", "int", "uint", "double"})
        words.push_back(type);
    seed("ply", "ascii", ascii + "end_header\n7\n1 2 3 .1 .2 .3 -1 -2 -3 1 0 0 0\n");
    dictionary("ply", words);
}

void splats() {
    for (const int degree : {0, 3}) {
        GaussianCloud<float> cloud(3, degree);
        GaussianCloud<float>::fields(
            [](const std::string&, Columns<float>& a) { a.setConstant(0.5F); }, cloud);
        const std::string name = std::to_string(degree);
        const Bytes spz = spz_bytes(cloud);
        seed("splats", "splat" + name, splat_bytes(cloud));
        seed("splats", "spz" + name, spz);
        seed("splats", "data" + name, gunzip(spz, name));
        seed("splats", "four" + name, spz4_bytes(cloud));
        seed("gltf", "glb" + name, glb_bytes(cloud));
    }
    seed("gltf", "text",
         R"({"asset":{"version":"2.0"},"scenes":[{"nodes":[0]}],"nodes":[{"children":[1],"scale":[2,2,2]},)"
         R"({"mesh":0,"rotation":[0,0,0.6,0.8],"translation":[1,2,3]}],"meshes":[{"primitives":[{"mode":0,)"
         R"("attributes":{"POSITION":0,"KHR_gaussian_splatting:ROTATION":1,"KHR_gaussian_splatting:SCALE":2,)"
         R"("KHR_gaussian_splatting:OPACITY":3,"KHR_gaussian_splatting:SH_DEGREE_0_COEF_0":0},"extensions":{)"
         R"("KHR_gaussian_splatting":{"kernel":"ellipse","colorSpace":"srgb_rec709_display"}}}]}],"accessors":[)"
         R"({"bufferView":0,"componentType":5126,"count":1,"type":"VEC3"},)"
         R"({"bufferView":1,"componentType":5120,"normalized":true,"count":1,"type":"VEC4"},)"
         R"({"bufferView":0,"byteOffset":4,"componentType":5121,"count":1,"type":"VEC3"},)"
         R"({"bufferView":0,"componentType":5123,"normalized":true,"count":1,"type":"SCALAR"}],"bufferViews":[)"
         R"({"buffer":0,"byteLength":12,"byteStride":12},{"buffer":1,"byteLength":4}],"buffers":[{"byteLength":12,)"
         R"("uri":"a.bin"},{"byteLength":4,"uri":"data:;base64,AAAAfw=="}]})");
    dictionary("gltf", {"\"matrix\":[", "\"sparse\":{}", "\"extensionsRequired\":[", "5120", "5121", "5122",
                        "5123", "5126", "KHR_mesh_quantization", "SH_DEGREE_1_COEF_0", "\"children\":[",
                        "1e300", "\"byteStride\":", "%20", "\"normalized\":true"});
    dictionary("splats", {"NGSP", {'\x1F', '\x8B', '\x08', '\0'}, {'\3', '\0', '\0', '\0'}});
}

void arrays() {
    NpzArrays all;
    const auto add = [&](const std::string& name, const NpyArray& array) {
        all[name] = array;
        seed("npy", name, npy_bytes(array));
    };
    add("points", npy_array(Columns<float>(Columns<float>::Constant(3, 5, 0.25F))));
    add("pose", npy_array(Columns<double>(Columns<double>::Constant(6, 1, -1.5))));
    const std::vector<std::int64_t> counts{1, -2, 3};
    add("counts", npy_array<std::int64_t>({3, 1, 1}, counts));
    add("none", npy_array<std::int64_t>({0, 3}, {}));
    std::string fortran(as_text(npy_bytes(all["points"])));
    fortran.replace(fortran.find("False, "), 7, "True,  ");
    fortran.replace(fortran.find('<'), 1, ">");
    seed("npy", "fortran", fortran);
    dictionary("npy", {"'descr': ", "'fortran_order': ", "'shape': ", "True", "False", "'>f8'",
                       "'|b1'", "'<u2'", "4611686018427387904, ", "(0, ", "{", "}"});
    seed("npz", "stored", npz_bytes(all));
    // Raw deflate from a PNG: without the header and the checksum of zlib's stream.
    for (const int side : {4, 64}) {
        trainer::Image8 image{side, side, 1, {}};
        for (int i = 0; i < side * side; ++i)
            image.values.push_back(static_cast<std::uint8_t>(i * i / 7));
        const Bytes png = trainer::encode_png(image, "seed");
        const std::size_t data = as_text(png).find("IDAT") + 6, end = as_text(png).find("IEND") - 12;
        Bytes deflated;
        append(deflated, static_cast<std::uint32_t>((side + 1) * side));
        append(deflated, ByteSpan(png).subspan(data, end - data));
        seed("npz", "deflate" + std::to_string(side), deflated);
    }
    dictionary("npz", {"PK\x03\x04", "PK\x01\x02", "PK\x05\x06", "PK\x06\x06", "PK\x06\x07", ".npy"});
    const Columns<float> weight = Columns<float>::Constant(3, 2, 1);
    const Columns<double> moment = Columns<double>::Constant(2, 1, 2);
    const std::vector<std::uint8_t> flags{1, 0, 255};
    write_safetensors(out / "tensors",
                      {tensor_entry("w", weight), tensor_entry("m", moment),
                       tensor_entry<std::int64_t>("step", {3}, counts),
                       tensor_entry<std::uint8_t>("flags", {3}, flags)},
                      {{"format", "rye"}, {"words", "\"quoted\""}});
    seed("safetensors", "four", read_file(out / "tensors"));
    fs::remove(out / "tensors");
    dictionary("safetensors", {"__metadata__", "dtype", "shape", "data_offsets", "F32", "F64", "I64",
                               "U8", "[0,0]", "4294967296", "\\u00e9", "\\ud83d\\ude00"});
}

void bases() {
    SplatBases b;
    b.gaussians = 3;
    b.bases = {{"jawOpen", 0, 1}, {"gaze_left_yaw", 0, -25}};
    b.begin = {0, 2, 3};
    b.index = {0, 2, 1};
    b.change = Columns<Eigen::half>::Zero(basis_numbers, 3);
    b.eyes[0] = {1, 1, Vec3<double>(0.5, 0, 1), {1, 2}, {0, 5}};
    b.eyes[1] = {2, 1, Vec3<double>(-0.5, 0, 1), {1, 2}, {0, -5}};
    write_bases(out / "bases_file", b);
    seed("bases", "two", read_file(out / "bases_file"));
    fs::remove(out / "bases_file");
    dictionary("bases", {"checksum", "rye-bases", "gaussians", "driver", "rest", "at", "eyes", "first",
                         "count", "centre", "kappa", "head", "begin", "index", "change", "U32", "F16"});
}

void avatars() {
    const auto avatar = [](const char* name, const test::TinyParts& parts) {
        write_avatar(out / "avatar_file", test::tiny_playable(parts),
                     parts.visual ? AvatarPrecision::full : AvatarPrecision::half);
        seed("avatar", name, read_file(out / "avatar_file"));
    };
    avatar("optical", {});
    avatar("visual", {.visual = true});
    avatar("whole", {.visual = true, .light = true, .driven_eyes = true});
    avatar("lit", {.light = true, .driven_eyes = true});
    seed("avatar", "version_1", test::avatar_version_1());
    fs::remove(out / "avatar_file");
    dictionary("avatar", {"checksum", "settings", "rye-avatar", "F16", "F32", "F64", "I64", "[0,0]",
                          "feature", "channels", "upsampler_doublings", "left_eye_points", "kappa",
                          "eye_appearance", "driven", "shading", "head_pose", "visual"});
}

void pictures() {
    std::vector<std::string> words{"IHDR", "PLTE", "tRNS", "IDAT", "IEND", "gAMA", "iCCP", "zTXt"};
    for (const int marker : {0xC0, 0xC1, 0xC2, 0xC4, 0xD8, 0xD9, 0xDA, 0xDB, 0xDD, 0xE0, 0xEE})
        words.push_back({'\xFF', static_cast<char>(marker)});
    dictionary("picture", words);
    for (const int channels : {1, 2, 3, 4}) {
        trainer::Image8 image{19, 11, channels, {}};
        for (int i = 0; i < 19 * 11 * channels; ++i)
            image.values.push_back(static_cast<std::uint8_t>(i * 37 + i / 11));
        const std::string name = std::to_string(channels);
        seed("picture", "png" + name, trainer::encode_png(image, name));
        if (channels % 2 == 0) continue;
        for (const int quality : {30, 95})
            seed("picture", "jpeg" + name + "-" + std::to_string(quality),
                 trainer::encode_jpeg(image, quality, name));
    }
}

void texts() {
    std::vector<std::string> words;
    for (const std::string& name : trainer::preset_names()) {
        const auto json = trainer::to_json(trainer::preset(name));
        seed("config", name, json.dump());
        const auto each = [&](auto&& self, const nlohmann::ordered_json& object) -> void {
            for (const auto& [key, value] : object.items()) {
                words.push_back("\"" + key + "\":");
                if (value.is_object()) self(self, value);
            }
        };
        if (words.empty()) each(each, json);
    }
    dictionary("config", words);
    seed("capture", "small",
         std::string(R"({"subject":"a","image_size":[48,48],"camera_ids":["c0","c1","c2"],)") +
             R"("train_frames":["0000"],"test_frames":["0001"],"exp_names":["jaw","smile"],)" +
             R"("conventions":{"image":"over black"}})");
    seed("capture", "empty", "{}");
    dictionary("capture", {"\"subject\":", "\"camera_ids\":", "\"train_frames\":", "\"0000\"",
                           "\"test_frames\":", "\"novel_gaze_test_frames\":", "\"exp_names\":",
                           "\"independent_gaze_test_frames\":", "\"conventions\":", "\"image\":",
                           "\"image_size\":", "[48,48]", "1e999", "[[[["});
    const std::string matrix = R"("transform_matrix":[[1,0,0,0],[0,1,0,0],[0,0,1,2],[0,0,0,1]])";
    seed("transforms", "file", R"({"w":64,"h":48,"fl_x":50,"k1":0.1,"frames":[{)" + matrix + "}]}");
    seed("transforms", "frame", R"({"camera_angle_x":0.7,"frames":[{"w":64,"h":48,"cx":30,"fl_y":9,)" +
                                    std::string(R"("camera_model":"PINHOLE","file_path":"a",)") +
                                    matrix + "}]}");
    dictionary("transforms", {"\"frames\":", "\"transform_matrix\":", "\"camera_model\":", "\"w\":",
                              "\"OPENCV\"", "\"camera_angle_x\":", "\"fl_x\":", "\"k4\":", "1e308"});
}

/// Writes seeds of what `rye` reads when a head travels.
void travel() {
    const std::string place =
        R"({"size":[8,6],"fov":30,"up":[0,1,0],"look_at":[0,0,0],"cameras":[)";
    seed("cameras", "places", place + R"({"eye":[0,0,9]},{"eye":[1,0,9],"fov":40,"name":"b"}]})");
    seed("cameras", "matrices",
         place + R"({"intrinsic":[[9,0,4],[0,9,3],[0,0,1]],"extrinsic":[[1,0,0,0],[0,1,0,0],)" +
             R"([0,0,1,2]]}]})");
    dictionary("cameras", {"\"cameras\":", "\"eye\":", "\"look_at\":", "\"up\":", "\"fov\":",
                           "\"size\":", "\"intrinsic\":", "\"extrinsic\":", "1e308", "[8,6]"});
    Drivers<float> d;
    d.expression.setConstant(2, 0.5F);
    d.pose.setConstant(0.1F);
    d.gaze = {gaze_vector(0.1F, 0.2F), gaze_vector(0.0F, -0.3F)};
    seed("drivers", "all", trainer::text_of_drivers({d, d}, {"a", "b"}));
    seed("drivers", "some", std::string("blink,scale\n0.5,1\n-1,2\n"));
    dictionary("drivers", {"expression_0", "smile", "rotation_x,rotation_y,rotation_z", "scale",
                           "translation_x,translation_y,translation_z", "\n", ",", "frame",
                           "gaze_left_pitch,gaze_left_yaw", "1e-300", "nan"});
    trainer::Capture capture;
    capture.camera_ids = {"c"};
    capture.width = capture.height = 16;
    capture.frames.resize(1);
    trainer::CaptureFrame& frame = capture.frames.front();
    frame.id = "a";
    frame.expression = {0.5F};
    frame.landmarks = Columns<double>::Constant(3, 66, 0.5);
    frame.has_gaze = true;
    capture.views.resize(1);
    capture.views.front().present = true;
    capture.train = {0};
    fs::create_directories(out / "frames");
    trainer::save_frames(out / "frames", capture);
    dictionary("frames", {"\"expression\":", "\"landmarks\":", "\"camera.of_view\":", "\"visual\":",
                          "\"frames\":\"[\\\"a\\\"]\"", "\"train\":\"[0]\"", "\"shape\":[1,66,3]",
                          "\"shape\":[0,4]", "rye-frames", "\"I64\"", "-1"});
}

/// The files of other programs, after a byte that states their kind (sources.cpp).
void sources() {
    const auto add = [](char kind, const std::string& name, const std::string& text) {
        seed("sources", name, std::string(1, kind) + text);
    };
    const auto raw = [](auto... values) {
        std::string text;
        (text.append(reinterpret_cast<const char*>(&values), sizeof values), ...);
        return text;
    };
    add(0, "cameras.bin",
        raw(std::uint64_t{1}, std::uint32_t{3}, std::int32_t{1}, std::uint64_t{64},
            std::uint64_t{48}, 60.0, 60.0, 32.0, 24.0));
    add(1, "cameras.txt", "# comment\n1 OPENCV 64 48 60 60 32 24 .1 .01 0 0\n");
    add(2, "images.bin",
        raw(std::uint64_t{1}, std::uint32_t{1}, 1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 2.0,
            std::uint32_t{3}) +
            std::string("a.png\0", 6) + raw(std::uint64_t{1}, 1.0, 2.0, std::int64_t{-1}));
    add(3, "images.txt", "1 1 0 0 0 .1 .2 2 3 a b.png\n1 2 -1\n");
    add(4, "mesh.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1/1 2//1 -2 4\n");
    add(5, "gaze.csv", "frame,left_pitch,left_yaw,right_pitch,right_yaw\n0001,1,2.5,-3,4\n");
    add(6, "camera.xml",
        "<opencv_storage><cam_rotation type_id=\"opencv-matrix\"><rows>3</rows><data>1 0 0 0 1 0 "
        "0 0 1</data></cam_rotation><cam_translation><data>1 2 3</data></cam_translation>");
    add(7, "lzf", std::string("\x10\x00\x00\x41\xe0\x06\x00", 7));
    dictionary("sources",
               {"SIMPLE_PINHOLE", "PINHOLE", "RADIAL", "OPENCV", "FULL_OPENCV", "\nv ", "\nf ",
                "cam_rotation", "cam_translation", "<data>", "</data>", "nan", "1e300", ",90"});
}

/// Runs of a training in both stages, with few numbers.
void checkpoints() {
    trainer::TrainState s = trainer::tiny_state();
    s.capture = "a";
    trainer::save_checkpoint(out, s);
    const fs::path file = trainer::checkpoint_path(out);
    seed("checkpoint", "avatar", read_file(file));
    s.stage = trainer::Stage::mesh;
    s.mesh_adam = Adam<trainer::Mesh>(s.mesh);
    trainer::save_checkpoint(out, s);
    seed("checkpoint", "mesh", read_file(file));
    fs::remove(file);
    dictionary("checkpoint",
               {"rye-checkpoint", "__metadata__", "checksum", "stage", "mesh", "avatar", "step",
                "measured_eyes", "true", "false", "left_eye_points", "expression", "F32", "F64",
                "I64", "[0,0]", "[0]", "avatar_adam.v.", "field_steps", "train_frames", "1e999"});
}

void experiments() {
    for (const std::string& name : trainer::built_in_experiments())
        seed("experiments", name, trainer::to_json(trainer::built_in_experiment(name)).dump());
    seed("experiments", "own",
         std::string(R"({"title":"a","preset":"tiny","captures":["b"],"seeds":[1],)") +
             R"("columns":["gaze"],"rows":[{"name":"c d","run":"e","config":{"seed":2}}]})");
    dictionary("experiments",
               {"\"title\":", "\"preset\":", "\"base\":", "\"captures\":", "\"seeds\":",
                "\"columns\":", "\"rows\":", "\"name\":", "\"run\":", "\"config\":",
                "\"tiny\"", "\"gaussians\":", "{\"steps\":1}", "18446744073709551615", "//",
                "\"avatar\":", "\"gaze_mechanism\":", "\"none\"", "[[[["});
}

/// The cameras of a run.
void corrected() {
    const std::string camera =
        R"({"intrinsic":[900,901.5,128,127],"extrinsic":[1,0,0,0.1,0,1,0,-0.2,0,0,1,10]})";
    seed("corrected_cameras", "one",
         R"({"cameras":[{"camera":"05","wrong":)" + camera + R"(,"right":)" + camera + "}]}");
    seed("corrected_cameras", "none", std::string(R"({"cameras":[]})"));
    dictionary("corrected_cameras",
               {"\"cameras\":", "\"camera\":", "\"wrong\":", "\"right\":", "\"intrinsic\":",
                "\"extrinsic\":", "null", "-1", "1e999", "{}"});
}

/// Writes seeds of what imports read: their own record, and an export of VHAP.
void imports() {
    seed("import_record", "two",
         std::string(R"({"job":{"kind":"gha","source":"/a"},"frames":{"0001":{"views":3,)") +
             R"("spread":0.5,"sightings":2,"borrowed":0,"gaze":true},"0002":{"error":1e-3}}})");
    seed("import_record", "none", std::string(R"({"job":{},"frames":{}})"));
    dictionary("import_record", {"\"job\":", "\"frames\":", "\"views\":", "\"gaze\":", "true",
                                 "\"expression\":", "null", "-1", "1e999", "\"error\":", "{}"});
    const auto numbers = [](std::vector<Index> shape, std::size_t count) {
        const std::vector<float> values(count, 0.1F);
        return npy_array<float>(std::move(shape), values);
    };
    seed("flame_params", "zeros",
         npz_bytes({{"expr", numbers({1, 2}, 2)}, {"jaw_pose", numbers({1, 3}, 3)},
                    {"rotation", numbers({1, 3}, 3)}, {"neck_pose", numbers({1, 3}, 3)},
                    {"translation", numbers({1, 3}, 3)}, {"eyes_pose", numbers({1, 6}, 6)}}));
    dictionary("flame_params", {"PK\x03\x04", "PK\x01\x02", "PK\x05\x06", ".npy", "eyes_pose",
                                "'<f4'", "'<f8'", "(1, 6)", "(6,)", "translation", "neck_pose"});
    seed("expression_shapes", "landmarks",
         npz_bytes({{"landmarks", numbers({2, 66, 3}, 396)}}));
    seed("expression_shapes", "both", npz_bytes({{"landmarks", numbers({2, 68, 3}, 408)},
                                                 {"vertices", numbers({2, 3, 3}, 18)}}));
    dictionary("expression_shapes", {"PK\x03\x04", "PK\x01\x02", "PK\x05\x06", ".npy",
                                     "landmarks", "vertices", "'<f4'", "'<f8'", "(2, 68, 3)",
                                     "(2, 66, 3)", "(2, 3, 3)", "(2, 0, 3)", "fortran_order"});
}

void lpips() {
    const LpipsWeights<float> weights(VggShape{3, {1, 2, 1, 1, 2}, {1, 1, 1, 1, 1}});
    std::vector<TensorEntry> entries;
    std::vector<std::string> words{"F32", "F16", "[0,0]", "nan"};
    LpipsWeights<float>::fields(
        [&](const std::string& name, const Columns<float>& a) {
            entries.push_back(tensor_entry(name, a));
            words.push_back("\"" + name + "\"");
        },
        weights);
    write_safetensors(out / "weights", entries);
    seed("lpips", "narrow", read_file(out / "weights"));
    fs::remove(out / "weights");
    dictionary("lpips", words);
}

} // namespace

int main(int count, char** words) try {
    if (count != 2) {
        std::cerr << "usage: seeds FOLDER\n";
        return 2;
    }
    out = words[1];
    fs::create_directories(out);
    ply();
    splats();
    arrays();
    avatars();
    bases();
    pictures();
    texts();
    travel();
    sources();
    checkpoints();
    experiments();
    corrected();
    imports();
    lpips();
    return 0;
} catch (const std::exception& e) {
    std::cerr << "seeds: " << e.what() << "\n";
    return 1;
}
