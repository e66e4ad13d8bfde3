// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>

#include "sweepkit/core/sample.hpp"
#include "sweepkit/geometry/camera.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/motion/mounting.hpp"

namespace sweepkit {

/// A camera and where it sits on the body.
struct MountedCamera {
  Camera camera;
  SE3d T_body_camera;
  double rate_hz = 0.0;  ///< nominal; 0 if unknown
};

/// The sensors that a source has. The body frame is the IMU's; without an IMU it is the frame to which the
/// mounting of the cameras refers.
struct Rig {
  std::optional<MountedCamera> left;
  std::optional<MountedCamera> right;
  std::optional<MountedImu> imu;
  std::optional<MountedWheels> wheels;

  MotionSensors motion() const { return {imu, wheels}; }

  bool has_stereo() const { return left && right; }
  /// The pair of cameras. @throws Error(calibration) if one is missing or they are no pair
  StereoRig stereo() const {
    if (!has_stereo())
      throw Error(ErrorKind::calibration, left ? "cam1" : "cam0", "is missing: two cameras are needed");
    return StereoRig(left->camera, right->camera, left->T_body_camera, right->T_body_camera);
  }
};

/// Where samples come from, live or recorded. One thread calls it.
class Source {
 public:
  virtual ~Source() = default;

  virtual const Rig& rig() const = 0;

  /// The next sample in the order of the stamps; of equal stamps the IMU's first, then the wheels', then the
  /// images. A live source waits for it. Nothing at the end.
  /// @throws Error naming file and line where a recording is damaged; what came before stays valid
  virtual std::optional<Sample> next() = 0;
};

}  // namespace sweepkit
