// SPDX-License-Identifier: Apache-2.0
// The frames that a run keeps: the same bits back, and every damage named.
#include "data/run_frames.hpp"

#include <doctest/doctest.h>

#include <fstream>
#include <limits>

#include <rye/io/safetensors.hpp>

#include "../support/file_bytes.hpp"
#include "../support/hostile.hpp"
#include "tiny_capture.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

struct StoredFrames {
    TemporaryFolder folder;
    TinyCapture files{folder.path / "capture"};
    Capture capture;

    StoredFrames() {
        // One camera misses a frame, another has moved in one.
        for (const char* stem : {"image", "mask", "eye_mask"}) fs::remove(files.image(1, 2, stem));
        fs::remove(files.camera_file(1, 2));
        TinyCapture::edit_one(files.camera_file(2, 0), "extrinsic",
                              [](std::vector<double>& m) { m[3] += 0.25; });
        capture = read_capture(files.folder);
        save_frames(folder.path, capture);
    }

    /// Writes the file anew after a change to its tensors (as copies) or words.
    template <class F>
    void rewrite(F&& change) const {
        const Safetensors file = read_safetensors(frames_path(folder.path));
        std::map<std::string, Bytes> bytes;
        std::vector<TensorEntry> entries;
        for (const auto& [name, t] : file.tensors()) {
            bytes[name] = Bytes(t.bytes.begin(), t.bytes.end());
            entries.push_back(t);
        }
        TensorMetadata words = file.metadata();
        change(bytes, words, entries);
        std::vector<TensorEntry> kept;
        for (TensorEntry& e : entries) {
            if (!bytes.contains(e.name)) continue;
            e.bytes = bytes.at(e.name);
            kept.push_back(e);
        }
        write_safetensors(frames_path(folder.path), kept, words);
    }
    /// Sets a number of a tensor.
    template <class T>
    void set(const std::string& name, std::size_t at, T value) const {
        rewrite([&](auto& bytes, auto&, auto&) {
            std::memcpy(bytes.at(name).data() + at * sizeof(T), &value, sizeof(T));
        });
    }
    void word(const std::string& key, const std::string& value) const {
        rewrite([&](auto&, auto& words, auto&) { words[key] = value; });
    }
};

constexpr double not_a_number = std::numeric_limits<double>::quiet_NaN();

} // namespace

TEST_CASE("frames of a run come back with the bits of the capture") {
    const StoredFrames stored;
    const Capture& a = stored.capture;
    const Capture b = load_frames(stored.folder.path, frames_mark(a));
    CHECK(b.camera_ids == a.camera_ids);
    CHECK(b.train == a.train);
    CHECK(b.test == a.test);
    CHECK(b.width == a.width);
    CHECK(b.height == a.height);
    REQUIRE(b.frame_count() == a.frame_count());
    for (int f = 0; f < a.frame_count(); ++f) {
        CAPTURE(f);
        const CaptureFrame &x = a.frames[static_cast<std::size_t>(f)],
                           &y = b.frames[static_cast<std::size_t>(f)];
        CHECK(y.id == x.id);
        CHECK(y.expression == x.expression);
        CHECK(y.pose == x.pose);
        CHECK(y.scale == x.scale);
        CHECK(y.landmarks == x.landmarks);
        for (std::size_t e = 0; e < 2; ++e) {
            CHECK(y.eyes[e].optical == x.eyes[e].optical);
            CHECK(*y.eyes[e].visual == *x.eyes[e].visual);
            CHECK(*y.eyes[e].centre == *x.eyes[e].centre);
        }
        for (int c = 0; c < a.camera_count(); ++c) {
            CHECK(b.view(f, c).present == a.view(f, c).present);
            if (!a.view(f, c).present) continue;
            const Pinhole<double>&p = a.camera(f, c), &q = b.camera(f, c);
            CHECK(q.fx == p.fx);
            CHECK(q.cy == p.cy);
            CHECK(q.width == p.width);
            CHECK(q.camera_from_world.rotation == p.camera_from_world.rotation);
            CHECK(q.camera_from_world.translation == p.camera_from_world.translation);
        }
    }
    CHECK_FALSE(b.view(1, 2).present);
    // Three cameras that stand still, and one of them at a second place.
    CHECK(read_safetensors(frames_path(stored.folder.path)).at("camera.extrinsic").shape ==
          std::vector<Index>{4, 3, 4});
}

