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
using LanesInt = int __attribute__((vector_size(32)));

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

/// Samples at (x, y), (x + step_x, y + step_y), ... by bilinear interpolation; all must lie inside.
template <int Count>
SWEEPKIT_ALWAYS_INLINE void bilinear(GrayView image, float x, float y, float step_x, float step_y,
                                     float* values) {
  static_assert(Count % 8 == 0);
  const Lanes ramp = {0, 1, 2, 3, 4, 5, 6, 7};
  for (int i = 0; i < Count; i += 8) {
    const Lanes xs = x + (ramp + static_cast<float>(i)) * step_x;
    const Lanes ys = y + (ramp + static_cast<float>(i)) * step_y;
    // Positions are positive: truncation is floor.
    const LanesInt xi = __builtin_convertvector(xs, LanesInt), yi = __builtin_convertvector(ys, LanesInt);
    const Lanes fx = xs - __builtin_convertvector(xi, Lanes), fy = ys - __builtin_convertvector(yi, Lanes);
    Lanes a, b, c, d;
    for (int l = 0; l < 8; ++l) {
      const std::uint8_t* p = image.row(yi[l]) + xi[l];
      a[l] = p[0];
      b[l] = p[1];
      c[l] = p[image.stride];
      d[l] = p[image.stride + 1];
    }
    const Lanes top = a + fx * (b - a), bottom = c + fx * (d - c);
    const Lanes value = top + fy * (bottom - top);
    std::memcpy(values + i, &value, sizeof(value));
  }
}

}  // namespace sweepkit
