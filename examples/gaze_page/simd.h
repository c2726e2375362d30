/* SPDX-License-Identifier: Apache-2.0 */
/* simd.h: included before everything by build.sh. emscripten 3.1.6 has the SSE of xsimd's vectors in
 * terms of WebAssembly's, some of it in more steps than it takes: minimum, maximum and selection by
 * a comparison's mask are single instructions, and conversions need no loop. The values are those
 * that x86 has for every input that rye converts (|x| below 2^31). */
#ifndef RYE_GAZE_PAGE_SIMD_H
#define RYE_GAZE_PAGE_SIMD_H

#if defined(__wasm_simd128__) && defined(__cplusplus)
#include <smmintrin.h>
#include <wasm_simd128.h>

/* a < b ? a : b, so b where one is NaN. */
#define _mm_min_ps(a, b) ((__m128)wasm_f32x4_pmin((v128_t)(b), (v128_t)(a)))
#define _mm_max_ps(a, b) ((__m128)wasm_f32x4_pmax((v128_t)(b), (v128_t)(a)))
/* xsimd's masks have all bits of a lane set, or none. */
#define _mm_blendv_ps(a, b, mask) \
    ((__m128)wasm_v128_bitselect((v128_t)(b), (v128_t)(a), (v128_t)(mask)))
#define _mm_cvttps_epi32(a) ((__m128i)wasm_i32x4_trunc_sat_f32x4((v128_t)(a)))
#define _mm_cvtps_epi32(a) \
    ((__m128i)wasm_i32x4_trunc_sat_f32x4(wasm_f32x4_nearest((v128_t)(a))))
#endif

#endif
