// SPDX-License-Identifier: Apache-2.0
/// PNG by libpng. The library reports errors by longjmp, so each call is made in a function without
/// objects that have destructors, and turned into an exception outside it.
#include "data/picture_codecs.hpp"

#include <csetjmp>
#include <cstdio>
#include <cstring>
#include <type_traits>

#include <png.h>

#include <rye/io/inflate.hpp>
#include <rye/core/error.hpp>

namespace rye::trainer {
namespace {

/// Error handling shared by reading and writing: the jump and its message.
class PngSteps {
public:
    explicit PngSteps(const std::string& who) : who_(who) {}
    PngSteps(const PngSteps&) = delete;
    PngSteps& operator=(const PngSteps&) = delete;

    template <class F>
    void run(F step) {
        static_assert(std::is_trivially_destructible_v<F>);
        if (setjmp(jump_) != 0) throw Error(who_ + message_);
        step();
    }

protected:
    [[noreturn]] static void fail(png_structp png, png_const_charp message) {
        auto* self = static_cast<PngSteps*>(png_get_error_ptr(png));
        std::snprintf(self->message_, sizeof self->message_, ": PNG: %s", message);
        std::longjmp(self->jump_, 1);
    }
    static void ignore(png_structp, png_const_charp) {}
    void require_memory(const void* p) const {
        require(p != nullptr, who_, "PNG: libpng failed to start: no memory, or another version");
    }

    const std::string& who_;
    std::jmp_buf jump_;
    char message_[256] = "";
};

class PngReader : public PngSteps {
public:
    PngReader(ByteSpan bytes, const std::string& who) : PngSteps(who), all_(bytes), left_(bytes) {
        png_ = png_create_read_struct(PNG_LIBPNG_VER_STRING, static_cast<PngSteps*>(this), fail,
                                     ignore);
        require_memory(png_);
        info_ = png_create_info_struct(png_);
        if (info_ == nullptr) png_destroy_read_struct(&png_, nullptr, nullptr);
        require_memory(info_);
    }
    ~PngReader() { png_destroy_read_struct(&png_, &info_, nullptr); }

    /// Returns the size, and the channels after palettes and transparent colours are resolved.
    ImageHeader read_header() {
        run([this] {
            png_set_read_fn(png_, this, read);
            // Any damaged chunk is an Error; only chunks that affect pixels are read.
            png_set_crc_action(png_, PNG_CRC_ERROR_QUIT, PNG_CRC_ERROR_QUIT);
            png_set_keep_unknown_chunks(png_, PNG_HANDLE_CHUNK_NEVER, nullptr, -1);
            png_set_user_limits(png_, max_image_edge, max_image_edge);
            png_read_info(png_, info_);
            stored_row_ = png_get_rowbytes(png_, info_);
            png_set_expand(png_);
            png_set_scale_16(png_);
            passes_ = png_set_interlace_handling(png_);
            png_read_update_info(png_, info_);
        });
        const ImageHeader h{static_cast<int>(png_get_image_width(png_, info_)),
                            static_cast<int>(png_get_image_height(png_, info_)),
                            png_get_channels(png_, info_)};
        check_image_size(h, who_);
        return h;
    }
    void read_pixels(std::uint8_t* to, std::size_t row, int height) {
        run([=, this] {
            for (int pass = 0; pass < passes_; ++pass)
                for (int y = 0; y < height; ++y)
                    png_read_row(png_, to + static_cast<std::size_t>(y) * row, nullptr);
            png_read_end(png_, nullptr);
        });
    }
    /// Checks the size against the bytes: deflate compresses at most a thousandfold.
    void require_held(const ImageHeader& h) const {
        const std::uint64_t need = std::uint64_t(stored_row_) * std::uint64_t(h.height);
        require(need <= all_.size() * max_deflate_ratio, who_, "PNG: got ", all_.size(),
                " bytes for ", h.width, " x ", h.height, " pixels, too few to hold them");
    }

private:
    static void read(png_structp png, png_bytep to, std::size_t count) {
        ByteSpan& left = static_cast<PngReader*>(png_get_io_ptr(png))->left_;
        if (count > left.size()) png_error(png, "truncated: the file ends too early");
        std::memcpy(to, left.data(), count);
        left = left.subspan(count);
    }

    ByteSpan all_, left_;
    png_structp png_ = nullptr;
    png_infop info_ = nullptr;
    std::size_t stored_row_ = 0;  // [bytes]
    int passes_ = 1;
};

class PngWriter : public PngSteps {
public:
    explicit PngWriter(const std::string& who) : PngSteps(who) {
        png_ = png_create_write_struct(PNG_LIBPNG_VER_STRING, static_cast<PngSteps*>(this), fail,
                                      ignore);
        require_memory(png_);
        info_ = png_create_info_struct(png_);
        if (info_ == nullptr) png_destroy_write_struct(&png_, nullptr);
        require_memory(info_);
    }
    ~PngWriter() { png_destroy_write_struct(&png_, &info_); }

    void write(const Image8& image, Bytes& to) {
        const Image8* const of = &image;
        Bytes* const out = &to;
        run([=, this] {
            constexpr int types[] = {PNG_COLOR_TYPE_GRAY, PNG_COLOR_TYPE_GRAY_ALPHA,
                                     PNG_COLOR_TYPE_RGB, PNG_COLOR_TYPE_RGB_ALPHA};
            png_set_write_fn(png_, out, collect, nullptr);
            png_set_IHDR(png_, info_, static_cast<png_uint_32>(of->width),
                         static_cast<png_uint_32>(of->height), 8, types[of->channels - 1],
                         PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
            png_write_info(png_, info_);
            const std::size_t row = std::size_t(of->width) * std::size_t(of->channels);
            for (int y = 0; y < of->height; ++y)
                png_write_row(png_, of->values.data() + std::size_t(y) * row);
            png_write_end(png_, nullptr);
        });
    }

private:
    static void collect(png_structp png, png_bytep data, std::size_t count) {
        bool full = false;
        try {
            append(*static_cast<Bytes*>(png_get_io_ptr(png)),
                   ByteSpan(reinterpret_cast<const std::byte*>(data), count));
        } catch (...) {  // must not pass through C code
            full = true;
        }
        if (full) png_error(png, "no memory");
    }

    png_structp png_ = nullptr;
    png_infop info_ = nullptr;
};

} // namespace

ImageHeader png_header(ByteSpan bytes, const std::string& who) {
    return PngReader(bytes, who).read_header();
}

Image8 decode_png(ByteSpan bytes, const std::string& who) {
    PngReader reader(bytes, who);
    const ImageHeader h = reader.read_header();
    reader.require_held(h);
    Image8 image{h.width, h.height, h.channels, {}};
    const std::size_t row = std::size_t(h.width) * std::size_t(h.channels);
    image.values.resize(row * std::size_t(h.height));
    reader.read_pixels(image.values.data(), row, h.height);
    return image;
}

Bytes encode_png(const Image8& image, const std::string& who) {
    Bytes out;
    PngWriter(who).write(image, out);
    return out;
}

} // namespace rye::trainer
