// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "sweepkit/core/ids.hpp"
#include "sweepkit/core/time.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/motion/integrators.hpp"

namespace sweepkit {

/// A key point as frames and maps keep it: in the rectified left camera, with what stereo said about it.
struct Measurement {
  float u = 0;         ///< column in the rectified left image [px]
  float v = 0;         ///< row in the rectified left image [px]
  float u_right = -1;  ///< column in the rectified right image, negative when there is no stereo match [px]
  float sigma = 1;     ///< standard deviation of u and v [px]
  float sigma_right = 1;    ///< standard deviation of u - u_right, the disparity [px]
  float angle = 0;          ///< orientation in the raw image [rad]
  std::int32_t octave = 0;  ///< pyramid level, 0 the full image

  bool stereo() const { return u_right >= 0; }
  float disparity() const { return u - u_right; }
  /// Takes a bias off the disparity [px]; a match that would lie at infinity is none any more.
  void shift_disparity(double bias) {
    if (!stereo()) return;
    u_right += static_cast<float>(bias);
    if (!(disparity() > 0)) u_right = -1;
  }
};

/// A keyframe that shares points with another, and how many.
struct Covisible {
  KeyframeId keyframe;
  int points = 0;
};

/// The motion since the keyframe before in time, as wheels and IMU measured it without looking.
struct OdometryEdge {
  KeyframeId from;
  UncertainMotion<double> motion;  ///< T_from_this between the two cameras
};

/// A frame that the map remembers. Its measurements stay as they are (but see Map::shift_disparities);
/// `points[i]` is the map point seen at measurement i.
struct Keyframe {
  KeyframeId id;
  MapId map;
  TimeNs t = 0;
  SE3d T_camera_world;  ///< world to the rectified left camera
  std::vector<Measurement> measurements;
  std::vector<OrbDescriptor> descriptors;
  std::vector<PointId> points;
  std::vector<Covisible> covisible;  ///< sorted by keyframe; every count is at least 1
  KeyframeId parent;                 ///< in the spanning tree; none for the first of a map
  std::optional<OdometryEdge> odometry;
  /// Of T_camera_world as PoseResult has it, against the first keyframe of the map: what tracking and
  /// odometry added up to on the way.
  Mat6<double> covariance = Mat6<double>::Zero();

  /// Made while nothing could be seen: it knows its pose by odometry alone.
  bool blind() const { return measurements.empty(); }
};

}  // namespace sweepkit
