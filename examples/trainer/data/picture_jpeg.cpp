// SPDX-License-Identifier: Apache-2.0
/// JPEG by libjpeg-turbo. The library reports errors by longjmp, so each call is made in a function
/// without objects that have destructors, and turned into an exception outside it. Warnings of the
/// library, such as for damaged data, are errors here.
#include "data/picture_codecs.hpp"

#include <csetjmp>
#include <cstdio>
#include <cstdlib>
#include <type_traits>

#include <jpeglib.h>
#include <jerror.h>

#include <rye/core/error.hpp>

namespace rye::trainer {
namespace {

/// Limit on the scans of a progressive file; usual ones have about ten.
constexpr int max_scans = 64;

/// Error handling shared by reading and writing: the jump and its message. C: the library's state.
template <class C>
class JpegSteps {
public:
    explicit JpegSteps(const std::string& who) : who_(who) {
        info_.err = jpeg_std_error(&errors_);
        info_.client_data = this;
        errors_.error_exit = [](j_common_ptr info) { fail(info); };
        errors_.emit_message = [](j_common_ptr info, int level) {
            if (level < 0 && !harmless(info->err->msg_code)) fail(info);
        };
    }
    JpegSteps(const JpegSteps&) = delete;
    JpegSteps& operator=(const JpegSteps&) = delete;
    ~JpegSteps() { jpeg_destroy(reinterpret_cast<j_common_ptr>(&info_)); }

    template <class F>
    void run(F step) {
        static_assert(std::is_trivially_destructible_v<F>);
        if (setjmp(jump_) != 0) throw Error(who_ + ": JPEG: " + message_);
        step();
    }

protected:
    [[noreturn]] static void fail(j_common_ptr info) {
        auto* self = static_cast<JpegSteps*>(info->client_data);
        info->err->format_message(info, self->message_);
        std::longjmp(self->jump_, 1);
    }
    /// Returns true for warnings caused by common cameras: bytes between segments, version numbers.
    static bool harmless(int code) {
        return code == JWRN_EXTRANEOUS_DATA || code == JWRN_JFIF_MAJOR || code == JWRN_ADOBE_XFORM;
    }

    const std::string& who_;
    C info_{};
    jpeg_error_mgr errors_{};
    std::jmp_buf jump_;
    char message_[JMSG_LENGTH_MAX] = "";
};

class JpegReader : public JpegSteps<jpeg_decompress_struct> {
public:
    JpegReader(ByteSpan bytes, const std::string& who) : JpegSteps(who), bytes_(bytes) {
        progress_.progress_monitor = [](j_common_ptr info) {
            auto* const d = reinterpret_cast<j_decompress_ptr>(info);
            if (d->input_scan_number > max_scans) ERREXIT(info, JERR_BAD_PROGRESSION);
        };
    }

    ImageHeader read_header() {
        run([this] {
            jpeg_create_decompress(&info_);
            info_.progress = &progress_;
            jpeg_mem_src(&info_, reinterpret_cast<const unsigned char*>(bytes_.data()),
                         static_cast<unsigned long>(bytes_.size()));
            jpeg_read_header(&info_, TRUE);
        });
        const J_COLOR_SPACE space = info_.jpeg_color_space;
        require(space == JCS_GRAYSCALE || space == JCS_YCbCr || space == JCS_RGB, who_,
                "got a JPEG of ", info_.num_components,
                " channels (CMYK, or of unknown colour), expected grey or RGB: convert it");
        require(info_.arith_code == 0, who_,
                "got a JPEG with arithmetic coding, expected Huffman coding");
        const ImageHeader h{static_cast<int>(info_.image_width),
                            static_cast<int>(info_.image_height), info_.num_components};
        check_image_size(h, who_);
        return h;
    }
    /// Checks the size against the bytes: a block of 8 x 8 samples takes at least one bit.
    void require_held(const ImageHeader& h) const {
        std::uint64_t blocks = 0;
        for (int i = 0; i < info_.num_components; ++i)
            blocks += std::uint64_t(info_.comp_info[i].width_in_blocks) *
                      info_.comp_info[i].height_in_blocks;
        require(blocks <= 8 * std::uint64_t(bytes_.size()), who_, "JPEG: truncated: got ",
                bytes_.size(), " bytes for ", h.width, " x ", h.height,
                " pixels, too few to hold them");
    }
    void read_pixels(std::uint8_t* to, std::size_t row) {
        run([=, this] {
            info_.out_color_space = info_.num_components == 1 ? JCS_GRAYSCALE : JCS_RGB;
            jpeg_start_decompress(&info_);
            while (info_.output_scanline < info_.output_height) {
                JSAMPROW line = to + std::size_t(info_.output_scanline) * row;
                jpeg_read_scanlines(&info_, &line, 1);
            }
            jpeg_finish_decompress(&info_);
        });
    }

private:
    ByteSpan bytes_;
    jpeg_progress_mgr progress_{};
};

class JpegWriter : public JpegSteps<jpeg_compress_struct> {
public:
    explicit JpegWriter(const std::string& who) : JpegSteps(who) {}
    ~JpegWriter() { std::free(data_); }

    ByteSpan write(const Image8& image, int quality) {
        const Image8* const of = &image;
        run([=, this] {
            jpeg_create_compress(&info_);
            jpeg_mem_dest(&info_, &data_, &size_);
            info_.image_width = static_cast<JDIMENSION>(of->width);
            info_.image_height = static_cast<JDIMENSION>(of->height);
            info_.input_components = of->channels;
            info_.in_color_space = of->channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
            jpeg_set_defaults(&info_);
            jpeg_set_quality(&info_, quality, TRUE);
            if (quality > 90)
                info_.comp_info[0].h_samp_factor = info_.comp_info[0].v_samp_factor = 1;
            jpeg_start_compress(&info_, TRUE);
            const std::size_t row = std::size_t(of->width) * std::size_t(of->channels);
            while (info_.next_scanline < info_.image_height) {
                // The library reads through a pointer to non-const data.
                JSAMPROW line = const_cast<JSAMPROW>(of->values.data()) +
                                std::size_t(info_.next_scanline) * row;
                jpeg_write_scanlines(&info_, &line, 1);
            }
            jpeg_finish_compress(&info_);
        });
        return {reinterpret_cast<const std::byte*>(data_), size_};
    }

private:
    unsigned char* data_ = nullptr;
    unsigned long size_ = 0;
};

} // namespace

ImageHeader jpeg_header(ByteSpan bytes, const std::string& who) {
    return JpegReader(bytes, who).read_header();
}

Image8 decode_jpeg(ByteSpan bytes, const std::string& who) {
    JpegReader reader(bytes, who);
    const ImageHeader h = reader.read_header();
    reader.require_held(h);
    Image8 image{h.width, h.height, h.channels, {}};
    const std::size_t row = std::size_t(h.width) * std::size_t(h.channels);
    image.values.resize(row * std::size_t(h.height));
    reader.read_pixels(image.values.data(), row);
    return image;
}

Bytes encode_jpeg(const Image8& image, int quality, const std::string& who) {
    require(image.channels == 1 || image.channels == 3, who, "got an image of ", image.channels,
            " channels, expected 1 or 3 for a JPEG");
    JpegWriter writer(who);
    const ByteSpan bytes = writer.write(image, quality);
    return {bytes.begin(), bytes.end()};
}

} // namespace rye::trainer
