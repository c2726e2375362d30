// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/avatar.cpp: any bytes as an avatar file; what is accepted has consistent shapes, and
/// its checksum does not stand in the way: it is made right first.
#include "fuzz.hpp"

#include <cstring>

#include <rye/io/avatar_file.hpp>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    Bytes bytes = fuzz::unchecked(data, size);
    const std::size_t at = as_text(ByteSpan(bytes)).find("\"checksun\":\"");
    try { // the right digits in the place of those that are there
        const Safetensors file = parse_safetensors(bytes, fuzz::name);
        TensorMetadata metadata = file.metadata();
        const auto found = metadata.extract("checksun");
        if (!found.empty() && found.mapped().size() == detail::checksum_digits &&
            at != std::string_view::npos) {
            bytes[at + 8] = std::byte{'m'};
            const std::string right = detail::tensor_checksum(file.tensors(), metadata);
            std::memcpy(bytes.data() + at + 12, right.data(), right.size());
        }
    } catch (const Error&) { // parse_avatar says so again
    }
    fuzz::attempt([&] {
        const PlayableAvatar<float> p = parse_avatar<float>(bytes, fuzz::name);
        detail::check_playable(fuzz::name, p);
        Index numbers = 0; // of 2 bytes each in the file, or 4
        TrainedAvatar<float>::fields(
            [&](const std::string&, const Columns<float>& a) { numbers += a.size(); }, p.avatar);
        fuzz::demand(2 * numbers <= static_cast<Index>(size),
                     "an avatar is no larger than its file");
    });
    return 0;
}
