// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/map/map.hpp"
#include "sweepkit/slam/place_verification.hpp"
#include "sweepkit/solve/pose_graph.hpp"

namespace sweepkit {

struct LoopCorrectionOptions {
  int tie_points = 20;
  int ties = 10;
  double noise = 2;
  double position_floor = 0.0005;
  double angle_floor = 0.01;
  PoseGraphOptions graph{.gate = 4, .covariances = true};

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(tie_points, "tie_points", "", range(6, 10000),
      "keyframes that share so many points are tied by what they see");
    v(ties, "ties", "keyframes", range(1, 1000), "each to so many older ones, those that share most");
    v(noise, "noise", "", range(0.1, 100),
      "multiplies the standard deviations of what is seen: errors of neighbouring points go together");
    v(position_floor, "position_floor", "m", range(0, 1),
      "standard deviation of a tie, beside what points tell");
    v(angle_floor, "angle_floor", "deg", range(0, 10), "and of its rotation");
    v.group(graph, "graph", "the pose graph");
  }
};

/// What became of a place known again.
struct LoopCorrection {
  bool accepted = false;         ///< false: the rest of the map contradicts it, and nothing changed
  bool joined = false;           ///< two maps became one; otherwise a loop of one map
  SE3d T_new_old;                ///< how the world around the query moved
  double contradiction = 0;      ///< of a loop, as PoseGraphResult has it
  int keyframes = 0, edges = 0;  ///< of the graph
};

/// The essential graph of a map (Mur-Artal and Tardos, ORB-SLAM, T-RO 2015): keyframes tied to those that
/// they share points with, by their poses against each other as they stand, weighed by what these points
/// tell; where nothing was seen, by odometry with its covariance, so that blind stretches bend with the rest;
/// and, should neither hold a keyframe, by its parent. Node k is keyframe `keyframes[k]`, its pose
/// T_world_camera; the root is fixed.
struct EssentialGraph {
  std::vector<KeyframeId> keyframes;
  PoseGraph graph;

  /// The node of a keyframe of the map.
  int node(KeyframeId id) const;
};
EssentialGraph essential_graph(const Map& map, MapId id, const RectifiedCamera& camera,
                               const LoopCorrectionOptions& options);

/// Makes the map hold what was recognized. A query in another map than its candidate: its map is joined into
/// the candidate's. In the same: the essential graph with the loop in it is solved, unless it contradicts the
/// loop. Keyframes and points move, covariances of keyframes become those of the graph; observations stay as
/// they are. Deterministic. Throws Error(argument) if the match names keyframes that the map does not have.
LoopCorrection correct_loop(Map& map, const RectifiedCamera& camera, const PlaceMatch& match,
                            const LoopCorrectionOptions& options);

/// Poses of keyframes change, and each point goes along with the first keyframe that sees it.
void move_keyframes(Map& map, const std::vector<KeyframeId>& keyframes,
                    const std::vector<SE3d>& T_world_camera);

}  // namespace sweepkit
