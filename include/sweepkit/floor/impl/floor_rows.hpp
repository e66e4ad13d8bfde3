// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "sweepkit/core/simd.hpp"
#include "sweepkit/floor/floor_tolerance.hpp"
#include "sweepkit/image/disparity.hpp"

namespace sweepkit::impl {

/// The bounds of the floor's disparity along a row, in single precision, the same for all kernels.
struct FloorRow {
  float at_zero, along_u;          // the floor's disparity
  float upper_slope, lower_slope;  // 1 + slope, 1 - slope
  float base, above, below;
};

struct FloorBounds {
  FloorDisparity floor;
  FloorRow common;

  FloorBounds(const FloorDisparity& floor, const FloorTolerance& t)
      : floor(floor),
        common{0,
               static_cast<float>(floor.along_u),
               static_cast<float>(1 + t.slope),
               static_cast<float>(1 - t.slope),
               static_cast<float>(t.base),
               static_cast<float>(t.above),
               static_cast<float>(t.below)} {}

  FloorRow row(int v) const {
    FloorRow r = common;
    r.at_zero = static_cast<float>(floor.at_origin + floor.along_v * v);
    return r;
  }
};

/// The label of a disparity [px] in column u.
inline FloorLabel floor_label(float d, int u, const FloorRow& r) {
  const float raw = r.at_zero + r.along_u * static_cast<float>(u);
  const float f = raw > 0 ? raw : 0.0f;
  const float upper = std::max(f * r.upper_slope + r.base, f * r.above);
  const float lower = std::min(f * r.lower_slope - r.base, f * r.below);
  if (!(d > 0 && d <= std::numeric_limits<float>::max())) return FloorLabel::unknown;
  if (d > upper) return FloorLabel::obstacle;
  if (d < lower) return FloorLabel::hole;
  return f > 0 ? FloorLabel::floor : FloorLabel::unknown;
}

template <DisparityPixel D>
inline float disparity_px(D d) {
  return static_cast<float>(d) * kDisparityUnit<D>;
}

template <DisparityPixel D>
inline void mask_row(const D* disparity, int width, const FloorRow& row, std::uint8_t* mask) {
  for (int u = 0; u < width; ++u)
    mask[u] = static_cast<std::uint8_t>(floor_label(disparity_px(disparity[u]), u, row));
}

}  // namespace sweepkit::impl
