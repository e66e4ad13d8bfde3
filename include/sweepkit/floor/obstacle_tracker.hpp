// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/time.hpp"
#include "sweepkit/floor/obstacles.hpp"

namespace sweepkit {

/// How obstacles become more certain from image to image.
struct ObstacleTrackerOptions {
  double gate = 0.05;
  double gate_share = 0.05;
  double hit = 0.9;
  double miss = 0.7;
  double confirm = 2.0;
  double drop = -0.5;
  double most = 5.0;
  double memory = 30.0;
  double max_range = 3.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(gate, "gate", "m", range(0.001, 10.0), "an obstacle seen so near to a known one is that one");
    v(gate_share, "gate_share", "", range(0.0, 1.0), "and by this part of its distance more");
    v(hit, "hit", "", range(0.01, 10.0), "log-odds that a clear sighting adds");
    v(miss, "miss", "", range(0.0, 10.0), "log-odds that the floor or a wall seen in its place takes away");
    v(confirm, "confirm", "", range(0.0, 100.0), "log-odds from which on an obstacle is confirmed");
    v(drop, "drop", "", range(-100.0, 0.0), "log-odds below which it is forgotten");
    v(most, "most", "", range(0.1, 100.0), "log-odds never exceed this");
    v(memory, "memory", "s", range(0.0, 1e6), "what was out of sight for so long is forgotten");
    v(max_range, "max_range", "m", range(0.1, 100.0), "depth up to which a missing obstacle is missed");
  }
};

/// An obstacle followed over images.
struct TrackedObstacle {
  std::int64_t id = 0;  ///< from 1 on, never used twice
  ObstacleKind kind = ObstacleKind::obstacle;
  Vec3<double> p_world = Vec3<double>::Zero();         ///< weighted mean of what was seen of it [m]
  Mat3<double> covariance = Mat3<double>::Identity();  ///< of p_world, without the pose's [m^2]
  FloorBox box;                                        ///< as last seen, in the world
  double log_odds = 0.0;                               ///< of being there
  bool confirmed = false;                              ///< once, for as long as it is kept
  int hits = 0;                                        ///< images that showed it
  TimeNs first_seen = 0;
  TimeNs last_seen = 0;
  int last = -1;  ///< index among the obstacles of the last image; -1: not seen there

  double confidence() const { return 1.0 / (1.0 + std::exp(-log_odds)); }
};

/// Associates the obstacles of consecutive images in a frame that does not move (odom: smooth, z up) and
/// keeps the odds of each. A clear sighting raises them, a faint one (Obstacle::clear) does not; an image
/// that shows the floor or something behind in its place lowers them; an image in which it is hidden, out of
/// view or without disparity says nothing. Obstacles are born at their first sighting, confirmed when the
/// odds are high enough, dropped when they are low. Deterministic; one thread at a time.
class ObstacleTracker {
 public:
  /// @throws Error(option) for options out of range
  explicit ObstacleTracker(const ObstacleTrackerOptions& options = {});

  const ObstacleTrackerOptions& options() const { return options_; }

  /// Takes what an image shows.
  /// @param obstacles as ObstacleFinder found them
  /// @param disparity of that image, to see what is not there any more
  /// @param plane the ground plane of that image
  /// @param T_world_camera where the rectified left camera was
  template <DisparityPixel D>
  void update(TimeNs t, std::span<const Obstacle> obstacles, View2d<const D> disparity,
              const RectifiedCamera& camera, const GroundPlane& plane, const SE3d& T_world_camera);

  /// All that are kept, also those not confirmed, in the order of their ids.
  const std::vector<TrackedObstacle>& tracked() const { return tracked_; }
  /// Forgets everything but the ids used.
  void reset() { tracked_.clear(); }

 private:
  ObstacleTrackerOptions options_;
  std::vector<TrackedObstacle> tracked_;
  std::int64_t last_id_ = 0;
};

}  // namespace sweepkit
