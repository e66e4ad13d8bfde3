// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sweepkit/core/simd.hpp"

namespace sweepkit::impl {

/// Where the columns of a resized row come from. Eight columns form a block that reads 16 source bytes: a
/// byte shuffle brings left and right neighbours together, a multiply-add blends them.
struct ColumnTable {
  struct Block {
    alignas(16) std::array<std::uint8_t, 16> shuffle;  // neighbours of column i at 2 i and 2 i + 1
    alignas(16) std::array<std::int8_t, 16> weights;
  };

  int width = 0;                  // of the target
  std::vector<int> left, right;   // neighbours
  std::vector<int> weight_right;  // of 128
  std::vector<Block> blocks;
  std::vector<int> start;  // first source byte of a block
  int fast_blocks = 0;     // even number of blocks from the left that may load 16 bytes

  std::size_t padded_width() const { return (static_cast<std::size_t>(width) + 31) / 32 * 32; }

  void build(int source_width, int target_width) {
    width = target_width;
    left.resize(width);
    right.resize(width);
    weight_right.resize(width);
    const double scale = static_cast<double>(source_width) / width;
    for (int x = 0; x < width; ++x) {
      const double centre = std::clamp((x + 0.5) * scale - 0.5, 0.0, source_width - 1.0);
      left[x] = std::min(static_cast<int>(centre), source_width - 1);
      right[x] = std::min(left[x] + 1, source_width - 1);
      weight_right[x] = std::clamp(static_cast<int>((centre - left[x]) * 128.0 + 0.5), 1, 127);
    }
    blocks.resize(width / 8);
    start.resize(blocks.size());
    fast_blocks = 0;
    bool all_fast = true;
    for (std::size_t b = 0; b < blocks.size(); ++b) {
      const int first = static_cast<int>(b) * 8;
      start[b] = left[first];
      all_fast = all_fast && right[first + 7] - start[b] < 16 && start[b] + 16 <= source_width;
      if (!all_fast) break;
      for (int i = 0; i < 8; ++i) {
        blocks[b].shuffle[2 * i] = static_cast<std::uint8_t>(left[first + i] - start[b]);
        blocks[b].shuffle[2 * i + 1] = static_cast<std::uint8_t>(right[first + i] - start[b]);
        blocks[b].weights[2 * i] = static_cast<std::int8_t>(128 - weight_right[first + i]);
        blocks[b].weights[2 * i + 1] = static_cast<std::int8_t>(weight_right[first + i]);
      }
      fast_blocks = (static_cast<int>(b) + 1) / 2 * 2;
    }
  }
};

/// Pixels times 128, so at most 32640.
inline void resize_row_portable(const std::uint8_t* source, const ColumnTable& columns, int from,
                                std::int16_t* target) {
  for (int x = from; x < columns.width; ++x) {
    const int w = columns.weight_right[x];
    target[x] = static_cast<std::int16_t>(source[columns.left[x]] * (128 - w) + source[columns.right[x]] * w);
  }
}

/// upper + (lower - upper) * weight / 32768, both roundings to the nearest, then back to 8 bits.
inline void blend_rows_portable(const std::int16_t* upper, const std::int16_t* lower, int weight, int from,
                                int width, std::uint8_t* target) {
  for (int x = from; x < width; ++x) {
    const int step = (((lower[x] - upper[x]) * weight >> 14) + 1) >> 1;
    target[x] = static_cast<std::uint8_t>((upper[x] + step + 64) >> 7);
  }
}

#ifdef SWEEPKIT_HAVE_AVX2

SWEEPKIT_TARGET_AVX2 inline void resize_row_avx2(const std::uint8_t* source, const ColumnTable& columns,
                                                 std::int16_t* target) {
  for (int b = 0; b < columns.fast_blocks; b += 2) {
    const auto& low = columns.blocks[b];
    const auto& high = columns.blocks[b + 1];
    const __m128i a = _mm_maddubs_epi16(
        _mm_shuffle_epi8(load_16(source + columns.start[b]), load_16(&low.shuffle)), load_16(&low.weights));
    const __m128i c =
        _mm_maddubs_epi16(_mm_shuffle_epi8(load_16(source + columns.start[b + 1]), load_16(&high.shuffle)),
                          load_16(&high.weights));
    _mm_storeu_si128(reinterpret_cast<__m128i*>(target + 8 * b), a);
    _mm_storeu_si128(reinterpret_cast<__m128i*>(target + 8 * b + 8), c);
  }
  resize_row_portable(source, columns, 8 * columns.fast_blocks, target);
}

SWEEPKIT_TARGET_AVX2 inline void blend_rows_avx2(const std::int16_t* upper, const std::int16_t* lower,
                                                 int weight, int width, std::uint8_t* target) {
  const __m256i w = _mm256_set1_epi16(static_cast<std::int16_t>(weight));
  const __m256i half = _mm256_set1_epi16(64);
  int x = 0;
  for (; x + 32 <= width; x += 32) {
    __m256i sums[2];
    for (int i = 0; i < 2; ++i) {
      const __m256i u = load_32(upper + x + 16 * i);
      const __m256i l = load_32(lower + x + 16 * i);
      const __m256i sum = _mm256_add_epi16(u, _mm256_mulhrs_epi16(_mm256_sub_epi16(l, u), w));
      sums[i] = _mm256_srli_epi16(_mm256_add_epi16(sum, half), 7);
    }
    const __m256i bytes = _mm256_permute4x64_epi64(_mm256_packus_epi16(sums[0], sums[1]), 0b11011000);
    store_32(target + x, bytes);
  }
  blend_rows_portable(upper, lower, weight, x, width, target);
}

#endif

inline void resize_row(const std::uint8_t* source, const ColumnTable& columns, std::int16_t* target) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return resize_row_avx2(source, columns, target);
#endif
  resize_row_portable(source, columns, 0, target);
}

inline void blend_rows(const std::int16_t* upper, const std::int16_t* lower, int weight, int width,
                       std::uint8_t* target) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return blend_rows_avx2(upper, lower, weight, width, target);
#endif
  blend_rows_portable(upper, lower, weight, 0, width, target);
}

}  // namespace sweepkit::impl
