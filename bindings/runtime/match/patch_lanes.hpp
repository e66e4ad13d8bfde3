// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstring>

#include "sweepkit/core/simd.hpp"
#include "sweepkit/core/view.hpp"

/// Inlined into a portable and an AVX2 function alike, which so do the same operations in the same order.
#define SWEEPKIT_ALWAYS_INLINE [[gnu::always_inline]] inline

namespace sweepkit {

/// Eight floats: one AVX2 register, or two SSE ones. Sums over patches keep eight partial sums in either
/// case.
using Lanes = float __attribute__((vector_size(32)));

SWEEPKIT_ALWAYS_INLINE void load(const float* p, Lanes& lanes) { std::memcpy(&lanes, p, sizeof(lanes)); }

SWEEPKIT_ALWAYS_INLINE float add_lanes(const Lanes& x) {
  return ((x[0] + x[4]) + (x[2] + x[6])) + ((x[1] + x[5]) + (x[3] + x[7]));
}

/// Bytes to floats.
template <int Count>
SWEEPKIT_ALWAYS_INLINE void widen(const std::uint8_t* pixels, float* values) {
  static_assert(Count % 8 == 0);
  using Bytes = std::uint8_t __attribute__((vector_size(8)));
  for (int i = 0; i < Count; i += 8) {
    Bytes bytes;
    std::memcpy(&bytes, pixels + i, 8);
    const Lanes wide = __builtin_convertvector(bytes, Lanes);
    std::memcpy(values + i, &wide, sizeof(wide));
  }
}

/// Sixteen samples at (x, y), (x + step_x, y + step_y), ... by bilinear interpolation. All positions must lie
/// at least 1 px inside the image.
struct PortableSampler {
  static void bilinear(const GrayView& image, float x, float y, float step_x, float step_y, float* values) {
    for (int i = 0; i < 16; ++i) {
      const float xs = x + static_cast<float>(i) * step_x, ys = y + static_cast<float>(i) * step_y;
      // Positions are positive: truncation is floor.
      const int xi = static_cast<int>(xs), yi = static_cast<int>(ys);
      const float fx = xs - static_cast<float>(xi), fy = ys - static_cast<float>(yi);
      const std::uint8_t* p = image.row(yi) + xi;
      const float a = p[0], b = p[1], c = p[image.stride], d = p[image.stride + 1];
      const float top = a + fx * (b - a), bottom = c + fx * (d - c);
      values[i] = top + fy * (bottom - top);
    }
  }
};

#ifdef SWEEPKIT_HAVE_AVX2
/// The same with gathers. Reads up to 2 bytes behind the four pixels of a sample, which lie in the image's
/// padding at worst.
struct Avx2Sampler {
  SWEEPKIT_TARGET_AVX2 static void bilinear(const GrayView& image, float x, float y, float step_x,
                                            float step_y, float* values) {
    const __m256i stride = _mm256_set1_epi32(static_cast<int>(image.stride)), byte = _mm256_set1_epi32(255);
    const auto* first = reinterpret_cast<const int*>(image.data);
    const auto* below = reinterpret_cast<const int*>(image.data + image.stride);
    const __m256 sx = _mm256_set1_ps(step_x), sy = _mm256_set1_ps(step_y);
    __m256 ramp = _mm256_setr_ps(0, 1, 2, 3, 4, 5, 6, 7);
    for (int i = 0; i < 16; i += 8, ramp = _mm256_add_ps(ramp, _mm256_set1_ps(8))) {
      const __m256 xs = _mm256_add_ps(_mm256_set1_ps(x), _mm256_mul_ps(ramp, sx));
      const __m256 ys = _mm256_add_ps(_mm256_set1_ps(y), _mm256_mul_ps(ramp, sy));
      const __m256i xi = _mm256_cvttps_epi32(xs), yi = _mm256_cvttps_epi32(ys);
      const __m256 fx = _mm256_sub_ps(xs, _mm256_cvtepi32_ps(xi)),
                   fy = _mm256_sub_ps(ys, _mm256_cvtepi32_ps(yi));
      const __m256i offset = _mm256_add_epi32(_mm256_mullo_epi32(yi, stride), xi);
      const __m256i ab = _mm256_i32gather_epi32(first, offset, 1),
                    cd = _mm256_i32gather_epi32(below, offset, 1);
      const auto low = [&](__m256i pair)
                           SWEEPKIT_TARGET_AVX2 { return _mm256_cvtepi32_ps(_mm256_and_si256(pair, byte)); };
      const auto high = [&](__m256i pair) SWEEPKIT_TARGET_AVX2 {
        return _mm256_cvtepi32_ps(_mm256_and_si256(_mm256_srli_epi32(pair, 8), byte));
      };
      const __m256 a = low(ab), b = high(ab), c = low(cd), d = high(cd);
      const __m256 top = _mm256_add_ps(a, _mm256_mul_ps(fx, _mm256_sub_ps(b, a)));
      const __m256 bottom = _mm256_add_ps(c, _mm256_mul_ps(fx, _mm256_sub_ps(d, c)));
      _mm256_storeu_ps(values + i, _mm256_add_ps(top, _mm256_mul_ps(fy, _mm256_sub_ps(bottom, top))));
    }
  }
};
#endif

}  // namespace sweepkit
