// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdint>

#include "sweepkit/core/view.hpp"
#include "sweepkit/feature/impl/moments.hpp"

namespace sweepkit {

/// First moments of the grey values in a disc around a pixel.
struct PatchMoments {
  std::int32_t x = 0;  ///< sum of dx * value
  std::int32_t y = 0;  ///< sum of dy * value

  friend bool operator==(const PatchMoments&, const PatchMoments&) = default;
};

/// Radius of the disc that gives a key point its orientation [px].
inline constexpr int kOrientationRadius = impl::kMomentRadius;

/// Moments over the disc of kOrientationRadius around (x, y), which lies at least that far from the sides.
inline PatchMoments patch_moments(GrayView image, int x, int y) {
  PatchMoments m;
  impl::patch_moments(image.row(y) + x, image.stride, x + impl::kMomentRadius + 1 < image.width, m.x, m.y);
  return m;
}

/// Direction from the disc's centre to its intensity centroid [rad], in (-pi, pi]; 0 for a disc without one
/// (P. L. Rosin, "Measuring corner properties", 1999, as in ORB).
inline float centroid_angle(PatchMoments m) {
  return std::atan2(static_cast<float>(m.y), static_cast<float>(m.x));
}

}  // namespace sweepkit
