// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <utility>
#include <vector>

#include "sweepkit/core/ids.hpp"
#include "sweepkit/core/time.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// A map point as the tracker needs it.
struct LocalPoint {
  PointId id;
  Vec3<double> p_world;
  Vec3<float> normal;      ///< mean direction to the cameras that saw it, unit
  float min_distance = 0;  ///< [m]
  float max_distance = 0;  ///< [m]
  Vec3<float> spread;      ///< one standard deviation along its most uncertain direction, in world [m]
  OrbDescriptor descriptor;
  int observations = 0;
};

/// What the tracker knows of the map: a copy, made by the mapper after each keyframe and never changed again,
/// so that a frame waits for nobody.
struct LocalMap {
  /// Counts the maps that tracking began: a copy of one that it has left is of no use to it.
  int begun = 0;
  /// How often this map was moved as a whole or bent: by joins and loops, not by local adjustment.
  int corrections = 0;
  KeyframeId newest;                   ///< keyframe it was made for
  TimeNs newest_t = 0;                 ///< its stamp
  std::vector<PointId> newest_points;  ///< its points, by measurement
  double disparity_bias = 0;           ///< of the rig, as known now [px]
  /// The newest keyframe that saw something, in a blind stretch the last one before it, and how uncertain its
  /// pose is, as Keyframe has it.
  KeyframeId anchor;
  Mat6<double> anchor_covariance = Mat6<double>::Zero();
  int reference_points = 0;                            ///< how many of them others see too
  std::vector<std::pair<KeyframeId, SE3d>> keyframes;  ///< T_camera_world of those around, sorted by id
  std::vector<LocalPoint> points;                      ///< sorted by id

  /// T_camera_world of a keyframe, or null if it is not in this copy.
  const SE3d* find(KeyframeId id) const {
    const auto it = std::lower_bound(keyframes.begin(), keyframes.end(), id,
                                     [](const auto& entry, KeyframeId key) { return entry.first < key; });
    return it != keyframes.end() && it->first == id ? &it->second : nullptr;
  }
  /// The point of that id, or null if it is not in this copy.
  const LocalPoint* find(PointId id) const {
    const auto it = std::lower_bound(points.begin(), points.end(), id,
                                     [](const LocalPoint& p, PointId key) { return p.id < key; });
    return it != points.end() && it->id == id ? &*it : nullptr;
  }
};

}  // namespace sweepkit