TEST_CASE("the mark of frames follows their numbers and names, not their place") {
    const StoredFrames stored;
    Capture other = read_capture(stored.files.folder);
    other.folder = "elsewhere";
    CHECK(frames_mark(other) == frames_mark(stored.capture));
    other.frames[0].expression[1] += 1e-6f;
    CHECK(frames_mark(other) != frames_mark(stored.capture));
    CHECK_FAULT(load_frames(stored.folder.path, frames_mark(other)), "--resume");
    other = read_capture(stored.files.folder);
    other.frames[0].id = "first";
    CHECK(frames_mark(other) != frames_mark(stored.capture));
}

TEST_CASE("frames with a number that is not finite are not written") {
    const StoredFrames stored;
    const std::string before = bytes_of(frames_path(stored.folder.path));
    Capture c = read_capture(stored.files.folder);
    c.frames[1].landmarks(2, 7) = not_a_number;
    CHECK_FAULT(save_frames(stored.folder.path, c), "landmarks");
    CHECK(bytes_of(frames_path(stored.folder.path)) == before);
}

TEST_CASE("damaged frames of a run are named by file and field") {
    const StoredFrames stored;
    const auto load = [&] { return load_frames(stored.folder.path, ""); };
    const fs::path path = frames_path(stored.folder.path);
    const std::string kept = bytes_of(path);
    const auto restore = [&] { std::ofstream(path, std::ios::binary | std::ios::trunc) << kept; };

    const std::vector<std::pair<std::string, std::string>> words{{"version", "2"},
                                                                 {"format", "rye-checkpoint"},
                                                                 {"width", "0"},
                                                                 {"height", "99999"},
                                                                 {"train", "[0, 4]"},
                                                                 {"test", "[-1]"},
                                                                 {"frames", "{}"},
                                                                 {"frames", "[3]"},
                                                                 {"cameras", "[]"},
                                                                 {"novel_gaze", "[["},
                                                                 {"independent_gaze", "[1.5]"}};
    for (const auto& word : words) {
        const auto& [key, value] = word;
        CAPTURE(word.first);
        stored.word(key, value);
        CHECK_FAULT(load(), key == "cameras" ? "no cameras" : key);
        CHECK_FAULT(load(), path.string());
        restore();
    }
    for (const char* name : {"expression", "pose", "scale", "landmarks", "gaze", "camera.intrinsic",
                             "camera.extrinsic", "camera.of_view"}) {
        CAPTURE(name);
        stored.rewrite([&](auto& bytes, auto&, auto&) { bytes.erase(name); });
        CHECK_FAULT(load(), name);
        restore();
    }
    for (const char* name : {"pose", "scale", "landmarks", "gaze", "visual", "eye_centre",
                             "camera.intrinsic", "camera.extrinsic"}) {
        CAPTURE(name);
        stored.set(name, 0, not_a_number);
        CHECK_FAULT(load(), name);
        restore();
    }
    stored.set("scale", 1, -1.0);
    CHECK_FAULT(load(), "'scale': value 1 is -1");
    restore();
    stored.set("gaze", 2, 3.0);
    CHECK_FAULT(load(), "unit vector");
    restore();
    stored.set("camera.intrinsic", 0, 0.0);
    CHECK_FAULT(load(), "focal lengths 0");
    restore();
    stored.set("camera.extrinsic", 0, 2.0);
    CHECK_FAULT(load(), "no rotation");
    restore();
    stored.set("camera.of_view", 0, std::int64_t{4});
    CHECK_FAULT(load(), "got 4, expected -1 to below 4");
    restore();
    std::ofstream(path, std::ios::binary | std::ios::trunc) << kept.substr(0, kept.size() / 2);
    CHECK_FAULT(load(), path.string());
}
