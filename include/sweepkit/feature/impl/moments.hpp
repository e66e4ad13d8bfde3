// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "sweepkit/core/simd.hpp"

namespace sweepkit::impl {

inline constexpr int kMomentRadius = 15;

/// Weights of the disc's pixels, a row for each dy: dx and dy inside, 0 outside. The column beyond the disc
/// fills 32 bytes.
struct MomentWeights {
  static constexpr int kRows = 2 * kMomentRadius + 1;
  alignas(32) std::int8_t x[kRows][32]{};
  alignas(32) std::int8_t y[kRows][32]{};

  constexpr MomentWeights() {
    for (int dy = -kMomentRadius; dy <= kMomentRadius; ++dy)
      for (int dx = -kMomentRadius; dx <= kMomentRadius; ++dx) {
        // Radius 15.5: a rounder disc than 15 gives.
        if (4 * (dx * dx + dy * dy) > (2 * kMomentRadius + 1) * (2 * kMomentRadius + 1)) continue;
        x[dy + kMomentRadius][dx + kMomentRadius] = static_cast<std::int8_t>(dx);
        y[dy + kMomentRadius][dx + kMomentRadius] = static_cast<std::int8_t>(dy);
      }
  }
};

inline constexpr MomentWeights kMomentWeights;

inline void patch_moments_portable(const std::uint8_t* centre, std::ptrdiff_t stride, std::int32_t& m_x,
                                   std::int32_t& m_y) {
  m_x = m_y = 0;
  for (int row = 0; row < MomentWeights::kRows; ++row) {
    const std::uint8_t* p = centre + (row - kMomentRadius) * stride - kMomentRadius;
    for (int i = 0; i < MomentWeights::kRows; ++i) {
      m_x += kMomentWeights.x[row][i] * p[i];
      m_y += kMomentWeights.y[row][i] * p[i];
    }
  }
}

#ifdef SWEEPKIT_HAVE_AVX2

/// Reads one pixel to the right of the disc's square.
SWEEPKIT_TARGET_AVX2 inline void patch_moments_avx2(const std::uint8_t* centre, std::ptrdiff_t stride,
                                                    std::int32_t& m_x, std::int32_t& m_y) {
  const std::uint8_t* p = centre - kMomentRadius * stride - kMomentRadius;
  const __m256i ones = _mm256_set1_epi16(1);
  __m256i sum_x = _mm256_setzero_si256(), sum_y = _mm256_setzero_si256();
  int row = 0;
  while (row < MomentWeights::kRows) {
    // A row adds at most 2 * 15 * 255 to a lane of 16 bits: four rows fit.
    const int end = row + 4 < MomentWeights::kRows ? row + 4 : MomentWeights::kRows;
    __m256i part_x = _mm256_setzero_si256(), part_y = _mm256_setzero_si256();
    for (; row < end; ++row, p += stride) {
      const __m256i pixels = load_32(p);
      part_x = _mm256_add_epi16(part_x, _mm256_maddubs_epi16(pixels, load_32(kMomentWeights.x[row])));
      part_y = _mm256_add_epi16(part_y, _mm256_maddubs_epi16(pixels, load_32(kMomentWeights.y[row])));
    }
    sum_x = _mm256_add_epi32(sum_x, _mm256_madd_epi16(part_x, ones));
    sum_y = _mm256_add_epi32(sum_y, _mm256_madd_epi16(part_y, ones));
  }
  // Lanes: x x y y | x x y y, then x y x y.
  const __m256i pairs = _mm256_hadd_epi32(sum_x, sum_y);
  const __m128i both = _mm_add_epi32(_mm256_castsi256_si128(pairs), _mm256_extracti128_si256(pairs, 1));
  const __m128i result = _mm_hadd_epi32(both, both);
  m_x = _mm_cvtsi128_si32(result);
  m_y = _mm_extract_epi32(result, 1);
}

#endif

/// @param wide the pixel to the right of the disc's square can be read
inline void patch_moments(const std::uint8_t* centre, std::ptrdiff_t stride, [[maybe_unused]] bool wide,
                          std::int32_t& m_x, std::int32_t& m_y) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (wide && simd_level() == SimdLevel::avx2) return patch_moments_avx2(centre, stride, m_x, m_y);
#endif
  patch_moments_portable(centre, stride, m_x, m_y);
}

}  // namespace sweepkit::impl
