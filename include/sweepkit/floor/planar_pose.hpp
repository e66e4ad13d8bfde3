// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <optional>

#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// A place on the floor and a heading, in the map's frame whose z points up.
struct PlanarPose {
  double x = 0.0;    ///< [m]
  double y = 0.0;    ///< [m]
  double yaw = 0.0;  ///< counter-clockwise from the map's x axis [rad]

  /// What is left of a pose seen from above; nothing if its z axis is tilted by more than max_tilt [rad]
  /// against the map's, or its x axis points up.
  static std::optional<PlanarPose> of(const SE3d& T_map_scan, double max_tilt) {
    const Mat3<double> R = T_map_scan.rotation().matrix();
    if (!(R(2, 2) >= std::cos(max_tilt)) || std::hypot(R(0, 0), R(1, 0)) < 1e-6) return std::nullopt;
    const Vec3<double>& t = T_map_scan.translation();
    if (!std::isfinite(t.x()) || !std::isfinite(t.y())) return std::nullopt;
    return PlanarPose{t.x(), t.y(), std::atan2(R(1, 0), R(0, 0))};
  }

  friend bool operator==(const PlanarPose&, const PlanarPose&) = default;
};

}  // namespace sweepkit
