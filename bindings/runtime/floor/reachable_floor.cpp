// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/reachable_floor.hpp"

#include <algorithm>
#include <utility>
#include <vector>

namespace sweepkit {

void keep_reachable(OccupancyImage& map, std::span<const Vec2<double>> places) {
  constexpr int kReach = 2;  // [cells]
  const int width = map.cells.width(), height = map.cells.height();
  GrayImage reached(width, height);
  reached.fill(0);
  std::vector<Eigen::Vector2i> stack;
  const auto visit = [&](int x, int y) {
    if (x < 0 || y < 0 || x >= width || y >= height || reached(x, y) ||
        map.cells(x, y) != OccupancyImage::kFree)
      return;
    reached(x, y) = 1;
    stack.emplace_back(x, y);
  };
  for (const Vec2<double>& place : places) {
    const Eigen::Vector2i c = map.cell_of(place);
    visit(c.x(), c.y());
  }
  if (stack.empty()) return;
  while (!stack.empty()) {
    const Eigen::Vector2i c = stack.back();
    stack.pop_back();
    for (const auto& [dx, dy] : {std::pair{1, 0}, {-1, 0}, {0, 1}, {0, -1}}) visit(c.x() + dx, c.y() + dy);
  }
  const auto free_near = [&](int x, int y) {
    for (int v = std::max(y - kReach, 0); v <= std::min(y + kReach, height - 1); ++v)
      for (int u = std::max(x - kReach, 0); u <= std::min(x + kReach, width - 1); ++u)
        if (reached(u, v)) return true;
    return false;
  };
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      std::uint8_t& cell = map.cells(x, y);
      const bool stays = cell == OccupancyImage::kFree       ? reached(x, y) != 0
                         : cell == OccupancyImage::kOccupied ? free_near(x, y)
                                                             : true;
      if (!stays) cell = OccupancyImage::kUnknown;
    }
}

}  // namespace sweepkit
