// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/sample.hpp"
#include "sweepkit/core/stage_clock.hpp"
#include "sweepkit/data/source.hpp"
#include "sweepkit/floor/obstacle_detector.hpp"
#include "sweepkit/system/grid_stage.hpp"

namespace sweepkit {

/// The floor where a rig without wheels does not tell it.
struct FloorMountingOptions {
  double camera_height = 0.0;
  double pitch_down = 0.0;
  double roll = 0.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(camera_height, "camera_height", "m", range(0.0, 10.0),
      "of the left camera above the floor; 0: as the wheels are mounted");
    v(pitch_down, "pitch_down", "deg", range(-80.0, 90.0),
      "by which the left camera looks down; with camera_height");
    v(roll, "roll", "deg", range(-180.0, 180.0), "positive: its right side down; with camera_height");
  }

  /// The floor's plane as calibration has it. @throws Error(calibration) if neither tells it
  GroundPlaneSeed seed(const Rig& rig) const;
};

/// Obstacles as one image showed them, by themselves: nothing of it changes later.
struct ObstacleReport {
  TimeNs t = 0;
  SE3d T_odom_floor;  ///< floor_frame of that image's ground plane, in which Obstacle::box stands
  GroundPlaneResult plane;
  std::vector<Obstacle> obstacles;
  std::vector<TrackedObstacle> tracked;  ///< in odom
};

/// Counted over a stage's life.
struct ObstacleStageCounts {
  std::int64_t images = 0;   ///< looked at
  std::int64_t skipped = 0;  ///< pushed out by a newer image, or fed out of order, with one side only or of a
                             ///< wrong size
};

/// Runs an ObstacleDetector beside the frame path. In real time it has a thread of its own and a queue of
/// one: the newest image wins, and feed never waits. Otherwise feed looks at the image before it returns, so
/// that runs are repeatable. Feeds come from one thread; results may be asked from any.
class ObstacleStage {
 public:
  /// @param clock gets the times as Stage::obstacles, of the grid's part as Stage::grid; may be null; must
  ///   outlive this
  /// @param grid is given what each image shows of the floor; may be null; must outlive this
  /// @throws Error(option) for options out of range
  ObstacleStage(const StereoRig& rig, const GroundPlaneSeed& seed, const ObstacleDetectorOptions& options,
                bool realtime, StageClock* clock = nullptr, GridStage* grid = nullptr);
  /// Ends without looking at what still waits.
  ~ObstacleStage();
  ObstacleStage(const ObstacleStage&) = delete;
  ObstacleStage& operator=(const ObstacleStage&) = delete;

  /// Takes an image and where the body was then. Never throws: what cannot be used is counted.
  /// @param reference, T_camera_reference the keyframe that the grid's scan hangs on, and how; without one
  /// the
  ///   image adds nothing to the grid
  void feed(StereoImage image, const SE3d& T_odom_body, KeyframeId reference = {},
            const SE3d& T_camera_reference = {}) noexcept;
  /// Returns when the image that waits, if any, is done; the thread ends.
  void finish();

  /// The newest result; null before the first.
  std::shared_ptr<const ObstacleReport> latest() const;
  ObstacleStageCounts counts() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace sweepkit
