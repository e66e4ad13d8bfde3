// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/time.hpp"
#include "sweepkit/floor/floor_tolerance.hpp"
#include "sweepkit/floor/ground_plane_estimator.hpp"
#include "sweepkit/floor/obstacle_tracker.hpp"
#include "sweepkit/floor/obstacles.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/image/dense_disparity.hpp"

namespace sweepkit {

/// From a raw stereo pair to obstacles.
struct ObstacleDetectorOptions {
  bool floor_ramp = false;
  DisparityOptions disparity{.method = DisparityMethod::sgbm_3way, .near = true, .smooth = {}};
  GroundPlaneOptions plane;
  FloorNoise noise;
  ObstacleOptions obstacles;
  ObstacleTrackerOptions tracking;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(floor_ramp, "floor_ramp", "", any_value(),
      "match relative to the floor's disparity: fewer errors on the floor, more on what stands upright");
    v.group(disparity, "disparity", "dense stereo");
    v.group(plane, "plane", "the ground plane");
    v.group(noise, "noise", "how far the floor's disparities may lie off its plane");
    v.group(obstacles, "obstacles", "from pixels to things");
    v.group(tracking, "tracking", "confidence over time");
  }
};

/// Times of an image's steps [ms].
struct ObstacleTimes {
  double disparity = 0.0;  ///< rectification and matching
  double plane = 0.0;
  double mask = 0.0;
  double obstacles = 0.0;  ///< and tracking
  double total() const { return disparity + plane + mask + obstacles; }
};

/// What a detector makes of an image. Views and references hold until the next image.
struct ObstacleFrame {
  TimeNs t = 0;
  GrayView left;  ///< rectified
  DisparityView disparity;
  GroundPlaneResult plane;
  FloorTolerance tolerance;             ///< of the mask
  GrayView mask;                        ///< a FloorLabel a pixel; all unknown while the robot is lifted
  View2d<const std::uint16_t> regions;  ///< as ObstacleFinder::regions
  std::span<const Obstacle> obstacles;
  std::span<const TrackedObstacle> tracked;  ///< empty unless poses are given
  ObstacleTimes times;
};

/// Where the robot was when an image was taken; both may be unknown.
struct ObstaclePose {
  /// The rectified left camera in a frame with z up that moves smoothly: odom.
  std::optional<SE3d> T_odom_camera;
  /// Of the motion since the last image, as GroundPlaneStep::Motion has it.
  Mat6<double> motion_covariance =
      (Eigen::Matrix<double, 6, 1>() << 1e-4, 1e-4, 1e-4, 3e-6, 3e-6, 3e-6).finished().asDiagonal();
};

/// Dense stereo, ground plane, mask, obstacles and their confidence over time, on raw pairs of a rig, image
/// by image. Deterministic; one thread at a time; keeps its memory.
class ObstacleDetector {
 public:
  /// @param seed the floor as calibration has it, in the rectified left camera
  /// @throws Error(option) for options out of range
  ObstacleDetector(const StereoRig& rig, const GroundPlaneSeed& seed,
                   const ObstacleDetectorOptions& options = {});
  ~ObstacleDetector();
  ObstacleDetector(ObstacleDetector&&) noexcept;
  ObstacleDetector& operator=(ObstacleDetector&&) noexcept;

  const ObstacleDetectorOptions& options() const;
  const RectifiedCamera& camera() const;

  /// @param t stamp of the pair, later than that of the last one
  /// @throws Error(argument) if the images have not the sizes of their cameras or t does not rise
  const ObstacleFrame& detect(TimeNs t, GrayView left, GrayView right, const ObstaclePose& pose = {});
  /// What the last call returned.
  const ObstacleFrame& last() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace sweepkit
