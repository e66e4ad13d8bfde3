// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <type_traits>

#include "sweepkit/core/random.hpp"
#include "sweepkit/floor/ground_plane.hpp"
#include "sweepkit/image/disparity.hpp"
#include "sweepkit/image/image.hpp"

namespace sweepkit {

/// A camera 8 cm above the floor, pitched and rolled a little.
inline const RectifiedCamera kFloorCamera{320.0, 318.7, 201.3, 0.06};
inline GroundPlane tilted_floor() { return {Vec3<double>(0.02, 1.0, 0.05).normalized(), 0.08}; }

/// Disparities about the floor's, on both sides of every bound, with all that is no disparity in between.
template <DisparityPixel D>
Image<D> random_disparities(int width, int height, const FloorDisparity& floor, std::uint64_t seed) {
  Random random(seed);
  Image<D> image(width, height);
  const float odd[] = {0.0f,
                       -0.0f,
                       -1.0f,
                       -1e30f,
                       std::numeric_limits<float>::quiet_NaN(),
                       -std::numeric_limits<float>::quiet_NaN(),
                       std::numeric_limits<float>::infinity(),
                       -std::numeric_limits<float>::infinity(),
                       std::numeric_limits<float>::max(),
                       std::numeric_limits<float>::min(),
                       std::numeric_limits<float>::denorm_min()};
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u) {
      const double f = floor(u, v);
      const double off = random.normal(0, random.index(3) == 0 ? 20 : 1.5);
      const double units = (f + off) / static_cast<double>(kDisparityUnit<D>);
      if constexpr (std::is_same_v<D, float>)
        image(u, v) = random.index(5) == 0 ? odd[random.index(std::size(odd))] : static_cast<float>(units);
      else
        image(u, v) = static_cast<D>(random.index(5) == 0 ? -16 : std::lround(units));
    }
  return image;
}

}  // namespace sweepkit
