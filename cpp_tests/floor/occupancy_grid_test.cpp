// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/occupancy_grid.hpp"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <map>
#include <numbers>
#include <set>
#include <utility>
#include <vector>

#include "floor/random_scan.hpp"
#include "sweepkit/floor/impl/cell_walk.hpp"

using namespace sweepkit;

namespace {

using Cell = std::pair<int, int>;

std::map<Cell, std::int32_t> known(const OccupancyGrid& grid) {
  std::map<Cell, std::int32_t> cells;
  const auto view = grid.cells();
  for (int y = 0; y < view.height; ++y)
    for (int x = 0; x < view.width; ++x)
      if (view(x, y)) cells[{x + grid.first_x(), y + grid.first_y()}] = view(x, y);
  return cells;
}

bool same_image(const OccupancyImage& a, const OccupancyImage& b) {
  if (a.cells.width() != b.cells.width() || a.cells.height() != b.cells.height() || a.origin != b.origin)
    return false;
  for (int y = 0; y < a.cells.height(); ++y)
    if (!std::equal(a.cells.row(y), a.cells.row(y) + a.cells.width(), b.cells.row(y))) return false;
  return true;
}

/// Whether a segment runs through the inside of a cell: clipped against its sides (Liang and Barsky 1984).
bool crosses(double x1, double y1, double x2, double y2, int cx, int cy) {
  double s0 = 0, s1 = 1;
  const auto clip = [&](double d, double low, double high) {
    if (d == 0) return low < 0 && high > 0;
    double a = low / d, b = high / d;
    if (a > b) std::swap(a, b);
    s0 = std::max(s0, a);
    s1 = std::min(s1, b);
    return s0 < s1;
  };
  return clip(x2 - x1, cx - x1, cx + 1 - x1) && clip(y2 - y1, cy - y1, cy + 1 - y1) && s1 - s0 > 1e-12;
}

}  // namespace

TEST_CASE("a walk visits exactly the cells that the segment crosses, each once, side by side") {
  Random random(11);
  for (int n = 0; n < 300; ++n) {
    const double x1 = random.uniform(-6, 6), y1 = random.uniform(-6, 6), x2 = random.uniform(-6, 6),
                 y2 = n % 10 == 0 ? y1 : random.uniform(-6, 6);
    std::set<Cell> visited;
    Cell last;
    double before = 0;
    walk_cells(x1, y1, x2, y2, [&](int x, int y, double s) {
      if (!visited.empty()) CHECK(std::abs(x - last.first) + std::abs(y - last.second) == 1);
      last = {x, y};
      CHECK(visited.insert(last).second);
      CHECK(s >= before);
      CHECK(s <= 1);
      before = s;
    });
    std::set<Cell> expected;
    for (int y = -7; y <= 6; ++y)
      for (int x = -7; x <= 6; ++x)
        if (crosses(x1, y1, x2, y2, x, y)) expected.insert({x, y});
    CHECK(visited == expected);
  }
}

TEST_CASE("a scan's votes are those of a slow reference") {
  Random random(5);
  OccupancyGridOptions options;
  const double cell = options.cell;
  for (int n = 0; n < 4; ++n) {
    const FloorScan scan = random_scan(random, 31, 2.0);
    const PlanarPose pose = random_pose(random);
    OccupancyGrid grid(options);
    grid.add(scan, pose);
    const auto got = known(grid);
    // Which kind of vote each cell must have.
    std::map<Cell, int> expected;  // 1 free, 2 occupied, 3 stood on
    const int x0 = static_cast<int>(std::floor(pose.x / cell)),
              y0 = static_cast<int>(std::floor(pose.y / cell));
    for (const FloorStretch& s : scan.stretches) {
      const double a = pose.yaw + scan.bearing(s.bearing);
      const auto at = [&](double mm) {
        return std::pair{(pose.x + 1e-3 * mm * std::cos(a)) / cell,
                         (pose.y + 1e-3 * mm * std::sin(a)) / cell};
      };
      const auto [ax, ay] = at(s.from);
      const auto [bx, by] = at(s.to);
      if (s.label != FloorLabel::floor) {
        expected[{static_cast<int>(std::floor(ax)), static_cast<int>(std::floor(ay))}] = 2;
        continue;
      }
      for (int y = y0 - 45; y <= y0 + 45; ++y)
        for (int x = x0 - 45; x <= x0 + 45; ++x)
          if (crosses(ax, ay, bx, by, x, y)) expected[{x, y}] = std::max(expected[{x, y}], 1);
    }
    const double c = std::cos(pose.yaw), d = std::sin(pose.yaw);
    const Vec2<double> foot(pose.x + c * scan.footprint.x() - d * scan.footprint.y(),
                            pose.y + d * scan.footprint.x() + c * scan.footprint.y());
    for (int y = y0 - 10; y <= y0 + 10; ++y)
      for (int x = x0 - 10; x <= x0 + 10; ++x)
        if ((Vec2<double>(x + 0.5, y + 0.5) * cell - foot).norm() <= scan.footprint_radius)
          expected[{x, y}] = 3;
    REQUIRE(got.size() == expected.size());
    for (const auto& [at, kind] : expected) {
      REQUIRE(got.count(at) == 1);
      const std::int32_t vote = got.at(at);
      INFO(at.first << " " << at.second << " kind " << kind);
      if (kind == 2) CHECK(vote > 0);
      if (kind != 2) CHECK(vote < 0);
      if (kind == 3) CHECK(vote == -std::lround(options.footprint_evidence * OccupancyGrid::kOne));
    }
  }
}

