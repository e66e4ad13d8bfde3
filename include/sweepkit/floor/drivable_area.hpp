// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

#include "sweepkit/floor/occupancy_grid.hpp"
#include "sweepkit/image/image.hpp"

namespace sweepkit {

/// Where a round robot can drive on a floor.
struct DrivableArea {
  GrayImage centres;        ///< 255 in cells in which the robot's centre may be, else 0; as large as the map
  GrayImage covered;        ///< 255 in cells whose centre comes under the robot, else 0
  double centres_m2 = 0.0;  ///< area of the cells in `centres`
  double covered_m2 = 0.0;  ///< area of the cells in `covered`: what the robot can sweep
  bool found = false;       ///< whether there is such a place within one radius of the robot
};

/// The part of the free floor that a robot of that radius reaches from a place without touching what is
/// occupied or unknown. Its centre may be in a cell if the nearest cell that is not free is farther from it
/// than the radius (from the cell's centre to the other's nearest side, taken as half a cell before its
/// centre). Reached is what connects to the robot's cell over the cells' sides; if the robot's own cell is
/// not among them, to the nearest one within one radius.
/// @param position of the robot in the map [m]
/// @param radius of the robot [m]; @throws Error(argument) unless it is finite and not negative
DrivableArea drivable_area(const OccupancyImage& map, const Vec2<double>& position, double radius);

}  // namespace sweepkit
