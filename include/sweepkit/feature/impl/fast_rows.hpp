// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>

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

/// Of all arcs of nine neighbours the one whose worst value, by `worse`, is best, by `better`; for a block.
template <class Worse, class Better>
inline void best_arc_portable(const std::array<FastLanes, 16>& p, Worse worse, Better better,
                              FastLanes& best) {
  std::array<FastLanes, 8> two, four;
  for (int i = 0; i < 8; ++i)
    for (int k = 0; k < kFastBlock; ++k) two[i][k] = worse(p[2 * i + 1][k], p[(2 * i + 2) & 15][k]);
  for (int i = 0; i < 8; ++i)
    for (int k = 0; k < kFastBlock; ++k) four[i][k] = worse(two[i][k], two[(i + 1) & 7][k]);
  for (int i = 0; i < 8; ++i)
    for (int k = 0; k < kFastBlock; ++k) {
      const std::uint8_t arc =
          worse(worse(four[i][k], four[(i + 2) & 7][k]), better(p[2 * i][k], p[(2 * i + 9) & 15][k]));
      best[k] = i == 0 ? arc : better(best[k], arc);
    }
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
  std::array<FastLanes, 16> around;
  const auto load = [&](int i) { std::copy_n(p + circle[i], kFastBlock, around[i].begin()); };
  // Nine neighbours in a row hold one of each pair of opposite ones.
  for (const int i : {0, 4, 8, 12}) load(i);
  std::uint8_t any = 0;
  for (int k = 0; k < kFastBlock; ++k) {
    const std::uint8_t bright =
        smaller(larger(around[0][k], around[8][k]), larger(around[4][k], around[12][k]));
    const std::uint8_t dark =
        larger(smaller(around[0][k], around[8][k]), smaller(around[4][k], around[12][k]));
    any |= static_cast<std::uint8_t>((larger(bright, high[k]) - high[k]) | (low[k] - smaller(dark, low[k])));
  }
  if (any == 0) {
    std::fill_n(scores, kFastBlock, std::uint8_t{0});
    return;
  }
  for (const int i : {1, 2, 3, 5, 6, 7, 9, 10, 11, 13, 14, 15}) load(i);
  FastLanes bright, dark;
  best_arc_portable(around, smaller, larger, bright);
  best_arc_portable(around, larger, smaller, dark);
  for (int k = 0; k < kFastBlock; ++k) {
    // How far beyond the threshold; one of the two is zero.
    const auto beyond = static_cast<std::uint8_t>((larger(bright[k], high[k]) - high[k]) |
                                                  (low[k] - smaller(dark[k], low[k])));
    scores[k] = beyond == 0 ? std::uint8_t{0} : static_cast<std::uint8_t>(beyond + t);
  }
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

/// Whether the score is above those before it in reading order, and not below those after.
inline bool is_local_maximum(const std::uint8_t* p, std::ptrdiff_t stride) {
  const std::uint8_t before = larger(larger(p[-1], p[-stride - 1]), larger(p[-stride], p[-stride + 1]));
  const std::uint8_t after = larger(larger(p[1], p[stride - 1]), larger(p[stride], p[stride + 1]));
  return (*p > before) & (*p >= after);
}

/// Columns whose score is above zero, above the neighbours before them in reading order, and not below those
/// after. Neighbours of all columns must be readable. Returns how many; `columns` has room for count +
/// kMaximaSlack.
inline int local_maxima_portable(const std::uint8_t* scores, std::ptrdiff_t stride, int count,
                                 std::int16_t* columns) {
  int found = 0, x = 0;
  for (; x + kFastBlock <= count; x += kFastBlock) {
    FastLanes kept;
    for (int k = 0; k < kFastBlock; ++k) kept[k] = is_local_maximum(scores + x + k, stride);
    for (int part = 0; part < kFastBlock; part += 8) {
      std::uint64_t eight;
      std::memcpy(&eight, kept.data() + part, 8);
      if (eight == 0) continue;
      for (int k = part; k < part + 8; ++k)
        if (kept[k]) columns[found++] = static_cast<std::int16_t>(x + k);
    }
  }
  for (; x < count; ++x)
    if (is_local_maximum(scores + x, stride)) columns[found++] = static_cast<std::int16_t>(x);
  return found;
}

#ifdef SWEEPKIT_HAVE_AVX2

SWEEPKIT_TARGET_AVX2 inline void fast_score_row_avx2(const std::uint8_t* row, std::ptrdiff_t stride,
                                                     int count, int threshold, std::uint8_t* scores) {
  if (count < 32) return fast_score_row_portable(row, stride, count, threshold, scores);
  const CircleOffsets circle = circle_offsets(stride);
  const __m256i zero = _mm256_setzero_si256();
  const __m256i t = _mm256_set1_epi8(static_cast<char>(threshold));
  for (int block = 0; block < count; block += 32) {
    const int x = std::min(block, count - 32);  // the last block may overlap the one before
    const std::uint8_t* p = row + x;
    const __m256i centre = load_32(p);
    const __m256i high = _mm256_adds_epu8(centre, t), low = _mm256_subs_epu8(centre, t);
    __m256i around[16];
#pragma GCC unroll 4
    for (int i = 0; i < 16; i += 4) around[i] = load_32(p + circle[i]);
    const __m256i bright_pairs =
        _mm256_min_epu8(_mm256_max_epu8(around[0], around[8]), _mm256_max_epu8(around[4], around[12]));
    const __m256i dark_pairs =
        _mm256_max_epu8(_mm256_min_epu8(around[0], around[8]), _mm256_min_epu8(around[4], around[12]));
    const __m256i any =
        _mm256_or_si256(_mm256_subs_epu8(bright_pairs, high), _mm256_subs_epu8(low, dark_pairs));
    if (_mm256_testz_si256(any, any)) {
      store_32(scores + x, zero);
      continue;
    }
#pragma GCC unroll 16
    for (int i = 0; i < 16; ++i)
      if (i % 4 != 0) around[i] = load_32(p + circle[i]);
    // The brightest arc by its darkest pixel, and the darkest by its brightest. The arcs that begin at an
    // even pixel and at the one after share eight pixels.
    __m256i two[8], four[8];
    __m256i bright = zero, dark = _mm256_set1_epi8(-1);
#pragma GCC unroll 8
    for (int i = 0; i < 8; ++i) two[i] = _mm256_min_epu8(around[2 * i + 1], around[(2 * i + 2) & 15]);
#pragma GCC unroll 8
    for (int i = 0; i < 8; ++i) four[i] = _mm256_min_epu8(two[i], two[(i + 1) & 7]);
#pragma GCC unroll 8
    for (int i = 0; i < 8; ++i) {
      const __m256i arc = _mm256_min_epu8(_mm256_min_epu8(four[i], four[(i + 2) & 7]),
                                          _mm256_max_epu8(around[2 * i], around[(2 * i + 9) & 15]));
      bright = _mm256_max_epu8(bright, arc);
    }
#pragma GCC unroll 8
    for (int i = 0; i < 8; ++i) two[i] = _mm256_max_epu8(around[2 * i + 1], around[(2 * i + 2) & 15]);
#pragma GCC unroll 8
    for (int i = 0; i < 8; ++i) four[i] = _mm256_max_epu8(two[i], two[(i + 1) & 7]);
#pragma GCC unroll 8
    for (int i = 0; i < 8; ++i) {
      const __m256i arc = _mm256_max_epu8(_mm256_max_epu8(four[i], four[(i + 2) & 7]),
                                          _mm256_min_epu8(around[2 * i], around[(2 * i + 9) & 15]));
      dark = _mm256_min_epu8(dark, arc);
    }
    // How far beyond the threshold; one of the two is zero.
    const __m256i beyond = _mm256_or_si256(_mm256_subs_epu8(bright, high), _mm256_subs_epu8(low, dark));
    const __m256i none = _mm256_cmpeq_epi8(beyond, zero);
    store_32(scores + x, _mm256_andnot_si256(none, _mm256_add_epi8(beyond, t)));
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
