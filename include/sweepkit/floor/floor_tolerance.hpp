// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "sweepkit/core/options.hpp"
#include "sweepkit/floor/ground_plane.hpp"

namespace sweepkit {

/// What a pixel shows beside the floor; the values of a mask.
enum class FloorLabel : std::uint8_t { unknown = 0, floor = 1, obstacle = 2, hole = 3 };

/// What is known of the errors of disparities on the floor and of the floor's plane, and what is too low to
/// matter. The defaults were measured on simulated recordings with semi-global matching that expects the
/// floor.
struct FloorNoise {
  double sigma = 0.5;
  double sigma_per_disparity = 0.0;
  double sigma_pitch = 0.05;
  double sigma_height = 0.0007;
  double factor = 4.0;
  double min_height = 0.0;
  double min_depth = 0.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(sigma, "sigma", "px", range(0.0, 10.0), "standard deviation of a disparity on far floor");
    v(sigma_per_disparity, "sigma_per_disparity", "", range(0.0, 1.0),
      "part of the floor's disparity by which it grows towards the camera");
    v(sigma_pitch, "sigma_pitch", "deg", range(0.0, 10.0), "standard deviation of the floor's tilt");
    v(sigma_height, "sigma_height", "m", range(0.0, 1.0), "standard deviation of the camera's height");
    v(factor, "factor", "", range(0.0, 100.0), "standard deviations that still count as floor");
    v(min_height, "min_height", "m", range(0.0, 10.0), "what rises less above the floor is floor");
    v(min_depth, "min_depth", "m", range(0.0, 10.0), "what lies less below the floor is floor");
  }
};

/// How far a disparity may lie off the floor's and still be floor, as a function of the floor's disparity f
/// [px], which counts as 0 above the horizon: max(base + slope * f, above * f) towards the camera and
/// max(base + slope * f, below * f) away from it.
struct FloorTolerance {
  double base = 0.0;   ///< [px]
  double slope = 0.0;  ///< [1]
  double above = 0.0;  ///< y / (h - y) for points up to y over the floor, the camera being h over it
  double below = 0.0;  ///< y / (h + y) for points down to y below the floor

  double towards(double floor) const { return beyond(floor, above); }
  double away(double floor) const { return beyond(floor, below); }

  /// The floor's disparity is focal baseline (down . r) / height: a tilt by e moves it by focal baseline e /
  /// height, an error of the height by its part of the height. These and the disparity's own errors are
  /// independent; the root of their squares is convex in f, its chord from 0 to kNear lies above it.
  static FloorTolerance of(const FloorNoise& noise, const GroundPlane& plane, const RectifiedCamera& camera) {
    constexpr double kNear = 128.0;  // [px]
    const double tilt =
        camera.focal * camera.baseline / plane.height * noise.sigma_pitch * std::numbers::pi / 180;
    const double far = std::hypot(noise.sigma, tilt);
    const double near = std::hypot(noise.sigma + noise.sigma_per_disparity * kNear, tilt,
                                   kNear * noise.sigma_height / plane.height);
    FloorTolerance t;
    t.base = noise.factor * far;
    t.slope = noise.factor * (near - far) / kNear;
    // At the camera's height and above, every disparity counts as higher.
    t.above = noise.min_height / std::max(plane.height - noise.min_height, 1e-3 * plane.height);
    t.below = noise.min_depth / (plane.height + noise.min_depth);
    return t;
  }

 private:
  double beyond(double floor, double part) const {
    const double f = std::max(floor, 0.0);
    return std::max(base + slope * f, part * f);
  }
};

}  // namespace sweepkit
