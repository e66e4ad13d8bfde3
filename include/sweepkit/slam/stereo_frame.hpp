// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "sweepkit/map/keyframe.hpp"
#include "sweepkit/match/projection.hpp"

namespace sweepkit {

/// One stereo image on its way through the frame path. Each stage completes it and passes it on: extraction
/// and stereo matching fill the measurements, tracking the points and the pose.
struct StereoFrame {
  TimeNs t = 0;
  std::vector<Measurement> measurements;
  std::vector<OrbDescriptor> descriptors;
  double disparity_bias = 0;                       ///< that was taken off all disparities [px]
  KeypointGrid grid;                               ///< over the measurements
  std::vector<PointId> points;                     ///< the map point seen at each measurement, or none
  SE3d T_camera_world;                             ///< world to the rectified left camera
  Mat6<double> covariance = Mat6<double>::Zero();  ///< of T_camera_world as PoseResult has it
  KeyframeId reference;                            ///< newest keyframe when it was tracked
  SE3d T_camera_reference;                         ///< this frame against that keyframe
};

}  // namespace sweepkit
