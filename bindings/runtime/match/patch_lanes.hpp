// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>

#include "sweepkit/core/simd.hpp"
#include "sweepkit/core/view.hpp"
#include "sweepkit/geometry/so3.hpp"

/// Inlined into a portable and an AVX2 function alike, which so do the same
/// operations in the same order.
#define SWEEPKIT_ALWAYS_INLINE __attribute__((always_inline)) inline

namespace sweepkit {

/// Eight floats: one AVX2 register, or two SSE ones. Sums over patches keep
/// eight partial sums in either case.
using Lanes = float __attribute__((vector_size(32)));
using IntLanes = int __attribute__((vector_size(32)));
using HalfLanes = float __attribute__((vector_size(16)));

SWEEPKIT_ALWAYS_INLINE void load(const float* p, Lanes& lanes) { std::memcpy(&lanes, p, sizeof(lanes)); }

SWEEPKIT_ALWAYS_INLINE float add_lanes(const Lanes& x) {
  return ((x[0] + x[4]) + (x[2] + x[6])) + ((x[1] + x[5]) + (x[3] + x[7]));
}

/// The same of four at once.
SWEEPKIT_ALWAYS_INLINE HalfLanes add_lanes(const Lanes& a, const Lanes& b, const Lanes& c, const Lanes& d) {
  const auto fold = [](const Lanes& x) __attribute__((always_inline)) {
    HalfLanes low, high;
    std::memcpy(&low, &x, sizeof(low));
    std::memcpy(&high, reinterpret_cast<const char*>(&x) + sizeof(low), sizeof(high));
    return low + high;
  };
  const HalfLanes a4 = fold(a), b4 = fold(b), c4 = fold(c), d4 = fold(d);
  const HalfLanes ab = __builtin_shufflevector(a4, b4, 0, 4, 1, 5) +
                       __builtin_shufflevector(a4, b4, 2, 6, 3, 7),
                  cd = __builtin_shufflevector(c4, d4, 0, 4, 1, 5) +
                       __builtin_shufflevector(c4, d4, 2, 6, 3, 7);
  return __builtin_shufflevector(ab, cd, 0, 1, 4, 5) + __builtin_shufflevector(ab, cd, 2, 3, 6, 7);
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
  /// Rows of sixteen pixels, row j from `first + j * stride + offset[j]`.
  static void copy_rows(const std::uint8_t* first, std::ptrdiff_t stride, const int* offset, int rows,
                        float (*values)[16]) {
    for (int j = 0; j < rows; ++j, first += stride)
      for (int i = 0; i < 16; ++i) values[j][i] = first[offset[j] + i];
  }

  /// Rows of sixteen samples, sample i of row j at `origin + (offset[j] + i) * step_u + j * step_v`.
  static void bilinear_rows(const GrayView& image, const Vec2<float>& origin, const Vec2<float>& step_u,
                            const Vec2<float>& step_v, const int* offset, int rows, float (*values)[16]) {
    for (int j = 0; j < rows; ++j) {
      const auto u = static_cast<float>(offset[j]), v = static_cast<float>(j);
      bilinear(image, origin.x() + v * step_v.x() + u * step_u.x(),
               origin.y() + v * step_v.y() + u * step_u.y(), step_u.x(), step_u.y(), values[j]);
    }
  }

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
/// The same, eight samples at once.
struct Avx2Sampler {
  SWEEPKIT_TARGET_AVX2 static void copy_rows(const std::uint8_t* first, std::ptrdiff_t stride,
                                             const int* offset, int rows, float (*values)[16]) {
    for (int j = 0; j < rows; ++j, first += stride) {
      const __m128i bytes = impl::load_16(first + offset[j]);
      _mm256_storeu_ps(values[j], _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(bytes)));
      _mm256_storeu_ps(values[j] + 8, _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_srli_si128(bytes, 8))));
    }
  }

  SWEEPKIT_TARGET_AVX2 static void bilinear_rows(const GrayView& image, const Vec2<float>& origin,
                                                 const Vec2<float>& step_u, const Vec2<float>& step_v,
                                                 const int* offset, int rows, float (*values)[16]) {
    const float ux = step_u.x(), uy = step_u.y(), vx = step_v.x(), vy = step_v.y(), x = origin.x(),
                y = origin.y();
    const bool flat = is_flat(image, ux, uy);
    for (int j = 0; j < rows; ++j) {
      const auto u = static_cast<float>(offset[j]), v = static_cast<float>(j);
      const float row_x = x + v * vx + u * ux, row_y = y + v * vy + u * uy;
      if (flat)
        sample<shuffle>(image, row_x, row_y, ux, uy, values[j]);
      else
        sample<gather>(image, row_x, row_y, ux, uy, values[j]);
    }
  }

  SWEEPKIT_TARGET_AVX2 static void bilinear(const GrayView& image, float x, float y, float step_x,
                                            float step_y, float* values) {
    if (is_flat(image, step_x, step_y))
      sample<shuffle>(image, x, y, step_x, step_y, values);
    else
      sample<gather>(image, x, y, step_x, step_y, values);
  }

 private:
  struct Pixels {
    __m256i a, b, c, d;  // left, right; those below
  };

  // Along a nearly horizontal line eight samples lie in 3 rows of 16 pixels, which bytes are shuffled from.
  static bool is_flat(const GrayView& image, float step_x, float step_y) {
    return step_x > 0 && step_x < 1.9f && std::abs(step_y) < 0.125f && image.width >= 16 && image.height >= 3;
  }

  template <void (*fetch)(const GrayView&, __m256i, __m256i, Pixels&)>
  SWEEPKIT_TARGET_AVX2 SWEEPKIT_ALWAYS_INLINE static void sample(const GrayView& image, float x, float y,
                                                                 float step_x, float step_y, float* values) {
    const __m256 sx = _mm256_set1_ps(step_x), sy = _mm256_set1_ps(step_y);
    __m256 ramp = _mm256_setr_ps(0, 1, 2, 3, 4, 5, 6, 7);
    for (int i = 0; i < 16; i += 8, ramp = _mm256_add_ps(ramp, _mm256_set1_ps(8))) {
      const __m256 xs = _mm256_add_ps(_mm256_set1_ps(x), _mm256_mul_ps(ramp, sx));
      const __m256 ys = _mm256_add_ps(_mm256_set1_ps(y), _mm256_mul_ps(ramp, sy));
      const __m256i xi = _mm256_cvttps_epi32(xs), yi = _mm256_cvttps_epi32(ys);
      const __m256 fx = _mm256_sub_ps(xs, _mm256_cvtepi32_ps(xi)),
                   fy = _mm256_sub_ps(ys, _mm256_cvtepi32_ps(yi));
      Pixels pixels;
      fetch(image, xi, yi, pixels);
      const __m256 a = _mm256_cvtepi32_ps(pixels.a), b = _mm256_cvtepi32_ps(pixels.b),
                   c = _mm256_cvtepi32_ps(pixels.c), d = _mm256_cvtepi32_ps(pixels.d);
      const __m256 top = _mm256_add_ps(a, _mm256_mul_ps(fx, _mm256_sub_ps(b, a)));
      const __m256 bottom = _mm256_add_ps(c, _mm256_mul_ps(fx, _mm256_sub_ps(d, c)));
      _mm256_storeu_ps(values + i, _mm256_add_ps(top, _mm256_mul_ps(fy, _mm256_sub_ps(bottom, top))));
    }
  }

  // Reads up to 2 bytes behind the four pixels of a sample: of the next row at worst.
  SWEEPKIT_TARGET_AVX2 static void gather(const GrayView& image, __m256i xi, __m256i yi, Pixels& pixels) {
    const __m256i stride = _mm256_set1_epi32(static_cast<int>(image.stride)), byte = _mm256_set1_epi32(255);
    const __m256i offset = _mm256_add_epi32(_mm256_mullo_epi32(yi, stride), xi);
    const __m256i above = _mm256_i32gather_epi32(reinterpret_cast<const int*>(image.data), offset, 1),
                  below = _mm256_i32gather_epi32(reinterpret_cast<const int*>(image.data + image.stride),
                                                 offset, 1);
    pixels.a = _mm256_and_si256(above, byte);
    pixels.b = _mm256_and_si256(_mm256_srli_epi32(above, 8), byte);
    pixels.c = _mm256_and_si256(below, byte);
    pixels.d = _mm256_and_si256(_mm256_srli_epi32(below, 8), byte);
  }

  SWEEPKIT_TARGET_AVX2 SWEEPKIT_ALWAYS_INLINE static void shuffle(const GrayView& image, __m256i xi,
                                                                  __m256i yi, Pixels& pixels) {
    const int x = std::min(_mm256_cvtsi256_si32(xi), image.width - 16),
              y = std::min({_mm256_cvtsi256_si32(yi), _mm256_extract_epi32(yi, 7), image.height - 3});
    const std::uint8_t* p = image.row(y) + x;
    const __m256i row0 = _mm256_broadcastsi128_si256(impl::load_16(p)),
                  row1 = _mm256_broadcastsi128_si256(impl::load_16(p + image.stride)),
                  row2 = _mm256_broadcastsi128_si256(impl::load_16(p + 2 * image.stride));
    // One byte a lane; those with the highest bit set give 0.
    const __m256i left = _mm256_or_si256(_mm256_sub_epi32(xi, _mm256_set1_epi32(x)),
                                         _mm256_set1_epi32(static_cast<int>(0x80808000u)));
    const __m256i right = _mm256_add_epi32(left, _mm256_set1_epi32(1));
    const __m256i lower = _mm256_cmpgt_epi32(yi, _mm256_set1_epi32(y));
    const __m256i left1 = _mm256_shuffle_epi8(row1, left), right1 = _mm256_shuffle_epi8(row1, right);
    pixels.a = _mm256_blendv_epi8(_mm256_shuffle_epi8(row0, left), left1, lower);
    pixels.b = _mm256_blendv_epi8(_mm256_shuffle_epi8(row0, right), right1, lower);
    pixels.c = _mm256_blendv_epi8(left1, _mm256_shuffle_epi8(row2, left), lower);
    pixels.d = _mm256_blendv_epi8(right1, _mm256_shuffle_epi8(row2, right), lower);
  }
};
#endif

}  // namespace sweepkit
