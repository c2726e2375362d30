// SPDX-License-Identifier: Apache-2.0
#include "data/moving_picture.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <span>

#include <rye/io/atomic_file.hpp>
#include <rye/io/inflate.hpp>
#include <rye/core/error.hpp>

#include "data/film_encoder.hpp"
#include "data/picture_codecs.hpp"
#include "data/system.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

void check_picture(const Image8& picture, const Image8& first, const std::string& who) {
    require(picture.channels == 3 && picture.width == first.width && picture.height == first.height,
            who, "got a picture of ", picture.width, " x ", picture.height, " x ", picture.channels,
            ", expected ", first.width, " x ", first.height, " x 3 as of the first one");
}

// ---- a folder ----------------------------------------------------------------------------------

class PictureFolder : public MovingPicture {
  public:
    PictureFolder(fs::path folder, int count) : folder_(std::move(folder)), count_(count) {
        std::error_code fault;
        require(!fs::exists(folder_, fault) || fs::is_directory(folder_, fault), folder_.string(),
                "is a file, expected a folder or nothing");
        fs::create_directories(folder_, fault);
        require(!fault, folder_.string(), "cannot be made: ", [&] { return fault.message(); });
        for (const fs::directory_entry& e : fs::directory_iterator(folder_))
            require(!e.path().filename().string().starts_with("frame_"), folder_.string(),
                    "holds pictures already (", e.path().filename().string(),
                    "), expected a new or an empty folder");
    }
    void add(const Image8& picture) override {
        write_png(folder_ / numbered_picture(next_++, count_), picture);
    }
    void finish() override {}

  private:
    fs::path folder_;
    int count_, next_ = 0;
};

// ---- animated PNG ------------------------------------------------------------------------------

void append_u32(Bytes& to, std::uint32_t x) {
    for (int shift = 24; shift >= 0; shift -= 8) to.push_back(static_cast<std::byte>(x >> shift));
}
void append_u16(Bytes& to, int x) {
    to.push_back(static_cast<std::byte>(x >> 8));
    to.push_back(static_cast<std::byte>(x));
}

/// Returns a chunk: length, type, data, checksum of type and data.
Bytes chunk(const char* type, ByteSpan data) {
    Bytes out;
    append_u32(out, static_cast<std::uint32_t>(data.size()));
    append(out, as_bytes(type));
    append(out, data);
    append_u32(out, crc32(ByteSpan(out).subspan(4)));
    return out;
}

/// Returns the data of a PNG's chunks of one type, joined.
Bytes data_of(ByteSpan png, std::string_view type) {
    constexpr std::size_t signature = 8, around = 12;
    Bytes out;
    for (std::size_t at = signature; at + around <= png.size();) {
        std::uint32_t length = 0;
        for (std::size_t i = 0; i < 4; ++i)
            length = length << 8U | static_cast<std::uint32_t>(png[at + i]);
        RYE_ASSERT(length <= png.size() - at - around, "data_of: a chunk is cut");
        if (as_text(png.subspan(at + 4, 4)) == type) append(out, png.subspan(at + 8, length));
        at += around + length;
    }
    return out;
}

class AnimatedPng : public MovingPicture {
  public:
    AnimatedPng(const fs::path& path, FrameRate rate, int count)
        : path_(path),
          file_(path),
          rate_(rate),
          count_(count) {}

    void add(const Image8& picture) override {
        if (added_ == 0) begin(picture);
        check_picture(picture, first_, path_.string());
        const Bytes png = encode_png(picture, path_.string());
        if (added_ == 0) {
            file_.write(chunk("IHDR", data_of(png, "IHDR")));
            Bytes all;
            append_u32(all, static_cast<std::uint32_t>(count_));
            append_u32(all, 0); // number of plays: endless
            file_.write(chunk("acTL", all));
        }
        file_.write(chunk("fcTL", frame_control()));
        const Bytes pixels = data_of(png, "IDAT");
        if (added_ == 0) {
            file_.write(chunk("IDAT", pixels));
        } else {
            Bytes numbered;
            append_u32(numbered, sequence_++);
            append(numbered, pixels);
            file_.write(chunk("fdAT", numbered));
        }
        ++added_;
    }
    void finish() override {
        RYE_ASSERT(added_ == count_, "AnimatedPng: another number of pictures than announced");
        file_.write(chunk("IEND", {}));
        file_.commit(Durability::atomic_only);
    }

  private:
    void begin(const Image8& picture) {
        first_ = {picture.width, picture.height, 3, {}};
        file_.write(as_bytes(std::string_view("\x89PNG\r\n\x1a\n", 8)));
    }
    /// Returns the control of a frame: the whole picture, which replaces the previous one.
    Bytes frame_control() {
        Bytes b;
        append_u32(b, sequence_++);
        append_u32(b, static_cast<std::uint32_t>(first_.width));
        append_u32(b, static_cast<std::uint32_t>(first_.height));
        append_u32(b, 0);
        append_u32(b, 0);
        append_u16(b, rate_.seconds);
        append_u16(b, rate_.pictures);
        b.push_back(std::byte{0}); // not disposed of
        b.push_back(std::byte{0}); // overwrites
        return b;
    }

