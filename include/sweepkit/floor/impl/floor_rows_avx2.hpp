// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "sweepkit/core/simd.hpp"
#include "sweepkit/floor/impl/floor_rows_portable.hpp"
#include "sweepkit/image/disparity.hpp"

#ifdef SWEEPKIT_HAVE_AVX2

namespace sweepkit::impl {

SWEEPKIT_TARGET_AVX2 inline __m256 load_disparity(const float* d) { return _mm256_loadu_ps(d); }
SWEEPKIT_TARGET_AVX2 inline __m256 load_disparity(const std::int16_t* d) {
  return _mm256_cvtepi32_ps(_mm256_cvtepi16_epi32(load_16(d)));
}

SWEEPKIT_TARGET_AVX2 inline __m256 first_columns() { return _mm256_setr_ps(0, 1, 2, 3, 4, 5, 6, 7); }

/// floor_label of eight pixels, as numbers.
struct FloorLabelsAvx2 {
  __m256 at_zero, along_u, base, slope, above, below;

  SWEEPKIT_TARGET_AVX2 explicit FloorLabelsAvx2(const FloorRow& r)
      : at_zero(_mm256_set1_ps(r.at_zero)),
        along_u(_mm256_set1_ps(r.along_u)),
        base(_mm256_set1_ps(r.base)),
        slope(_mm256_set1_ps(r.slope)),
        above(_mm256_set1_ps(r.above)),
        below(_mm256_set1_ps(r.below)) {}

  SWEEPKIT_TARGET_AVX2 __m256i operator()(__m256 d, __m256 u) const {
    const __m256 f = _mm256_max_ps(_mm256_add_ps(at_zero, _mm256_mul_ps(along_u, u)), _mm256_setzero_ps());
    const __m256 off = _mm256_sub_ps(d, f);
    const __m256 noise = _mm256_add_ps(_mm256_mul_ps(f, slope), base);
    const __m256 allowed = _mm256_max_ps(noise, _mm256_mul_ps(f, _mm256_blendv_ps(above, below, off)));
    const __m256i beyond =
        _mm256_castps_si256(_mm256_cmp_ps(_mm256_andnot_ps(_mm256_set1_ps(-0.0f), off), allowed, _CMP_GT_OQ));
    const __m256i side = _mm256_castps_si256(_mm256_blendv_ps(
        _mm256_castsi256_ps(_mm256_set1_epi32(2)), _mm256_castsi256_ps(_mm256_set1_epi32(3)), off));
    // f is zero or positive, and so are its bits as a number.
    const __m256i is_floor = _mm256_min_epu32(_mm256_castps_si256(f), _mm256_set1_epi32(1));
    // Bits of positive numbers are ordered as they are, negative ones and all that is no number lie above:
    // one comparison without sign, done as one with sign.
    constexpr std::uint32_t kLeast = std::bit_cast<std::uint32_t>(kLeastDisparity), kSign = 0x80000000u;
    constexpr std::uint32_t kLargest = std::bit_cast<std::uint32_t>(std::numeric_limits<float>::max());
    const __m256i known =
        _mm256_cmpgt_epi32(_mm256_set1_epi32(static_cast<std::int32_t>((kLargest - kLeast + 1) ^ kSign)),
                           _mm256_sub_epi32(_mm256_castps_si256(d),
                                            _mm256_set1_epi32(static_cast<std::int32_t>(kLeast ^ kSign))));
    return _mm256_and_si256(_mm256_blendv_epi8(is_floor, side, beyond), known);
  }
};

/// Eight numbers below 128 as bytes.
SWEEPKIT_TARGET_AVX2 inline void store_labels(std::uint8_t* mask, __m256i labels) {
  const __m128i words = _mm_packs_epi32(_mm256_castsi256_si128(labels), _mm256_extracti128_si256(labels, 1));
  _mm_storel_epi64(reinterpret_cast<__m128i*>(mask), _mm_packs_epi16(words, words));
}
/// The same of 32.
SWEEPKIT_TARGET_AVX2 inline void store_labels(std::uint8_t* mask, __m256i a, __m256i b, __m256i c,
                                              __m256i d) {
  const __m256i bytes = _mm256_packs_epi16(_mm256_packs_epi32(a, b), _mm256_packs_epi32(c, d));
  store_32(mask, _mm256_permutevar8x32_epi32(bytes, _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7)));
}

