// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "sweepkit/core/simd.hpp"
#include "sweepkit/feature/impl/edge_rows.hpp"

namespace sweepkit::impl {

/// A grid of samples along and across a segment. Positions have 16 fractional bits, half a pixel for rounding
/// included; directions 14.
struct LbdGrid {
  std::int32_t x, y;                // first sample of the first row
  std::int32_t along_x, along_y;    // to the next column
  std::int32_t across_x, across_y;  // to the next row
  std::int16_t direction_x, direction_y;
  int columns;  // a multiple of 8
  int rows;
  bool inside;  // all samples lie in the image
};

/// Sums over a row of samples, of the gradient along the segment and across it: the positive parts, and the
/// sizes of the negative ones.
struct LbdRow {
  std::int32_t along, against, across, back;
};

inline void lbd_rows_portable(const EdgeGradient* gradient, std::ptrdiff_t stride, int width, int height,
                              const LbdGrid& g, LbdRow* rows) {
  const int lx = g.direction_x, ly = g.direction_y, ox = -ly, oy = lx;
  for (int r = 0; r < g.rows; ++r) {
    std::int32_t x = g.x + r * g.across_x, y = g.y + r * g.across_y;
    std::int32_t along = 0, across = 0, along_sum = 0, across_sum = 0;
    for (int c = 0; c < g.columns; ++c, x += g.along_x, y += g.along_y) {
      const int column = std::clamp(x >> 16, 0, width - 1), row = std::clamp(y >> 16, 0, height - 1);
      const EdgeGradient e = gradient[row * stride + column];
      const std::int32_t l = (e.x * lx + e.y * ly) >> 14, o = (e.x * ox + e.y * oy) >> 14;
      along_sum += l;
      across_sum += o;
      along += std::max(l, 0);
      across += std::max(o, 0);
    }
    rows[r] = {along, along - along_sum, across, across - across_sum};
  }
}

#ifdef SWEEPKIT_HAVE_AVX2

SWEEPKIT_TARGET_AVX2 inline std::int32_t sum_of_lanes(__m256i v) {
  __m128i s = _mm_add_epi32(_mm256_castsi256_si128(v), _mm256_extracti128_si256(v, 1));
  s = _mm_add_epi32(s, _mm_shuffle_epi32(s, 0x4e));
  s = _mm_add_epi32(s, _mm_shuffle_epi32(s, 0xb1));
  return _mm_cvtsi128_si32(s);
}

SWEEPKIT_TARGET_AVX2 inline void lbd_rows_avx2(const EdgeGradient* gradient, std::ptrdiff_t stride, int width,
                                               int height, const LbdGrid& g, LbdRow* rows) {
  const auto pair = [](int x, int y) { return static_cast<std::int32_t>((x & 0xffff) | y * 65536); };
  const __m256i direction = _mm256_set1_epi32(pair(g.direction_x, g.direction_y));
  const __m256i normal = _mm256_set1_epi32(pair(-g.direction_y, g.direction_x));
  const __m256i lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7), zero = _mm256_setzero_si256();
  const __m256i lanes_x = _mm256_mullo_epi32(lanes, _mm256_set1_epi32(g.along_x));
  const __m256i lanes_y = _mm256_mullo_epi32(lanes, _mm256_set1_epi32(g.along_y));
  const __m256i step_x = _mm256_set1_epi32(8 * g.along_x), step_y = _mm256_set1_epi32(8 * g.along_y);
  const __m256i last_x = _mm256_set1_epi32(width - 1), last_y = _mm256_set1_epi32(height - 1);
  const __m256i row_step = _mm256_set1_epi32(static_cast<std::int32_t>(stride));
  const int* base = reinterpret_cast<const int*>(gradient);
  for (int r = 0; r < g.rows; ++r) {
    __m256i x = _mm256_add_epi32(_mm256_set1_epi32(g.x + r * g.across_x), lanes_x);
    __m256i y = _mm256_add_epi32(_mm256_set1_epi32(g.y + r * g.across_y), lanes_y);
    __m256i along = zero, across = zero, along_sum = zero, across_sum = zero;
    for (int c = 0; c < g.columns; c += 8) {
      __m256i column = _mm256_srai_epi32(x, 16), row = _mm256_srai_epi32(y, 16);
      if (!g.inside) {
        column = _mm256_min_epi32(_mm256_max_epi32(column, zero), last_x);
        row = _mm256_min_epi32(_mm256_max_epi32(row, zero), last_y);
      }
      const __m256i e =
          _mm256_i32gather_epi32(base, _mm256_add_epi32(_mm256_mullo_epi32(row, row_step), column), 4);
      const __m256i l = _mm256_srai_epi32(_mm256_madd_epi16(e, direction), 14);
      const __m256i o = _mm256_srai_epi32(_mm256_madd_epi16(e, normal), 14);
      along_sum = _mm256_add_epi32(along_sum, l);
      across_sum = _mm256_add_epi32(across_sum, o);
      along = _mm256_add_epi32(along, _mm256_max_epi32(l, zero));
      across = _mm256_add_epi32(across, _mm256_max_epi32(o, zero));
      x = _mm256_add_epi32(x, step_x);
      y = _mm256_add_epi32(y, step_y);
    }
    const std::int32_t a = sum_of_lanes(along), b = sum_of_lanes(across);
    rows[r] = {a, a - sum_of_lanes(along_sum), b, b - sum_of_lanes(across_sum)};
  }
}

#endif

inline void lbd_rows(const EdgeGradient* gradient, std::ptrdiff_t stride, int width, int height,
                     const LbdGrid& grid, LbdRow* rows) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return lbd_rows_avx2(gradient, stride, width, height, grid, rows);
#endif
  lbd_rows_portable(gradient, stride, width, height, grid, rows);
}

}  // namespace sweepkit::impl
