// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/core/view.hpp"
#include "sweepkit/floor/ground_plane.hpp"

namespace sweepkit::test {

inline constexpr double kDegree = std::numbers::pi / 180.0;

/// A camera at 8 cm above a floor.
inline constexpr RectifiedCamera kFloorCamera{350.0, 320.0, 200.0, 0.06};

/// @param pitch down [deg] @param roll [deg] @param height [m]
inline GroundPlane plane_of(double pitch, double roll, double height) {
  const double p = pitch * kDegree, r = roll * kDegree;
  return {{std::cos(p) * std::sin(r), std::cos(p) * std::cos(r), std::sin(p)}, height};
}

/// Disparities in px of 640 x 400 pixels; 0 where nothing is seen.
struct FloorImage {
  static constexpr int kWidth = 640, kHeight = 400;
  std::vector<float> disparity = std::vector<float>(kWidth * kHeight, 0.0f);

  View2d<const float> view() const { return {disparity.data(), kWidth, kHeight}; }

  /// A plane where its depth lies in [near, far]; what is nearer hides it.
  void add_plane(const GroundPlane& plane, double near = 0.0, double far = 100.0, int u_min = 0,
                 int u_max = kWidth) {
    const FloorDisparity floor = plane.disparity(kFloorCamera);
    for (int v = 0; v < kHeight; ++v)
      for (int u = u_min; u < u_max; ++u) {
        const double d = floor(u, v);
        if (!(d > 0.5 && d < 128)) continue;
        const double depth = kFloorCamera.depth(d);
        if (depth >= near && depth <= far) put(u, v, d);
      }
  }
  void add_wall(double depth) {
    for (int v = 0; v < kHeight; ++v)
      for (int u = 0; u < kWidth; ++u) put(u, v, kFloorCamera.disparity(depth));
  }
  /// @param outliers share of pixels that show anything
  void add_noise(Random& random, double sigma, double outliers) {
    for (float& d : disparity) {
      if (d > 0) d += static_cast<float>(random.normal(0.0, sigma));
      if (random.uniform() < outliers) d = static_cast<float>(random.uniform(1.0, 128.0));
    }
  }
  std::vector<std::int16_t> fixed_point() const {
    std::vector<std::int16_t> fixed;
    for (const float d : disparity) fixed.push_back(static_cast<std::int16_t>(std::lround(d * 16)));
    return fixed;
  }

 private:
  void put(int u, int v, double d) {
    float& pixel = disparity[static_cast<std::size_t>(v * kWidth + u)];
    if (d > pixel) pixel = static_cast<float>(d);
  }
};

}  // namespace sweepkit::test
