// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "sweepkit/core/ids.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/geometry/so3.hpp"

namespace sweepkit {

/// Where a point was seen: measurement `index` of a keyframe.
struct Observation {
  KeyframeId keyframe;
  std::uint32_t index = 0;
};

/// A point of the world with its appearance.
struct MapPoint {
  PointId id;
  Vec3<double> p_world = Vec3<double>::Zero();  ///< [m]
  OrbDescriptor descriptor;                     ///< the observation's closest to all others
  Vec3<float> normal = Vec3<float>::Zero();  ///< mean direction from the point to the cameras, unit, in world
  float min_distance = 0;                    ///< distances from which the pyramid can show it [m]
  float max_distance = 0;
  std::vector<Observation> observations;  ///< sorted by keyframe, at most one each
  KeyframeId first_keyframe;              ///< that made it; stays when that keyframe is gone
  int predicted = 0;                      ///< frames in which it should have been visible
  int found = 0;                          ///< frames in which it was matched
};

}  // namespace sweepkit
