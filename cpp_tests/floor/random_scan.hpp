// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "sweepkit/core/random.hpp"
#include "sweepkit/floor/floor_scan.hpp"
#include "sweepkit/floor/planar_pose.hpp"

namespace sweepkit {

/// A scan with floor, then an obstacle or a hole on most rays.
inline FloorScan random_scan(Random& random, int bearings = 61, double max_range = 3.0) {
  FloorScan scan;
  scan.bearings = bearings;
  scan.bearing_step = 1.4 / bearings;
  scan.first_bearing = -0.5 * (bearings - 1) * scan.bearing_step;
  scan.range_noise = 0.013;
  scan.footprint = {-0.12, 0.01};
  scan.footprint_radius = 0.15;
  for (int i = 0; i < bearings; ++i) {
    const double from = random.uniform(0.1, 0.3), to = random.uniform(0.4, max_range);
    const auto mm = [](double r) { return static_cast<std::uint16_t>(1000 * r); };
    scan.stretches.push_back({static_cast<std::uint16_t>(i), mm(from), mm(to), FloorLabel::floor, 10});
    if (random.uniform() < 0.8)
      scan.stretches.push_back({static_cast<std::uint16_t>(i), mm(to), mm(to),
                                random.uniform() < 0.9 ? FloorLabel::obstacle : FloorLabel::hole, 5});
  }
  return scan;
}

inline PlanarPose random_pose(Random& random, double extent = 3.0) {
  return {random.uniform(-extent, extent), random.uniform(-extent, extent), random.uniform(-3.1, 3.1)};
}

}  // namespace sweepkit
