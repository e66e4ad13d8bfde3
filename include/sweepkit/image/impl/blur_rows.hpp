// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "sweepkit/core/simd.hpp"

namespace sweepkit::impl {

/// Gaussian with sigma 2, of 128: outermost to centre.
inline constexpr int kBlurWeights[4] = {9, 17, 24, 28};

/// target[x] = the weighted mean of rows[0..6][x], rounded. Serves both directions: along a row, the seven
/// "rows" are one row at seven shifts.
inline void blur_7_rows_portable(const std::uint8_t* const (&rows)[7], int from, int width,
                                 std::uint8_t* target) {
  const auto [w0, w1, w2, w3] = kBlurWeights;
  for (int x = from; x < width; ++x) {
    const int sum = w0 * (rows[0][x] + rows[6][x]) + w1 * (rows[1][x] + rows[5][x]) +
                    w2 * (rows[2][x] + rows[4][x]) + w3 * rows[3][x];
    target[x] = static_cast<std::uint8_t>((sum + 64) >> 7);
  }
}

#ifdef SWEEPKIT_HAVE_AVX2

SWEEPKIT_TARGET_AVX2 inline void blur_7_rows_avx2(const std::uint8_t* const (&rows)[7], int width,
                                                  std::uint8_t* target) {
  const auto [w0, w1, w2, w3] = kBlurWeights;
  // Pairs of rows interleave byte by byte, each pair with its two weights.
  const __m256i w01 = _mm256_set1_epi16(static_cast<std::int16_t>(w0 | w1 << 8));
  const __m256i w23 = _mm256_set1_epi16(static_cast<std::int16_t>(w2 | w3 << 8));
  const __m256i w21 = _mm256_set1_epi16(static_cast<std::int16_t>(w2 | w1 << 8));
  // The last pair is the seventh row and zero, which takes the rounding's place: 64 = 64 * 1.
  const __m256i w0r = _mm256_set1_epi16(static_cast<std::int16_t>(w0 | 1 << 8));
  const __m256i half = _mm256_set1_epi8(64);
  int x = 0;
  for (; x + 32 <= width; x += 32) {
    const auto load = [&](int i) SWEEPKIT_TARGET_AVX2 { return load_32(rows[i] + x); };
    const __m256i r0 = load(0), r1 = load(1), r2 = load(2), r3 = load(3), r4 = load(4), r5 = load(5),
                  r6 = load(6);
    const __m256i low =
        _mm256_add_epi16(_mm256_add_epi16(_mm256_maddubs_epi16(_mm256_unpacklo_epi8(r0, r1), w01),
                                          _mm256_maddubs_epi16(_mm256_unpacklo_epi8(r2, r3), w23)),
                         _mm256_add_epi16(_mm256_maddubs_epi16(_mm256_unpacklo_epi8(r4, r5), w21),
                                          _mm256_maddubs_epi16(_mm256_unpacklo_epi8(r6, half), w0r)));
    const __m256i high =
        _mm256_add_epi16(_mm256_add_epi16(_mm256_maddubs_epi16(_mm256_unpackhi_epi8(r0, r1), w01),
                                          _mm256_maddubs_epi16(_mm256_unpackhi_epi8(r2, r3), w23)),
                         _mm256_add_epi16(_mm256_maddubs_epi16(_mm256_unpackhi_epi8(r4, r5), w21),
                                          _mm256_maddubs_epi16(_mm256_unpackhi_epi8(r6, half), w0r)));
    store_32(target + x, _mm256_packus_epi16(_mm256_srli_epi16(low, 7), _mm256_srli_epi16(high, 7)));
  }
  blur_7_rows_portable(rows, x, width, target);
}

#endif

inline void blur_7_rows(const std::uint8_t* const (&rows)[7], int width, std::uint8_t* target) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return blur_7_rows_avx2(rows, width, target);
#endif
  blur_7_rows_portable(rows, 0, width, target);
}

}  // namespace sweepkit::impl
