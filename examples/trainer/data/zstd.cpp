// SPDX-License-Identifier: Apache-2.0
#include "data/zstd.hpp"

#ifdef RYE_ZSTD
#include <memory>

#include <zstd.h>
#endif

namespace rye::trainer {

#ifdef RYE_ZSTD

namespace {

Bytes compressed(ByteSpan raw) {
    constexpr int level = 12; // of 19; higher ones gain less than a percent
    const std::unique_ptr<ZSTD_CCtx, std::size_t (*)(ZSTD_CCtx*)> context(ZSTD_createCCtx(),
                                                                          ZSTD_freeCCtx);
    require(context != nullptr, "zstd", "libzstd cannot begin");
    ZSTD_CCtx_setParameter(context.get(), ZSTD_c_compressionLevel, level);
    ZSTD_CCtx_setParameter(context.get(), ZSTD_c_checksumFlag, 1);
    Bytes out(ZSTD_compressBound(raw.size()));
    const std::size_t size =
        ZSTD_compress2(context.get(), out.data(), out.size(), raw.data(), raw.size());
    require(ZSTD_isError(size) == 0, "zstd", [&] { return ZSTD_getErrorName(size); });
    out.resize(size);
    return out;
}

Bytes decompressed(ByteSpan frame, std::size_t size, const std::string& who) {
    Bytes out(size);
    const std::size_t got = ZSTD_decompress(out.data(), size, frame.data(), frame.size());
    require(ZSTD_isError(got) == 0, who, "zstd: ", [&] { return ZSTD_getErrorName(got); });
    require(got == size, who, "zstd: got ", got, " bytes of data, expected ", size);
    return out;
}

} // namespace

ZstdCompress zstd_compressor() { return compressed; }
ZstdDecompress zstd_decompressor() { return decompressed; }

#else

ZstdCompress zstd_compressor() { return stored_zstd; }
ZstdDecompress zstd_decompressor() { return {}; }

#endif

} // namespace rye::trainer
