// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>

#include "sweepkit/core/sample.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// An inertial unit. With one, the body frame is its frame and T_body_imu the identity.
struct MountedImu {
  SE3d T_body_imu;
  ImuNoise noise;
  double rate_hz = 0.0;  ///< nominal; 0 if unknown
};

/// The drive. Its base frame: x forward, y left, z up, on the floor in the middle between the drive wheels.
struct MountedWheels {
  SE3d T_body_base;
  WheelGeometry geometry;
  double rate_hz = 0.0;  ///< nominal; 0 if unknown
};

/// What tells a robot how it moves without looking; either may be absent.
struct MotionSensors {
  std::optional<MountedImu> imu;
  std::optional<MountedWheels> wheels;
};

}  // namespace sweepkit