    fs::path path_;
    AtomicFile file_;
    FrameRate rate_;
    int count_, added_ = 0;
    std::uint32_t sequence_ = 0;
    Image8 first_; // for its size
};

// ---- Y4M ---------------------------------------------------------------------------------------

/// Standard output, unbuffered.
class StandardOutput {
  public:
    void write(ByteSpan bytes) { write_output(bytes); }
    void commit(Durability) {}
};

/// Returns Y, Cb and Cr of 8-bit R'G'B' by Rec. 601, limited range: 16 to 235, and 16 to 240 about
/// 128; to the nearest, in units of 2^-16.
std::array<std::uint8_t, 3> yuv_of(const std::uint8_t* rgb) {
    constexpr std::array<std::array<int, 3>, 3> weights{
        {{16829, 33039, 6416}, {-9714, -19070, 28784}, {28784, -24103, -4681}}};
    constexpr std::array<int, 3> offset{16, 128, 128};
    std::array<std::uint8_t, 3> yuv{};
    for (std::size_t k = 0; k < 3; ++k) {
        int sum = (offset[k] << 16) + (1 << 15);
        for (std::size_t c = 0; c < 3; ++c) sum += weights[k][c] * rgb[c];
        yuv[k] = static_cast<std::uint8_t>(sum >> 16);
    }
    return yuv;
}

template <class Output>
class Y4m : public MovingPicture {
  public:
    template <class... Arguments>
    explicit Y4m(std::string who, FrameRate rate, Arguments&&... to)
        : who_(std::move(who)),
          rate_(rate),
          output_(to...) {}

    void add(const Image8& picture) override {
        if (first_.width == 0) {
            first_ = {picture.width, picture.height, 3, {}};
            char header[160];
            std::snprintf(header, sizeof header,
                          "YUV4MPEG2 W%d H%d F%d:%d Ip A1:1 C444 XCOLORRANGE=LIMITED\n",
                          picture.width, picture.height, rate_.pictures, rate_.seconds);
            output_.write(as_bytes(header));
        }
        check_picture(picture, first_, who_);
        constexpr std::string_view mark = "FRAME\n";
        const std::size_t pixels = picture.values.size() / 3;
        Bytes frame(mark.size() + picture.values.size());
        std::memcpy(frame.data(), mark.data(), mark.size());
        for (std::size_t i = 0; i < pixels; ++i) {
            const std::array<std::uint8_t, 3> yuv = yuv_of(picture.values.data() + 3 * i);
            for (std::size_t k = 0; k < 3; ++k)
                frame[mark.size() + k * pixels + i] = static_cast<std::byte>(yuv[k]);
        }
        output_.write(frame);
    }
    void finish() override { output_.commit(Durability::atomic_only); }

  private:
    std::string who_;
    FrameRate rate_;
    Output output_;
    Image8 first_; // for its size
};

// ---- by ffmpeg ---------------------------------------------------------------------------------

/// A Y4M beside the video, of which ffmpeg makes it in the end.
class Film : public MovingPicture {
  public:
    Film(fs::path path, FrameRate rate)
        : path_(std::move(path)),
          pictures_(path_.string() + ".y4m"),
          y4m_(path_.string(), rate, pictures_) {
        require_ffmpeg(path_);
    }
    void add(const Image8& picture) override { y4m_.add(picture); }
    void finish() override {
        y4m_.finish();
        encode_film(pictures_, path_);
    }

  private:
    fs::path path_, pictures_;
    Y4m<AtomicFile> y4m_;
};

} // namespace

FrameRate parsed_rate(const std::string& text, const std::string& who) {
    FrameRate r;
    const char* const end = text.data() + text.size();
    auto [at, fault] = std::from_chars(text.data(), end, r.pictures);
    bool read = fault == std::errc();
    if (read && at != end) {
        const auto [stop, bad] = std::from_chars(at + 1, end, r.seconds);
        read = *at == '/' && bad == std::errc() && stop == end;
    }
    constexpr int most = 65535; // limit of APNG
    require(read && r.pictures >= 1 && r.pictures <= most && r.seconds >= 1 && r.seconds <= most &&
                r.pictures >= r.seconds && r.pictures / r.seconds <= 1000,
            who, "got '", text,
            "', expected 1 to 1000 pictures a second, such as 25 or 30000/1001");
    return r;
}

std::string numbered_picture(int number, int count) {
    const std::size_t digits =
        std::max<std::size_t>(4, std::to_string(std::max(0, count - 1)).size());
    const std::string text = std::to_string(number);
    return "frame_" + std::string(digits - std::min(digits, text.size()), '0') + text + ".png";
}

std::unique_ptr<MovingPicture> moving_picture(const fs::path& path, OutFormat format,
                                              FrameRate rate, int count) {
    RYE_ASSERT(moves(format) && count > 0, "moving_picture: a format or count of no video");
    if (format == OutFormat::picture_folder) return std::make_unique<PictureFolder>(path, count);
    if (format == OutFormat::apng) return std::make_unique<AnimatedPng>(path, rate, count);
    if (format == OutFormat::film) return std::make_unique<Film>(path, rate);
    if (format == OutFormat::y4m)
        return std::make_unique<Y4m<AtomicFile>>(path.string(), rate, path);
    return std::make_unique<Y4m<StandardOutput>>("standard output", rate);
}

} // namespace rye::trainer
