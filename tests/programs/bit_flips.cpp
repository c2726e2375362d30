// SPDX-License-Identifier: Apache-2.0
/// bit_flips [FLIPS] [SEED]: flips one bit of each file of a run, of its exports, of a comparison
/// and of a capture, FLIPS times each (40 unless given), and reads it as the program does. A flip
/// is detected if there is an Error or a warning that names the file; it has no effect if all that
/// was read is the same, bit for bit. Anything else is silent, and a fault. A .splat has no place
/// for a checksum: its silent flips are counted, not refused.
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <iostream>
#include <sstream>
#include <string>
#include <vector>

#include <rye/io/avatar_file.hpp>
#include <rye/io/splats.hpp>

#include "../support/file_bytes.hpp"
#include "../support/tiny_playable.hpp"
#include "commands/compare_tables.hpp"
#include "data/checksums.hpp"
#include "data/config_difference.hpp"
#include "data/deflate.hpp"
#include "data/expression_shapes.hpp"
#include "data/json.hpp"
#include "data/run_frames.hpp"
#include "data/validate.hpp"
#include "data/zstd.hpp"
#include "importers/import_folder.hpp"
#include "tiny_capture.hpp"
#include "tiny_run.hpp"
#include "training/run_folder.hpp"

namespace {

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

/// A temporary folder, removed at the end.
struct Folder {
    Folder() {
        std::string made = (fs::temp_directory_path() / "rye-flips-XXXXXX").string();
        require(::mkdtemp(made.data()) != nullptr, made, "cannot be made");
        path = made;
    }
    ~Folder() {
        std::error_code ignored;
        fs::remove_all(path, ignored);
    }
    fs::path path;
};

/// A file and what reads it: read() returns all that was read, as bytes.
struct Subject {
    fs::path file;
    std::function<std::string()> read;
    bool may_be_silent = false;
};

void put(const fs::path& path, const std::string& text) {
    write_atomic(path, as_bytes(text), Durability::atomic_only);
}

/// The result of read() and its words on standard error, or the Error's.
struct Outcome {
    bool refused = false;
    std::string content, words;
};
Outcome outcome_of(const Subject& s) {
    Outcome o;
    std::ostringstream said;
    std::streambuf* const before = std::cerr.rdbuf(said.rdbuf());
    try {
        o.content = s.read();
    } catch (const Error& e) {
        o.refused = true;
        said << e.what();
    }
    std::cerr.rdbuf(before);
    o.words = said.str();
    return o;
}

class Files {
  public:
    Files() {
        fs::create_directories(run_);
        fs::create_directories(again_);
        write_capture();
        write_run();
        write_exports();
        const std::string views =
            R"([{"picture": "0003_c0.png", "eyes_box": [12, 20, 21, 6], "psnr": 31.25}])";
        put(folder_.path / "per_view.json", views);
        put(folder_.path / "results.json",
            checked_text({{"split", "test"},
                          {"all", {{"head", {{"psnr", 31.25}}}}},
                          {"per_view_checksum", checksum_text(crc32(as_bytes(views)))}},
                         2));
        put(folder_.path / "complete.json",
            checked_text({{"perceptual_weights", "lpips.safetensors"}}, 2));
        for (const char* name : {"results.json", "complete.json"})
            add(name, [](const fs::path& file) {
                return parse_checked_json(bytes_of(file), file.string()).dump();
            });
        add("per_view.json", [](const fs::path& file) {
            return nlohmann::json(eye_boxes(file.parent_path())).dump();
        });
        put(folder_.path / "import.json",
            checked_text({{"job", {{"kind", "gha"}, {"source", "/a"}}},
                          {"frames", {{"0000", {{"views", 3}, {"gaze", true}}}}}},
                         1));
        add("import.json", [](const fs::path& file) {
            const ImportRecord r = parse_import_record(bytes_of(file), file.string());
            return r.job.dump() + nlohmann::json(r.frames).dump();
        });
    }
    const std::vector<Subject>& subjects() const { return subjects_; }

