// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "sweepkit/core/sample.hpp"
#include "sweepkit/core/stage_clock.hpp"
#include "sweepkit/floor/obstacle_detector.hpp"

namespace sweepkit {

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
  /// @param clock gets the times as Stage::obstacles; may be null; must outlive this
  /// @throws Error(option) for options out of range
  ObstacleStage(const StereoRig& rig, const GroundPlaneSeed& seed, const ObstacleDetectorOptions& options,
                bool realtime, StageClock* clock = nullptr);
  /// Ends without looking at what still waits.
  ~ObstacleStage();
  ObstacleStage(const ObstacleStage&) = delete;
  ObstacleStage& operator=(const ObstacleStage&) = delete;

  /// Takes an image and where the body was then. Never throws: what cannot be used is counted.
  void feed(StereoImage image, const SE3d& T_odom_body) noexcept;
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