// A step labels the eight pixels from column u on, and does with them what its kernel does; it is called for
// each eight in turn.
template <DisparityPixel D>
struct MaskStepAvx2 {
  const D* disparity;
  FloorLabelsAvx2 label;
  __m256 columns = first_columns();

  SWEEPKIT_TARGET_AVX2 __m256i operator()(int u) {
    const __m256i labels = label(load_disparity(disparity + u), columns);
    columns = _mm256_add_ps(columns, _mm256_set1_ps(8));
    return labels;
  }
};

template <DisparityPixel D>
struct PlanesStepAvx2 {
  const D* disparity;
  PlaneRows to;
  FloorLabelsAvx2 label;
  __m256 baseline, focal, cx, y;
  __m256i left_out_of_label;
  __m256 columns = first_columns();

  SWEEPKIT_TARGET_AVX2 __m256i operator()(int u) {
    const __m256 d = load_disparity(disparity + u);
    const __m256i labels = label(d, columns);
    // All ones, a NaN, where there is no point.
    const __m256 left_out = _mm256_castsi256_ps(_mm256_permutevar8x32_epi32(left_out_of_label, labels));
    const __m256 scale = _mm256_div_ps(baseline, d);
    const __m256 x = _mm256_mul_ps(scale, _mm256_sub_ps(columns, cx));
    _mm256_storeu_ps(to.x + u, _mm256_or_ps(x, left_out));
    _mm256_storeu_ps(to.y + u, _mm256_or_ps(_mm256_mul_ps(scale, y), left_out));
    _mm256_storeu_ps(to.z + u, _mm256_or_ps(_mm256_mul_ps(scale, focal), left_out));
    columns = _mm256_add_ps(columns, _mm256_set1_ps(8));
    return labels;
  }
};

/// Takes all the steps of a row and stores its mask; returns the first column that is left.
template <class Step>
SWEEPKIT_TARGET_AVX2 inline int walk_row_avx2(Step& step, int width, std::uint8_t* mask) {
  int u = 0;
  for (; u + 32 <= width; u += 32) {
    const __m256i a = step(u), b = step(u + 8), c = step(u + 16), d = step(u + 24);
    store_labels(mask + u, a, b, c, d);
  }
  for (; u + 8 <= width; u += 8) store_labels(mask + u, step(u));
  return u;
}

template <DisparityPixel D>
SWEEPKIT_TARGET_AVX2 inline void mask_row_avx2(const D* disparity, int width, const FloorRow& row,
                                               std::uint8_t* mask) {
  MaskStepAvx2<D> step{disparity, FloorLabelsAvx2(row)};
  const int u = walk_row_avx2(step, width, mask);
  mask_row_portable(disparity, u, width, row, mask);
}

template <DisparityPixel D>
SWEEPKIT_TARGET_AVX2 inline void planes_row_avx2(const D* disparity, int width, const FloorRow& row,
                                                 const CloudRow& cloud, const ChosenLabels& chosen,
                                                 std::uint8_t* mask, const PlaneRows& to) {
  PlanesStepAvx2<D> step{disparity,
                         to,
                         FloorLabelsAvx2(row),
                         _mm256_set1_ps(cloud.baseline),
                         _mm256_set1_ps(cloud.focal),
                         _mm256_set1_ps(cloud.cx),
                         _mm256_set1_ps(cloud.y),
                         _mm256_xor_si256(load_32(chosen.of_label), _mm256_set1_epi32(-1))};
  const int u = walk_row_avx2(step, width, mask);
  planes_row_portable(disparity, u, width, row, cloud, chosen, mask, to);
}

/// For each set of lanes, the lanes in it one after the other.
inline constexpr auto kLanesOfSet = [] {
  std::array<std::array<std::uint8_t, 8>, 256> lanes{};
  for (unsigned set = 0; set < 256; ++set) {
    std::size_t count = 0;
    for (std::uint8_t lane = 0; lane < 8; ++lane)
      if (set >> lane & 1) lanes[set][count++] = lane;
  }
  return lanes;
}();

/// Writes eight disparities' chosen lanes, and their pixels, the first of which is given.
SWEEPKIT_TARGET_AVX2 inline void store_chosen(__m256 d, __m256i pixel, unsigned set, float* found,
                                              std::int32_t* pixels) {
  const __m256i lanes =
      _mm256_cvtepu8_epi32(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(kLanesOfSet[set].data())));
  _mm256_storeu_ps(found, _mm256_permutevar8x32_ps(d, lanes));
  store_32(pixels, _mm256_add_epi32(lanes, pixel));
}

