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

/// One byte of each of a block of neighbouring pixels. Loops over it become vector code of whatever machine.
inline constexpr int kFastBlock = 32;
using FastLanes = std::array<std::uint8_t, kFastBlock>;

// By value: std::min chooses between addresses, which keeps the loops scalar.
constexpr std::uint8_t smaller(std::uint8_t a, std::uint8_t b) { return a < b ? a : b; }
constexpr std::uint8_t larger(std::uint8_t a, std::uint8_t b) { return a > b ? a : b; }

/// Largest minimum of nine neighbours in a row, for a block of circles.
inline void best_arc_portable(const std::array<FastLanes, 16>& d, FastLanes& best) {
  std::array<FastLanes, 8> two, four;
  for (int i = 0; i < 8; ++i)
    for (int k = 0; k < kFastBlock; ++k) two[i][k] = smaller(d[2 * i + 1][k], d[(2 * i + 2) & 15][k]);
  for (int i = 0; i < 8; ++i)
    for (int k = 0; k < kFastBlock; ++k) four[i][k] = smaller(two[i][k], two[(i + 1) & 7][k]);
  for (int i = 0; i < 8; ++i)
    for (int k = 0; k < kFastBlock; ++k)
      best[k] = larger(best[k], smaller(smaller(four[i][k], four[(i + 2) & 7][k]),
                                        larger(d[2 * i][k], d[(2 * i + 9) & 15][k])));
}

/// The block's scores where they exceed the threshold, else 0.
inline void fast_score_block_portable(const std::uint8_t* p, const CircleOffsets& circle, int threshold,
                                      std::uint8_t* scores) {
  const auto t = static_cast<std::uint8_t>(threshold), headroom = static_cast<std::uint8_t>(255 - threshold);
  FastLanes high, low;
  for (int k = 0; k < kFastBlock; ++k) {
    high[k] = static_cast<std::uint8_t>(smaller(p[k], headroom) + t);
    low[k] = static_cast<std::uint8_t>(larger(p[k], t) - t);
  }
  // Differences beyond the threshold, each sign by itself; zero where within it.
  std::array<FastLanes, 16> brighter, darker;
  const auto compare = [&](int i) {
    const std::uint8_t* q = p + circle[i];
    for (int k = 0; k < kFastBlock; ++k) {
      brighter[i][k] = static_cast<std::uint8_t>(larger(q[k], high[k]) - high[k]);
      darker[i][k] = static_cast<std::uint8_t>(low[k] - smaller(q[k], low[k]));
    }
  };
  // Nine neighbours in a row hold one of each pair of opposite ones.
  for (const int i : {0, 4, 8, 12}) compare(i);
  std::uint8_t any = 0;
  for (int k = 0; k < kFastBlock; ++k)
    any |= smaller(larger(brighter[0][k], brighter[8][k]), larger(brighter[4][k], brighter[12][k])) |
           smaller(larger(darker[0][k], darker[8][k]), larger(darker[4][k], darker[12][k]));
  FastLanes best{};
  if (any != 0) {
    for (const int i : {1, 2, 3, 5, 6, 7, 9, 10, 11, 13, 14, 15}) compare(i);
    best_arc_portable(brighter, best);
    best_arc_portable(darker, best);
  }
  for (int k = 0; k < kFastBlock; ++k)
    scores[k] = best[k] == 0 ? std::uint8_t{0} : static_cast<std::uint8_t>(best[k] + t);
}

/// scores[x] = the score of row[x] where it exceeds the threshold, else 0.
inline void fast_score_row_portable(const std::uint8_t* row, std::ptrdiff_t stride, int count, int threshold,
                                    std::uint8_t* scores) {
  const CircleOffsets circle = circle_offsets(stride);
  if (count < kFastBlock) {
    for (int x = 0; x < count; ++x) {
      const int score = fast_score(row + x, circle);
      scores[x] = score > threshold ? static_cast<std::uint8_t>(score) : std::uint8_t{0};
    }
    return;
  }
  for (int block = 0; block < count; block += kFastBlock) {
    const int x = std::min(block, count - kFastBlock);  // the last block may overlap the one before
    fast_score_block_portable(row + x, circle, threshold, scores + x);
  }
}

/// Vector code writes so many columns beyond the last.
inline constexpr int kMaximaSlack = 4;

/// Columns whose score is above zero, above the neighbours before them in reading order, and not below those
/// after. Neighbours of all columns must be readable. Returns how many; `columns` has room for count +
/// kMaximaSlack.
inline int local_maxima_portable(const std::uint8_t* scores, std::ptrdiff_t stride, int count,
                                 std::int16_t* columns) {
  int found = 0;
  for (int x = 0; x < count; ++x) {
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
  if (count < 32) return fast_score_row_portable(row, stride, count, threshold, scores);
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
  if (count < 32) return local_maxima_portable(scores, stride, count, columns);
  int found = 0;
  for (int block = 0; block < count; block += 32) {
    const int x = std::min(block, count - 32);
    const std::uint8_t* p = scores + x;
    const __m256i score = load_32(p);
    const __m256i before = _mm256_max_epu8(_mm256_max_epu8(load_32(p - 1), load_32(p - stride - 1)),
                                           _mm256_max_epu8(load_32(p - stride), load_32(p - stride + 1)));
    const __m256i after = _mm256_max_epu8(_mm256_max_epu8(load_32(p + 1), load_32(p + stride - 1)),
                                          _mm256_max_epu8(load_32(p + stride), load_32(p + stride + 1)));
    // score > before: not max(score, before) == before; zero never exceeds anything.
    const __m256i not_above = _mm256_cmpeq_epi8(_mm256_max_epu8(score, before), before);
    const __m256i not_below = _mm256_cmpeq_epi8(_mm256_max_epu8(score, after), score);
    auto mask = static_cast<std::uint32_t>(_mm256_movemask_epi8(_mm256_andnot_si256(not_above, not_below)));
    mask &= ~std::uint32_t{0} << (block - x);  // the block before had these
    // Most blocks hold few: writing four in any case spares a branch that nobody can predict.
    const int here = __builtin_popcount(mask);
    for (int i = 0; i < kMaximaSlack; ++i, mask = _blsr_u32(mask))
      columns[found + i] = static_cast<std::int16_t>(x + static_cast<int>(_tzcnt_u32(mask)));
    for (int i = kMaximaSlack; mask != 0; ++i, mask = _blsr_u32(mask))
      columns[found + i] = static_cast<std::int16_t>(x + static_cast<int>(_tzcnt_u32(mask)));
    found += here;
  }
  return found;
}

#endif

inline void fast_score_row(const std::uint8_t* row, std::ptrdiff_t stride, int count, int threshold,
                           std::uint8_t* scores) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return fast_score_row_avx2(row, stride, count, threshold, scores);
#endif
  fast_score_row_portable(row, stride, count, threshold, scores);
}

inline int local_maxima(const std::uint8_t* scores, std::ptrdiff_t stride, int count, std::int16_t* columns) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return local_maxima_avx2(scores, stride, count, columns);
#endif
  return local_maxima_portable(scores, stride, count, columns);
}

}  // namespace sweepkit::impl
