// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/map/map.hpp"

namespace sweepkit {

/// How large a map may become, and what counts as one view when it has to be cut down.
struct MapCaps {
  int max_keyframes = 2000;
  double max_memory = 50;
  double slack = 0.05;
  double cell = 0.5;
  double sector = 30;
  int seen_by = 3;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(max_keyframes, "max_keyframes", "keyframes", range(2, 1000000), "more are never kept, over all maps");
    v(max_memory, "max_memory", "MB", range(0.1, 100000), "keyframes and points never take more");
    v(slack, "slack", "", range(0, 0.9),
      "as a part of these: so far below them is cut when they are reached, so that it is seldom");
    v(cell, "cell", "m", range(0.01, 100), "two keyframes so near looking the same way show the same view");
    v(sector, "sector", "deg", range(1, 180), "what looking the same way means");
    v(seen_by, "seen_by", "keyframes", range(1, 100),
      "a point that so many others see as well is no reason to keep a keyframe");
  }
};

/// Chooses the keyframes to remove, in this order, so that a map is within its caps again and still knows all
/// views that it can: a view is a cell of position and a sector of direction, of one map. First go keyframes
/// that see nothing; then those whose view another one shows, in cells of the finest size; then, the size
/// doubled again and again, those of neighbouring views. Among these goes first whose points are seen by
/// others most, and the older of equal ones. So no view is given up while another is shown twice.
/// Roots of maps and keyframes of `keep` stay, whatever the caps. Empty while the map is within them.
/// Nothing is removed here: Map::remove_keyframe does. Same map, same choice.
/// @param keep the surroundings of where the robot is, in any order
std::vector<KeyframeId> choose_culls(const Map& map, const MapCaps& caps,
                                     std::span<const KeyframeId> keep = {});

/// How many views a map knows: distinct cells of position and sectors of direction in which a keyframe sees
/// points, over all maps.
/// @param doublings how often the size of cell and sector is doubled
std::size_t count_views(const Map& map, const MapCaps& caps, int doublings = 0);

}  // namespace sweepkit