  private:
    void add(const std::string& name, std::string (*read)(const fs::path&)) {
        const fs::path file = folder_.path / name;
        subjects_.push_back({file, [file, read] { return read(file); }});
    }

    void write_capture() {
        files_.set_expressions();
        nlohmann::ordered_json about{{"subject", "a"}, {"test_frames", {"0003"}}};
        about["checksums"] = array_checksums(files_.folder);
        files_.write_text("capture.json", checked_text(about, 1));
        capture_ = read_valid_capture(files_.folder);
        const auto read = [this] {
            const Capture c = read_valid_capture(files_.folder);
            std::string all = frames_mark(c) + c.subject;
            for (int f = 0; f < c.frame_count(); ++f)
                for (int k = 0; k < c.camera_count(); ++k)
                    for (const Image<float>& i :
                         {c.image(f, k), c.mask(f, k), c.eye_mask(f, k)})
                        all += checksum_text(crc32(std::as_bytes(
                            std::span(i.pixels.data(), static_cast<std::size_t>(i.pixels.size())))));
            return all;
        };
        const Index wide = capture_.expression_width();
        const Index vertices = capture_.frames.front().vertices.cols();
        const std::vector<float> landmarks(static_cast<std::size_t>(wide * 68 * 3), 0.5F),
            dense(static_cast<std::size_t>(wide * vertices * 3), 0.25F);
        write_npz(files_.folder / "expression_shapes.npz",
                  {{"landmarks", npy_array<float>({wide, 68, 3}, landmarks)},
                   {"vertices", npy_array<float>({wide, vertices, 3}, dense)}});
        subjects_.push_back({files_.folder / "expression_shapes.npz", [this] {
                                 const Columns<double> shapes = expression_shapes(capture_);
                                 return checksum_text(crc32(std::as_bytes(std::span(
                                     shapes.data(), static_cast<std::size_t>(shapes.size())))));
                             }});
        for (const fs::path& file :
             {files_.folder / "capture.json", files_.params(0, "params.npz"),
              files_.params(0, "lmk_3d.npy"), files_.params(0, "vertices.npy"),
              files_.params(0, "gaze.npz"), files_.camera_file(0, 1), files_.image(0, 1),
              files_.image(0, 1, "mask"), files_.image(0, 1, "eye_mask")})
            subjects_.push_back({file, read});
    }

    void write_run() {
        TrainState state = tiny_state();
        state.step = 9;
        state.capture = files_.folder.string();
        state.frames = frames_mark(capture_);
        RunFolder run(run_, state, Beginning::fresh, &capture_);
        for (int step = 1; step < 9; ++step)
            run.log({{"stage", "avatar"}, {"step", step}, {"loss", 1.0 / step}});
        run.save(state);
        const auto config = to_json(state.config);
        subjects_.push_back({checkpoint_path(run_), [this] {
                                 save_checkpoint(again_, load_checkpoint(run_));
                                 return bytes_of(checkpoint_path(again_));
                             }});
        const std::string mark = state.frames;
        subjects_.push_back({frames_path(run_), [this, mark] {
                                 save_frames(again_, load_frames(run_, mark));
                                 return bytes_of(frames_path(again_));
                             }});
        subjects_.push_back({run_ / "log.jsonl", [this, state] {
                                 int damaged = 0;
                                 const fs::path log = run_ / "log.jsonl";
                                 const std::string kept = kept_log(log, state, damaged);
                                 if (damaged > 0) std::cerr << log.string() << ": damaged lines";
                                 return kept;
                             }});
        // `rye compare` reads it, and refuses one that is not what it wants.
        subjects_.push_back({run_ / "config.json", [this, config] {
                                 const fs::path file = run_ / "config.json";
                                 const auto got = read_json<nlohmann::ordered_json>(file);
                                 const std::string difference = first_difference(got, config);
                                 require(difference.empty(), file.string(), difference);
                                 return std::string();
                             }});
    }

