// SPDX-License-Identifier: Apache-2.0
/// data/deflate.hpp: zlib as the compressor of SPZ files.
#pragma once

#include <rye/io/bytes.hpp>

namespace rye::trainer {

/// Returns a raw deflate stream of the bytes, at zlib's default level. Throws an Error if zlib
/// fails.
Bytes zlib_deflate(ByteSpan raw);

} // namespace rye::trainer
