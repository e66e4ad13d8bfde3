// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "sweepkit/floor/occupancy_grid.hpp"

namespace sweepkit {

/// Takes out of a map what can only be there by error: free cells that no way over the sides of free cells
/// joins to a place where the robot was, and occupied cells that border on no free cell that stays (by side
/// or corner, or over one cell between). Rays that go wrong on bare or shining walls draw both behind them.
/// Where no place lies in a free cell the map is left as it is.
/// @param places where the robot was [m]
void keep_reachable(OccupancyImage& map, std::span<const Vec2<double>> places);

}  // namespace sweepkit
