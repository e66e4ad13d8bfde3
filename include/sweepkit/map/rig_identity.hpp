// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "sweepkit/geometry/camera.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"

namespace sweepkit {

/// The numbers that describe a camera of a rig.
struct CameraIdentity {
  int width = 0, height = 0;       ///< [px]
  std::vector<double> intrinsics;  ///< fx, fy, cx, cy [px]
  Distortion distortion = Distortion::none;
  std::vector<double> coefficients;  ///< of the distortion
  SE3d T_body_camera;                ///< raw camera to body
};

/// What the measurements of a map rest on: with another rig they say something else.
struct RigIdentity {
  CameraIdentity left, right;
};

/// How far two descriptions of one rig may lie apart: what is lost when a calibration is written with fewer
/// digits, and far below what the measurements of a map can tell.
struct RigTolerance {
  double pixels = 1e-3;        ///< intrinsics [px]
  double coefficients = 1e-6;  ///< of the distortion
  double position = 1e-5;      ///< [m]
  double angle = 1e-5;         ///< [rad]
};

RigIdentity identity_of(const StereoRig& rig);

/// The first difference of two rigs in words, "left fx: 435.2 there, 458.7 here (tolerance 0.001 px)";
/// nothing if they are one.
std::optional<std::string> difference(const RigIdentity& there, const RigIdentity& here,
                                      const RigTolerance& tolerance = {});

}  // namespace sweepkit
