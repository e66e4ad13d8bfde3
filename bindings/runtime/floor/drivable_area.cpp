// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/drivable_area.hpp"

#include <cmath>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/floor/distance_transform.hpp"

namespace sweepkit {

DrivableArea drivable_area(const OccupancyImage& map, const Vec2<double>& position, double radius) {
  require(std::isfinite(radius) && radius >= 0, "drivable_area radius", "must be finite and not negative",
          radius);
  require(map.cell > 0, "drivable_area map", "has no cell size", map.cell);
  const int width = map.cells.width(), height = map.cells.height();
  DrivableArea area;
  area.centres.resize(width, height);
  area.centres.fill(0);
  area.covered.resize(width, height);
  area.covered.fill(0);
  if (map.cells.empty()) return area;

  // With a rim, so that the map's edge counts as unknown.
  GrayImage taken(width + 2, height + 2);
  taken.fill(1);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) taken(x + 1, y + 1) = map.cells(x, y) != OccupancyImage::kFree;
  Image<std::int64_t> squared;
  distance_transform(taken, squared);
  const double needed = std::pow(radius / map.cell + 0.5, 2);
  const auto fits = [&](int x, int y) { return static_cast<double>(squared(x + 1, y + 1)) >= needed; };

  const Vec2<double> at = (position - map.origin) / map.cell;
  const double px = at.x() - 0.5, py = height - 0.5 - at.y();  // in cells from the centre of the first
  const double reach = radius / map.cell + 1.0;
  int start_x = -1, start_y = -1;
  double nearest = reach * reach;
  if (std::isfinite(px) && std::isfinite(py))
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        const double d = (x - px) * (x - px) + (y - py) * (y - py);
        if (d < nearest && fits(x, y)) {
          nearest = d;
          start_x = x;
          start_y = y;
        }
      }
  if (start_x < 0) return area;
  area.found = true;
  std::vector<Eigen::Vector2i> stack{{start_x, start_y}};
  area.centres(start_x, start_y) = 255;
  std::size_t centres = 0;
  while (!stack.empty()) {
    const Eigen::Vector2i c = stack.back();
    stack.pop_back();
    ++centres;
    for (const auto& [dx, dy] : {std::pair{1, 0}, {-1, 0}, {0, 1}, {0, -1}}) {
      const int x = c.x() + dx, y = c.y() + dy;
      if (x < 0 || y < 0 || x >= width || y >= height || area.centres(x, y) || !fits(x, y)) continue;
      area.centres(x, y) = 255;
      stack.emplace_back(x, y);
    }
  }
  distance_transform(area.centres, squared);
  const double under = std::pow(radius / map.cell, 2);
  std::size_t covered = 0;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      if (static_cast<double>(squared(x, y)) <= under) {
        area.covered(x, y) = 255;
        ++covered;
      }
  const double cell_area = map.cell * map.cell;
  area.centres_m2 = static_cast<double>(centres) * cell_area;
  area.covered_m2 = static_cast<double>(covered) * cell_area;
  return area;
}

}  // namespace sweepkit
