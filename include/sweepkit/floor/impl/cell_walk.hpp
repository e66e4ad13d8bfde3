// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

namespace sweepkit {

/// Calls visit(x, y, s) for each cell that the segment from (x1, y1) to (x2, y2) crosses, in order; s is the
/// middle of its part within the cell, from 0 to 1. Lengths in cells; cell (x, y) covers [x, x + 1) x [y, y +
/// 1). Amanatides and Woo, A fast voxel traversal algorithm for ray tracing (1987).
template <class Visit>
void walk_cells(double x1, double y1, double x2, double y2, const Visit& visit) {
  constexpr double kNever = std::numeric_limits<double>::infinity();
  int x = static_cast<int>(std::floor(x1)), y = static_cast<int>(std::floor(y1));
  const int last_x = static_cast<int>(std::floor(x2)), last_y = static_cast<int>(std::floor(y2));
  const double dx = x2 - x1, dy = y2 - y1;
  const int step_x = dx > 0 ? 1 : -1, step_y = dy > 0 ? 1 : -1;
  // Parameter at which the next line of the grid is met.
  double next_x = dx == 0 ? kNever : (x + (dx > 0) - x1) / dx;
  double next_y = dy == 0 ? kNever : (y + (dy > 0) - y1) / dy;
  const double every_x = dx == 0 ? kNever : std::abs(1.0 / dx),
               every_y = dy == 0 ? kNever : std::abs(1.0 / dy);
  // The number of steps is known, so that rounding cannot make the walk miss its end.
  int left_x = std::abs(last_x - x), left_y = std::abs(last_y - y);
  double s = 0.0;
  for (;;) {
    const bool along_x = left_x > 0 && (left_y == 0 || next_x < next_y);
    const double end = left_x == 0 && left_y == 0 ? 1.0 : std::clamp(along_x ? next_x : next_y, s, 1.0);
    visit(x, y, 0.5 * (s + end));
    if (left_x == 0 && left_y == 0) return;
    s = end;
    if (along_x) {
      x += step_x;
      next_x += every_x;
      --left_x;
    } else {
      y += step_y;
      next_y += every_y;
      --left_y;
    }
  }
}

}  // namespace sweepkit
