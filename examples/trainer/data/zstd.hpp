// SPDX-License-Identifier: Apache-2.0
/// data/zstd.hpp: libzstd for SPZ files of version 4. A build without it writes stored frames, and
/// reads none.
#pragma once

#include <rye/io/zstd.hpp>

namespace rye::trainer {

/// Returns libzstd's compressor, with a checksum in each frame; stored_zstd in a build without it.
ZstdCompress zstd_compressor();

/// Returns libzstd's decompressor; an empty function in a build without it.
ZstdDecompress zstd_decompressor();

} // namespace rye::trainer
