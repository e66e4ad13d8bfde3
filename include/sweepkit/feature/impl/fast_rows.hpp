// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "sweepkit/core/simd.hpp"

namespace sweepkit::impl {

using CircleOffsets = std::array<std::ptrdiff_t, 16>;

/// Neighbours on the circle of radius 3 in order, from below the centre.
inline CircleOffsets circle_offsets(std::ptrdiff_t stride) {
  constexpr int kX[16] = {0, 1, 2, 3, 3, 3, 2, 1, 0, -1, -2, -3, -3, -3, -2, -1};
  constexpr int kY[16] = {3, 3, 2, 1, 0, -1, -2, -3, -3, -3, -2, -1, 0, 1, 2, 3};
  CircleOffsets offsets;
  for (int i = 0; i < 16; ++i) offsets[i] = kX[i] + kY[i] * stride;
  return offsets;
}

/// Largest minimum of nine neighbouring differences, over both signs; 0 if no arc lies on one side.
inline int fast_score(const std::uint8_t* centre, const CircleOffsets& circle) {
  int d[16];
  for (int i = 0; i < 16; ++i) d[i] = centre[circle[i]] - *centre;
  int brighter = 0, darker = 0;
  // The arcs that begin at k and at k + 1 share eight pixels.
  for (int k = 0; k < 16; k += 2) {
    int low = d[(k + 1) & 15], high = low;
    for (int i = 2; i <= 8; ++i) {
      low = std::min(low, d[(k + i) & 15]);
      high = std::max(high, d[(k + i) & 15]);
    }
    brighter = std::max(brighter, std::min(low, std::max(d[k], d[(k + 9) & 15])));
    darker = std::max(darker, -std::max(high, std::min(d[k], d[(k + 9) & 15])));
  }
  return std::max(brighter, darker);
}

/// scores[x] = the score of row[x] where it exceeds the threshold, else 0.
inline void fast_score_row_portable(const std::uint8_t* row, std::ptrdiff_t stride, int from, int count,
                                    int threshold, std::uint8_t* scores) {
  const CircleOffsets circle = circle_offsets(stride);
  for (int x = from; x < count; ++x) {
    const std::uint8_t* p = row + x;
    scores[x] = 0;
    // Nine neighbours in a row hold one of each pair of opposite ones.
    const int high = *p + threshold, low = *p - threshold;
    int sides = 3;
    for (int i = 0; i < 8; i += 2) {
      const int a = p[circle[i]], b = p[circle[i + 8]];
      sides &= (a > high || b > high) | ((a < low || b < low) << 1);
    }
    if (sides == 0) continue;
    const int score = fast_score(p, circle);
    if (score > threshold) scores[x] = static_cast<std::uint8_t>(score);
  }
}

/// Columns whose score is above zero, above the neighbours before them in reading order, and not below those
/// after. Neighbours of all columns must be readable. Returns how many; `columns` has room for count + 1.
inline int local_maxima_portable(const std::uint8_t* scores, std::ptrdiff_t stride, int from, int count,
                                 int found, std::int16_t* columns) {
  for (int x = from; x < count; ++x) {
    const std::uint8_t* p = scores + x;
    if (*p == 0) continue;
    const int before = std::max(std::max(p[-1], p[-stride - 1]), std::max(p[-stride], p[-stride + 1]));
    const int after = std::max(std::max(p[1], p[stride - 1]), std::max(p[stride], p[stride + 1]));
    if (*p > before && *p >= after) columns[found++] = static_cast<std::int16_t>(x);
  }
  return found;
}

#ifdef SWEEPKIT_HAVE_AVX2

/// Largest minimum of nine neighbours in a row, for 32 circles.
SWEEPKIT_TARGET_AVX2 inline __m256i best_arc(const __m256i (&d)[16]) {
  __m256i two[8], four[8];
#pragma GCC unroll 8
  for (int i = 0; i < 8; ++i) two[i] = _mm256_min_epu8(d[2 * i + 1], d[(2 * i + 2) & 15]);
#pragma GCC unroll 8
  for (int i = 0; i < 8; ++i) four[i] = _mm256_min_epu8(two[i], two[(i + 1) & 7]);
  __m256i best = _mm256_setzero_si256();
#pragma GCC unroll 8
  for (int i = 0; i < 8; ++i) {
    const __m256i eight = _mm256_min_epu8(four[i], four[(i + 2) & 7]);
    best = _mm256_max_epu8(best, _mm256_min_epu8(eight, _mm256_max_epu8(d[2 * i], d[(2 * i + 9) & 15])));
  }
  return best;
}

SWEEPKIT_TARGET_AVX2 inline void fast_score_row_avx2(const std::uint8_t* row, std::ptrdiff_t stride,
                                                     int count, int threshold, std::uint8_t* scores) {
  const CircleOffsets circle = circle_offsets(stride);
  const __m256i zero = _mm256_setzero_si256();
  const __m256i t = _mm256_set1_epi8(static_cast<char>(threshold));
  if (count < 32) return fast_score_row_portable(row, stride, 0, count, threshold, scores);
  for (int block = 0; block < count; block += 32) {
    const int x = std::min(block, count - 32);  // the last block may overlap the one before
    const std::uint8_t* p = row + x;
    const __m256i centre = load_32(p);
    // Differences beyond the threshold, each sign by itself: zero where within it.
    const __m256i high = _mm256_adds_epu8(centre, t), low = _mm256_subs_epu8(centre, t);
    __m256i brighter[16], darker[16];
    __m256i any_brighter, any_darker;
    const auto pair = [&](int i) SWEEPKIT_TARGET_AVX2 {
      const __m256i a = load_32(p + circle[i]), b = load_32(p + circle[i + 8]);
      brighter[i] = _mm256_subs_epu8(a, high);
      brighter[i + 8] = _mm256_subs_epu8(b, high);
      darker[i] = _mm256_subs_epu8(low, a);
      darker[i + 8] = _mm256_subs_epu8(low, b);
    };
    pair(0);
    pair(4);
    any_brighter = _mm256_min_epu8(_mm256_max_epu8(brighter[0], brighter[8]),
                                   _mm256_max_epu8(brighter[4], brighter[12]));
    any_darker =
        _mm256_min_epu8(_mm256_max_epu8(darker[0], darker[8]), _mm256_max_epu8(darker[4], darker[12]));
    __m256i any = _mm256_or_si256(any_brighter, any_darker);
    if (_mm256_testz_si256(any, any)) {
      store_32(scores + x, zero);
      continue;
    }
    for (int i : {1, 2, 3, 5, 6, 7}) pair(i);
    const __m256i best = _mm256_max_epu8(best_arc(brighter), best_arc(darker));
    // Back to differences from the centre, where there is a corner at all.
    const __m256i none = _mm256_cmpeq_epi8(best, zero);
    store_32(scores + x, _mm256_andnot_si256(none, _mm256_add_epi8(best, t)));
  }
}

SWEEPKIT_TARGET_AVX2 inline int local_maxima_avx2(const std::uint8_t* scores, std::ptrdiff_t stride,
                                                  int count, std::int16_t* columns) {
  if (count < 32) return local_maxima_portable(scores, stride, 0, count, 0, columns);
  int found = 0;
  for (int block = 0; block < count; block += 32) {
    const int x = std::min(block, count - 32);
    const std::uint8_t* p = scores + x;
    const __m256i score = load_32(p);
    if (_mm256_testz_si256(score, score)) continue;
    const __m256i before = _mm256_max_epu8(_mm256_max_epu8(load_32(p - 1), load_32(p - stride - 1)),
                                           _mm256_max_epu8(load_32(p - stride), load_32(p - stride + 1)));
    const __m256i after = _mm256_max_epu8(_mm256_max_epu8(load_32(p + 1), load_32(p + stride - 1)),
                                          _mm256_max_epu8(load_32(p + stride), load_32(p + stride + 1)));
    // score > before: not max(score, before) == before; zero never exceeds anything.
    const __m256i not_above = _mm256_cmpeq_epi8(_mm256_max_epu8(score, before), before);
    const __m256i not_below = _mm256_cmpeq_epi8(_mm256_max_epu8(score, after), score);
    auto mask = static_cast<std::uint32_t>(_mm256_movemask_epi8(_mm256_andnot_si256(not_above, not_below)));
    mask &= ~std::uint32_t{0} << (block - x);  // the block before had these
    for (; mask != 0; mask &= mask - 1) columns[found++] = static_cast<std::int16_t>(x + __builtin_ctz(mask));
  }
  return found;
}

#endif

inline void fast_score_row(const std::uint8_t* row, std::ptrdiff_t stride, int count, int threshold,
                           std::uint8_t* scores) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return fast_score_row_avx2(row, stride, count, threshold, scores);
#endif
  fast_score_row_portable(row, stride, 0, count, threshold, scores);
}

inline int local_maxima(const std::uint8_t* scores, std::ptrdiff_t stride, int count, std::int16_t* columns) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return local_maxima_avx2(scores, stride, count, columns);
#endif
  return local_maxima_portable(scores, stride, 0, count, 0, columns);
}

}  // namespace sweepkit::impl
