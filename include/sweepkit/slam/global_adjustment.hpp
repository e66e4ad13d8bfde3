// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <utility>
#include <vector>

#include "sweepkit/core/ids.hpp"
#include "sweepkit/core/time.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/map/map.hpp"
#include "sweepkit/solve/bundle.hpp"

namespace sweepkit {

/// Keyframes and points of a map as bundle adjustment takes them: a copy, so that it can be solved in any
/// thread while the map goes on. LocalMapper makes it and takes it back.
struct MapBundle {
  BundleProblem problem;
  std::vector<KeyframeId> keyframes;                     ///< by pose of the problem
  std::vector<PointId> points;                           ///< by point
  std::vector<std::pair<PointId, KeyframeId>> observed;  ///< by observation
  BundleResult result;
};

/// The points that tell most about how keyframes stand to each other: those that most keyframes see come
/// first, until of each keyframe `each` are there, as many from each of 4 x 4 cells of its image, or all that
/// the cell has. Points that only one of the keyframes sees are left out. Sorted by id; same map, same
/// choice. Throws Error(argument) unless `each` is positive.
std::vector<PointId> choose_points(const Map& map, const std::vector<KeyframeId>& keyframes,
                                   const StereoRig::Bounds& view, int each);

/// Bundle adjustment of a whole map.
struct GlobalAdjustment {
  TimeNs t = 0;  ///< stamp of the newest keyframe in it
  MapBundle bundle;
  double disparity_bias = 0;  ///< that was taken off its disparities [px]
  int corrections = 0;        ///< of the map when it was copied: after another one the result is of no use
  bool solved = false;

  /// May take seconds. @param stop as solve_bundle
  void solve(const RectifiedCamera& camera, const BundleOptions& options,
             const std::atomic<bool>* stop = nullptr) {
    bundle.result = solve_bundle(camera, bundle.problem, options, stop);
    solved = bundle.result.usable;
  }
};

}  // namespace sweepkit
