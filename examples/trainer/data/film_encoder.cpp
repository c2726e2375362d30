// SPDX-License-Identifier: Apache-2.0
#include "data/film_encoder.hpp"

#include <string>
#include <vector>

#include <rye/core/error.hpp>

#include "data/out_format.hpp"
#include "data/process.hpp"

namespace rye::trainer {

namespace fs = std::filesystem;

void require_ffmpeg(const fs::path& file) {
    require(find_program({"ffmpeg"}).has_value(), file.string(),
            "needs ffmpeg, which is not installed: `apt-get install ffmpeg`; a name that ends in "
            ".y4m needs none");
}

void encode_film(const fs::path& y4m, const fs::path& file) {
    require_ffmpeg(file);
    const bool webm = extension_of(file) == ".webm";
    // Under another name of the same extension, so that an interrupted video cannot pass for one.
    fs::path unfinished = file;
    unfinished.replace_extension();
    unfinished += ".tmp" + file.extension().string();
    std::vector<std::string> words{
        find_program({"ffmpeg"})->string(),
        "-hide_banner",
        "-loglevel",
        "error",
        "-nostdin",
        "-y",
        "-i",
        y4m.string(),
        "-vf",
        "pad=ceil(iw/2)*2:ceil(ih/2)*2,scale=in_color_matrix=bt601:out_color_matrix=bt709",
        "-pix_fmt",
        "yuv420p",
        "-colorspace",
        "bt709",
        "-color_primaries",
        "bt709",
        "-color_trc",
        "bt709"};
    const std::vector<std::string> by =
        webm ? std::vector<std::string>{"-c:v", "libvpx-vp9", "-crf", "24", "-b:v", "0"}
             : std::vector<std::string>{"-c:v", "libx264", "-crf", "18", "-movflags", "+faststart"};
    words.insert(words.end(), by.begin(), by.end());
    words.push_back(unfinished.string());
    const ProgramEnd end = run_program(words);
    std::error_code ignored;
    fs::remove(y4m, ignored);
    if (end.code != 0) fs::remove(unfinished, ignored);
    require(end.code == 0, file.string(), "ffmpeg ended with code ", end.code, ": ", end.message);
    fs::rename(unfinished, file);
}

} // namespace rye::trainer
