// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/avatar.cpp: any bytes as an avatar file; what is accepted has consistent shapes, and
/// its checksum does not stand in the way: it is made right first.
#include "fuzz.hpp"

#include <cstring>

#include <rye/capture/avatar_file.hpp>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    Bytes bytes(size);
    if (size > 0) std::memcpy(bytes.data(), data, size);
    try { // eight digits of a wrong checksum are replaced by the right ones
        const Safetensors file = parse_safetensors(bytes, fuzz::name);
        const auto found = file.metadata().find("checksum");
        if (found != file.metadata().end() && found->second.size() == 8) {
            const std::string right = detail::avatar_checksum(file.tensors(), file.metadata());
            const std::string_view text = as_text(ByteSpan(bytes));
            const std::size_t at = text.find("\"" + found->second + "\"");
            if (at != std::string_view::npos) std::memcpy(bytes.data() + at + 1, right.data(), 8);
        }
    } catch (const Error&) { // parse_avatar says so again
    }
    fuzz::attempt([&] {
        const PlayableAvatar<float> p = parse_avatar<float>(bytes, fuzz::name);
        check_playable(fuzz::name, p);
        fuzz::demand(
            p.avatar.face.position.size() * Index(sizeof(float)) <= static_cast<Index>(size),
            "an avatar is no larger than its file");
    });
    return 0;
}