template <DisparityPixel D>
SWEEPKIT_TARGET_AVX2 inline std::size_t gather_row_avx2(const D* disparity, int width, const FloorRow& row,
                                                        const ChosenLabels& chosen, std::int32_t first_pixel,
                                                        std::uint8_t* mask, float* found,
                                                        std::int32_t* pixels) {
  MaskStepAvx2<D> step{disparity, FloorLabelsAvx2(row)};
  const int end = walk_row_avx2(step, width, mask);
  alignas(16) std::int8_t bytes[16] = {};
  for (int label = 0; label < 8; ++label) bytes[label] = static_cast<std::int8_t>(chosen.of_label[label]);
  const __m256i of_label = _mm256_broadcastsi128_si256(load_16(bytes));
  const __m256i eight = _mm256_set1_epi32(8);
  __m256i pixel = _mm256_set1_epi32(first_pixel);
  std::size_t count = 0;
  int u = 0;
  for (; u + 32 <= end; u += 32) {
    auto sets = static_cast<unsigned>(_mm256_movemask_epi8(_mm256_shuffle_epi8(of_label, load_32(mask + u))));
    for (int i = 0; i < 4; ++i) {
      const unsigned set = sets & 255;
      sets >>= 8;
      store_chosen(load_disparity(disparity + u + 8 * i), pixel, set, found + count, pixels + count);
      count += static_cast<std::size_t>(_mm_popcnt_u32(set));
      pixel = _mm256_add_epi32(pixel, eight);
    }
  }
  for (; u + 8 <= end; u += 8) {
    const __m128i labels = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(mask + u));
    const auto set = static_cast<unsigned>(
        _mm_movemask_epi8(_mm_shuffle_epi8(_mm256_castsi256_si128(of_label), labels)) & 255);
    store_chosen(load_disparity(disparity + u), pixel, set, found + count, pixels + count);
    count += static_cast<std::size_t>(_mm_popcnt_u32(set));
    pixel = _mm256_add_epi32(pixel, eight);
  }
  return count + gather_row_portable(disparity, end, width, row, chosen, first_pixel, mask, found + count,
                                     pixels + count);
}

SWEEPKIT_TARGET_AVX2 inline void points_avx2(const float* found, const std::int32_t* pixels,
                                             std::size_t count, std::int32_t first_pixel,
                                             const CloudRow& cloud, float* xyz) {
  const __m256 baseline = _mm256_set1_ps(cloud.baseline), focal = _mm256_set1_ps(cloud.focal);
  const __m256 cx = _mm256_set1_ps(cloud.cx), cy = _mm256_set1_ps(cloud.y);
  const __m256i first = _mm256_set1_epi32(first_pixel);
  // Of 24 numbers x0 y0 z0 x1 .., each lane modulo 8 takes every coordinate once: one permutation brings the
  // eight values of a coordinate to the lanes that they have in the three vectors of the result.
  const __m256i x_lanes = _mm256_setr_epi32(0, 3, 6, 1, 4, 7, 2, 5);
  const __m256i y_lanes = _mm256_setr_epi32(5, 0, 3, 6, 1, 4, 7, 2);
  const __m256i z_lanes = _mm256_setr_epi32(2, 5, 0, 3, 6, 1, 4, 7);
  for (std::size_t i = 0; i < count; i += 8) {
    const __m256 scale = _mm256_div_ps(baseline, _mm256_loadu_ps(found + i));
    const __m256 u = _mm256_cvtepi32_ps(_mm256_sub_epi32(load_32(pixels + i), first));
    const __m256 x = _mm256_permutevar8x32_ps(_mm256_mul_ps(scale, _mm256_sub_ps(u, cx)), x_lanes);
    const __m256 y = _mm256_permutevar8x32_ps(_mm256_mul_ps(scale, cy), y_lanes);
    const __m256 z = _mm256_permutevar8x32_ps(_mm256_mul_ps(scale, focal), z_lanes);
    float* to = xyz + 3 * i;
    _mm256_storeu_ps(to, _mm256_blend_ps(_mm256_blend_ps(x, y, 0b10010010), z, 0b00100100));
    _mm256_storeu_ps(to + 8, _mm256_blend_ps(_mm256_blend_ps(x, y, 0b00100100), z, 0b01001001));
    _mm256_storeu_ps(to + 16, _mm256_blend_ps(_mm256_blend_ps(x, y, 0b01001001), z, 0b10010010));
  }
}

}  // namespace sweepkit::impl

#endif
