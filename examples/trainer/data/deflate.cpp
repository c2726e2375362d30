// SPDX-License-Identifier: Apache-2.0
#include "data/deflate.hpp"

#include <algorithm>
#include <limits>
#include <string>

#include <zlib.h>

#include <rye/core/error.hpp>

namespace rye::trainer {

Bytes zlib_deflate(ByteSpan raw) {
    z_stream stream{};
    constexpr int raw_deflate = -15, memory = 8; // windows of 32 KiB, without zlib's header
    require(deflateInit2(&stream, Z_DEFAULT_COMPRESSION, Z_DEFLATED, raw_deflate, memory,
                         Z_DEFAULT_STRATEGY) == Z_OK,
            "zlib_deflate", "zlib cannot begin");
    Bytes out;
    Bytes part(1U << 16U);
    int state = Z_OK;
    while (state == Z_OK) {
        if (stream.avail_in == 0 && !raw.empty()) {
            // zlib counts in 32 bits.
            const std::size_t n =
                std::min<std::size_t>(raw.size(), std::numeric_limits<uInt>::max());
            stream.next_in =
                const_cast<Bytef*>(reinterpret_cast<const Bytef*>(raw.data())); // only read
            stream.avail_in = static_cast<uInt>(n);
            raw = raw.subspan(n);
        }
        stream.next_out = reinterpret_cast<Bytef*>(part.data());
        stream.avail_out = static_cast<uInt>(part.size());
        state = deflate(&stream, raw.empty() ? Z_FINISH : Z_NO_FLUSH);
        append(out, ByteSpan(part).first(part.size() - stream.avail_out));
    }
    deflateEnd(&stream);
    require(state == Z_STREAM_END, "zlib_deflate", "zlib ended with code ", state,
            ", expected that of the end");
    return out;
}

} // namespace rye::trainer
