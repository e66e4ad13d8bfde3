// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdlib>

#include "sweepkit/core/simd.hpp"

// Rows of the edge map: smoothing, gradient, ridge. Grey levels have four fractional bits after smoothing, so
// that all sums fit 16 bits: at most 4080, a gradient component 16320, a magnitude 16830. All kernels work
// on whole vectors: rows must be readable and writable up to the next multiple of kEdgeLanes columns.
namespace sweepkit::impl {

inline constexpr int kEdgeLanes = 16;

/// One pixel's gradient.
struct EdgeGradient {
  std::int16_t x, y;
};

/// target = binomial (1 4 6 4 1) of five rows, over 16, rounded. Along a row the five "rows" are one row at
/// five shifts. Values at most 4080.
inline void binomial_5_rows_portable(const std::uint16_t* const (&r)[5], int width, std::uint16_t* target) {
  for (int x = 0; x < width; ++x)
    target[x] =
        static_cast<std::uint16_t>((r[0][x] + r[4][x] + 4 * (r[1][x] + r[3][x]) + 6 * r[2][x] + 8) >> 4);
}

/// target = (1 4 6 4 1) of five shifts of a row of bytes, 16 times grey levels, for the columns from .. to
/// - 1.
inline void binomial_5_bytes_portable(const std::uint8_t* row, int from, int to, int width,
                                      std::uint16_t* target) {
  const auto at = [&](int x) { return row[std::clamp(x, 0, width - 1)]; };
  const auto sum = [](int far, int near, int middle) {
    return static_cast<std::uint16_t>(far + 4 * near + 6 * middle);
  };
  const auto slow = [&](int x) { target[x] = sum(at(x - 2) + at(x + 2), at(x - 1) + at(x + 1), at(x)); };
  int x = from;
  for (; x < std::min(2, to); ++x) slow(x);
  for (; x < std::min(to, width - 2); ++x)
    target[x] = sum(row[x - 2] + row[x + 2], row[x - 1] + row[x + 1], row[x]);
  for (; x < to; ++x) slow(x);
}

/// Sobel's gradient, also apart as gx and gy, and its length, max + 3/8 min (within 7 % of the true one),
/// from the rows above, at and below. Column -1 and `width` of the rows must be readable.
inline void sobel_row_portable(const std::uint16_t* a, const std::uint16_t* b, const std::uint16_t* c,
                               int width, std::int16_t* gx, std::int16_t* gy, EdgeGradient* gradient,
                               std::uint16_t* magnitude) {
  for (int x = 0; x < width; ++x) {
    const int dx = (a[x + 1] - a[x - 1]) + 2 * (b[x + 1] - b[x - 1]) + (c[x + 1] - c[x - 1]);
    const int dy = (c[x - 1] - a[x - 1]) + 2 * (c[x] - a[x]) + (c[x + 1] - a[x + 1]);
    const int u = std::abs(dx), v = std::abs(dy);
    gx[x] = static_cast<std::int16_t>(dx);
    gy[x] = static_cast<std::int16_t>(dy);
    gradient[x] = {gx[x], gy[x]};
    magnitude[x] = static_cast<std::uint16_t>(std::max(u, v) + (3 * std::min(u, v) >> 3));
  }
}

inline constexpr std::uint8_t kSteepRidge = 1;    ///< gradient nearer to the x axis: at most one in a row
inline constexpr std::uint8_t kShallowRidge = 2;  ///< nearer to the y axis: at most one in a column

/// Marks the pixels whose gradient is at least `threshold` long and longest across the edge, along the axis
/// nearer to the gradient. Of two equal neighbours the first counts.
inline void ridge_row_portable(const std::uint16_t* above, const std::uint16_t* row,
                               const std::uint16_t* below, const std::int16_t* gx, const std::int16_t* gy,
                               int from, int width, int threshold, std::uint8_t* ridge) {
  for (int x = from; x < width; ++x) {
    const int m = row[x];
    const bool steep = std::abs(gx[x]) >= std::abs(gy[x]);
    const int before = steep ? row[x - 1] : above[x];
    const int after = steep ? row[x + 1] : below[x];
    const bool is_ridge = m >= threshold && m > before && m >= after;
    ridge[x] = is_ridge ? (steep ? kSteepRidge : kShallowRidge) : std::uint8_t{0};
  }
}

#ifdef SWEEPKIT_HAVE_AVX2

SWEEPKIT_TARGET_AVX2 inline void binomial_5_rows_avx2(const std::uint16_t* const (&r)[5], int width,
                                                      std::uint16_t* target) {
  const __m256i half = _mm256_set1_epi16(8);
  for (int x = 0; x < width; x += kEdgeLanes) {
    const __m256i middle = load_32(r[2] + x);
    const __m256i near = _mm256_add_epi16(_mm256_add_epi16(load_32(r[1] + x), load_32(r[3] + x)), middle);
    const __m256i far = _mm256_add_epi16(load_32(r[0] + x), load_32(r[4] + x));
    // 6 m = 4 m + 2 m
    const __m256i sum =
        _mm256_add_epi16(_mm256_add_epi16(far, half),
                         _mm256_add_epi16(_mm256_slli_epi16(near, 2), _mm256_slli_epi16(middle, 1)));
    store_32(target + x, _mm256_srli_epi16(sum, 4));
  }
}

SWEEPKIT_TARGET_AVX2 inline void binomial_5_bytes_avx2(const std::uint8_t* row, int width,
                                                       std::uint16_t* target) {
  binomial_5_bytes_portable(row, 0, std::min(2, width), width, target);
  const auto at = [&](int x) SWEEPKIT_TARGET_AVX2 { return _mm256_cvtepu8_epi16(load_16(row + x)); };
  int x = 2;
  for (; x + 2 + kEdgeLanes <= width; x += kEdgeLanes) {
    const __m256i middle = at(x);
    const __m256i near = _mm256_add_epi16(_mm256_add_epi16(at(x - 1), at(x + 1)), middle);
    const __m256i far = _mm256_add_epi16(at(x - 2), at(x + 2));
    store_32(target + x, _mm256_add_epi16(far, _mm256_add_epi16(_mm256_slli_epi16(near, 2),
                                                                _mm256_slli_epi16(middle, 1))));
  }
  binomial_5_bytes_portable(row, std::min(x, width), width, width, target);
}

SWEEPKIT_TARGET_AVX2 inline void sobel_row_avx2(const std::uint16_t* a, const std::uint16_t* b,
                                                const std::uint16_t* c, int width, std::int16_t* gx,
                                                std::int16_t* gy, EdgeGradient* gradient,
                                                std::uint16_t* magnitude) {
  for (int x = 0; x < width; x += kEdgeLanes) {
    const __m256i a0 = load_32(a + x - 1), a1 = load_32(a + x), a2 = load_32(a + x + 1);
    const __m256i c0 = load_32(c + x - 1), c1 = load_32(c + x), c2 = load_32(c + x + 1);
    const __m256i b0 = load_32(b + x - 1), b2 = load_32(b + x + 1);
    const __m256i dx = _mm256_add_epi16(_mm256_add_epi16(_mm256_sub_epi16(a2, a0), _mm256_sub_epi16(c2, c0)),
                                        _mm256_slli_epi16(_mm256_sub_epi16(b2, b0), 1));
    const __m256i dy = _mm256_add_epi16(_mm256_add_epi16(_mm256_sub_epi16(c0, a0), _mm256_sub_epi16(c2, a2)),
                                        _mm256_slli_epi16(_mm256_sub_epi16(c1, a1), 1));
    const __m256i u = _mm256_abs_epi16(dx), v = _mm256_abs_epi16(dy);
    // 3 min is at most 36720: unsigned.
    const __m256i low = _mm256_min_epi16(u, v);
    const __m256i part = _mm256_srli_epi16(_mm256_add_epi16(low, _mm256_slli_epi16(low, 1)), 3);
    store_32(gx + x, dx);
    store_32(gy + x, dy);
    const __m256i low_pairs = _mm256_unpacklo_epi16(dx, dy), high_pairs = _mm256_unpackhi_epi16(dx, dy);
    store_32(gradient + x, _mm256_permute2x128_si256(low_pairs, high_pairs, 0x20));
    store_32(gradient + x + 8, _mm256_permute2x128_si256(low_pairs, high_pairs, 0x31));
    store_32(magnitude + x, _mm256_add_epi16(_mm256_max_epi16(u, v), part));
  }
}

SWEEPKIT_TARGET_AVX2 inline void ridge_row_avx2(const std::uint16_t* above, const std::uint16_t* row,
                                                const std::uint16_t* below, const std::int16_t* gx,
                                                const std::int16_t* gy, int width, int threshold,
                                                std::uint8_t* ridge) {
  const __m256i below_threshold = _mm256_set1_epi16(static_cast<std::int16_t>(threshold - 1));
  const __m256i one = _mm256_set1_epi16(1);
  for (int x = 0; x < width; x += kEdgeLanes) {
    const __m256i m = load_32(row + x);
    const __m256i shallow =
        _mm256_cmpgt_epi16(_mm256_abs_epi16(load_32(gy + x)), _mm256_abs_epi16(load_32(gx + x)));
    const __m256i before = _mm256_blendv_epi8(load_32(row + x - 1), load_32(above + x), shallow);
    const __m256i after = _mm256_blendv_epi8(load_32(row + x + 1), load_32(below + x), shallow);
    const __m256i is_ridge = _mm256_andnot_si256(
        _mm256_cmpgt_epi16(after, m),
        _mm256_and_si256(_mm256_cmpgt_epi16(m, before), _mm256_cmpgt_epi16(m, below_threshold)));
    const __m256i code = _mm256_and_si256(is_ridge, _mm256_sub_epi16(one, shallow));  // 1, or 2 if shallow
    const __m128i bytes = _mm_packus_epi16(_mm256_castsi256_si128(code), _mm256_extracti128_si256(code, 1));
    _mm_storeu_si128(reinterpret_cast<__m128i*>(ridge + x), bytes);
  }
}

#endif

inline void binomial_5_rows(const std::uint16_t* const (&rows)[5], int width, std::uint16_t* target) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return binomial_5_rows_avx2(rows, width, target);
#endif
  binomial_5_rows_portable(rows, width, target);
}

inline void binomial_5_bytes(const std::uint8_t* row, int width, std::uint16_t* target) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return binomial_5_bytes_avx2(row, width, target);
#endif
  binomial_5_bytes_portable(row, 0, width, width, target);
}

inline void sobel_row(const std::uint16_t* a, const std::uint16_t* b, const std::uint16_t* c, int width,
                      std::int16_t* gx, std::int16_t* gy, EdgeGradient* gradient, std::uint16_t* magnitude) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return sobel_row_avx2(a, b, c, width, gx, gy, gradient, magnitude);
#endif
  sobel_row_portable(a, b, c, width, gx, gy, gradient, magnitude);
}

inline void ridge_row(const std::uint16_t* above, const std::uint16_t* row, const std::uint16_t* below,
                      const std::int16_t* gx, const std::int16_t* gy, int width, int threshold,
                      std::uint8_t* ridge) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2)
    return ridge_row_avx2(above, row, below, gx, gy, width, threshold, ridge);
#endif
  ridge_row_portable(above, row, below, gx, gy, 0, width, threshold, ridge);
}

}  // namespace sweepkit::impl