    void write_exports() {
        write_avatar(folder_.path / "a.avatar",
                     test::tiny_playable(test::TinyParts{true, true, true, true}));
        add("a.avatar", [](const fs::path& file) {
            const fs::path again = file.parent_path() / "again.avatar";
            write_avatar(again, read_avatar<float>(file), AvatarPrecision::full);
            return bytes_of(again);
        });
        GaussianCloud<float> cloud(40, 1);
        test::Draw draw;
        GaussianCloud<float>::fields(
            [&](const std::string&, Columns<float>& a) {
                a = draw.columns(a.rows(), a.cols()).cast<float>();
            },
            cloud);
        const auto read = [](const fs::path& file) {
            std::ostringstream text;
            write_ply(text, read_splats<float>(file, default_memory, zstd_decompressor()));
            return text.str();
        };
        const auto write = [&](const char* name, SplatFileOptions options) {
            options.ply.comment = "Vertical axis: y";
            write_atomic(folder_.path / name, splat_file_bytes(cloud, options));
            add(name, read);
        };
        write("a.ply", {SplatKind::ply, {}, stored_deflate});
        write("a.spz", {SplatKind::spz, {}, zlib_deflate});
        if (zstd_decompressor()) {
            write("a4.spz", {SplatKind::spz4, {}, zlib_deflate, zstd_compressor()});
            subjects_.back().may_be_silent = true; // its header; the arrays have checksums
        }
        write("a.splat", {SplatKind::splat, {}, stored_deflate});
        subjects_.back().may_be_silent = true;
    }

    Folder folder_;
    fs::path run_ = folder_.path / "run", again_ = folder_.path / "again";
    TinyCapture files_{folder_.path / "capture"};
    Capture capture_;
    std::vector<Subject> subjects_;
};

/// Whether no flip was silent.
bool test_file(const Subject& s, int flips, const Random& random) {
    const std::string whole = bytes_of(s.file);
    const std::string name = s.file.filename().string();
    const Outcome right = outcome_of(s);
    if (right.refused || !right.words.empty()) {
        std::cout << name << ": not read as it is: " << right.words << "\n";
        return false;
    }
    int refused = 0, warned = 0, same = 0, silent = 0;
    for (int i = 0; i < flips; ++i) {
        const Index bit = random.below(static_cast<std::uint64_t>(i),
                                       static_cast<Index>(8 * whole.size()));
        std::string damaged = whole;
        char& c = damaged[static_cast<std::size_t>(bit / 8)];
        c = static_cast<char>(static_cast<unsigned char>(c) ^ (1U << (bit % 8)));
        put(s.file, damaged);
        const Outcome o = outcome_of(s);
        const bool named = o.words.find(name) != std::string::npos;
        if (o.refused && named) ++refused;
        else if (!o.refused && named) ++warned;
        else if (!o.refused && o.content == right.content) ++same;
        else {
            ++silent;
            if (!s.may_be_silent)
                std::cout << name << ": bit " << bit << " is silent: " << o.words << "\n";
        }
    }
    put(s.file, whole);
    std::printf("%-22s %8zu %8d %8d %8d %8d%s\n", name.c_str(), whole.size(), refused, warned, same,
                silent, s.may_be_silent ? "  (no place for a checksum)" : "");
    return silent == 0 || s.may_be_silent;
}

} // namespace

int main(int count, char** words) try {
    const int flips = count > 1 ? std::stoi(words[1]) : 40;
    const std::uint64_t seed = count > 2 ? std::stoull(words[2]) : 1;
    const Files files;
    std::printf("%d flips in each file, seed %llu\n%-22s %8s %8s %8s %8s %8s\n", flips,
                static_cast<unsigned long long>(seed), "file", "bytes", "refused", "warned", "same",
                "silent");
    bool good = true;
    const Random random{seed, 0};
    for (std::size_t i = 0; i < files.subjects().size(); ++i)
        good = test_file(files.subjects()[i], flips, random.fork(i)) && good;
    return good ? 0 : 1;
} catch (const std::exception& e) {
    std::cerr << "bit_flips: " << e.what() << "\n";
    return 1;
}