TEST_CASE("the order of scans does not matter, and one taken out leaves no trace") {
  Random random(3);
  std::vector<FloorScan> scans;
  std::vector<PlanarPose> poses;
  for (int i = 0; i < 12; ++i) {
    scans.push_back(random_scan(random));
    poses.push_back(random_pose(random, 8.0));
  }
  OccupancyGrid forward, backward, partly;
  for (int i = 0; i < 12; ++i) forward.add(scans[i], poses[i]);
  for (int i = 11; i >= 0; --i) backward.add(scans[i], poses[i]);
  CHECK(known(forward) == known(backward));
  CHECK(forward.first_x() == backward.first_x());
  CHECK(forward.cells().width == backward.cells().width);
  CHECK(same_image(forward.image(), backward.image()));
  for (int i = 0; i < 12; i += 2) partly.add(scans[i], poses[i]);
  for (int i = 1; i < 12; i += 2) forward.remove(scans[i], poses[i]);
  CHECK(known(forward) == known(partly));
  CHECK(same_image(forward.image(), partly.image()));
  for (int i = 0; i < 12; i += 2) forward.remove(scans[i], poses[i]);
  CHECK(known(forward).empty());
  CHECK(forward.image().cells.empty());
}

TEST_CASE("turned by 90 degrees, scans draw the grid turned by 90 degrees") {
  Random random(17);
  OccupancyGrid grid, turned;
  for (int i = 0; i < 6; ++i) {
    const FloorScan scan = random_scan(random);
    const PlanarPose pose = random_pose(random);
    grid.add(scan, pose);
    turned.add(scan, {-pose.y, pose.x, pose.yaw + std::numbers::pi / 2});
  }
  std::map<Cell, std::int32_t> expected;
  for (const auto& [at, value] : known(grid)) expected[{-1 - at.second, at.first}] = value;
  CHECK(known(turned) == expected);
}

TEST_CASE("moved by whole cells, scans draw the grid moved") {
  Random random(18);
  OccupancyGridOptions options;
  options.cell = 0.0625;  // so that moving by cells is exact
  OccupancyGrid grid(options), moved(options);
  const FloorScan scan = random_scan(random);
  PlanarPose pose{0.25 + 1.0 / 64, -0.5 + 1.0 / 64, 0.7};
  grid.add(scan, pose);
  pose.x += 100 * options.cell;
  pose.y -= 333 * options.cell;
  moved.add(scan, pose);
  std::map<Cell, std::int32_t> expected;
  for (const auto& [at, value] : known(grid)) expected[{at.first + 100, at.second - 333}] = value;
  CHECK(known(moved) == expected);
}

TEST_CASE("more evidence decides, and what is read agrees with it") {
  FloorScan scan;
  scan.bearings = 1;
  scan.bearing_step = 0.01;
  scan.range_noise = 0.01;
  scan.stretches = {{0, 100, 900, FloorLabel::floor, 9}, {0, 920, 920, FloorLabel::obstacle, 9}};
  OccupancyGrid grid;
  const PlanarPose pose{0.01, 0.026, 0.0};
  for (int i = 0; i < 3; ++i) grid.add(scan, pose);
  const OccupancyImage image = grid.image();
  CHECK(image.at({0.5, 0.026}) == OccupancyImage::kFree);
  CHECK(image.at({0.93, 0.026}) == OccupancyImage::kOccupied);
  CHECK(image.at({0.97, 0.026}) == OccupancyImage::kUnknown);
  CHECK(image.at({100, 100}) == OccupancyImage::kUnknown);
  CHECK(grid.log_odds({0.5, 0.026}) < 0);
  CHECK(grid.log_odds({0.5, 0.026}) == 3 * -std::lround(grid.options().free_evidence * OccupancyGrid::kOne));
  CHECK(grid.log_odds({0.93, 0.026}) > 0);
  CHECK(grid.log_odds({-1e300, 1e300}) == 0);
  const Eigen::Vector2i c = image.cell_of({0.93, 0.026});
  CHECK((image.centre_of(c.x(), c.y()) - Vec2<double>(0.925, 0.025)).norm() < 1e-9);
}

TEST_CASE("a grid does not grow beyond its bound, and counts what is left out") {
  Random random(2);
  OccupancyGridOptions options;
  options.max_cells = 256 * 256;
  OccupancyGrid grid(options);
  const FloorScan scan = random_scan(random);
  grid.add(scan, {0, 0, 0});
  const auto before = known(grid);
  CHECK(grid.left_out() == 0);
  grid.add(scan, {500, 500, 0});
  CHECK(grid.left_out() > 0);
  CHECK(static_cast<int>(grid.cells().width) * grid.cells().height <= options.max_cells);
  grid.remove(scan, {500, 500, 0});
  CHECK(grid.left_out() == 0);
  CHECK(known(grid) == before);
  // Poses that are no place.
  grid.add(scan, {1e300, 0, 0});
  grid.add(scan, {std::nan(""), 0, 0});
  CHECK(known(grid) == before);
  options.cell = 0;
  CHECK_THROWS_AS(OccupancyGrid(options), Error);
}
