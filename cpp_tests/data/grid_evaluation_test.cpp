// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/grid_evaluation.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

using namespace sweepkit;

namespace {

constexpr std::uint8_t kFree = OccupancyImage::kFree, kWall = OccupancyImage::kOccupied,
                       kUnknown = OccupancyImage::kUnknown;

/// A room of 3 x 2 m inside, its lower left inner corner at the origin.
OccupancyImage room() {
  OccupancyImage map;
  map.origin = {-0.1, -0.1};
  map.cells.resize(64, 44);
  map.cells.fill(kUnknown);
  for (int y = 1; y < 43; ++y)
    for (int x = 1; x < 63; ++x) map.cells(x, y) = x == 1 || x == 62 || y == 1 || y == 42 ? kWall : kFree;
  return map;
}

FloorView looking(double x, double y, double yaw) {
  return {{x, y, yaw}, -std::numbers::pi / 4, std::numbers::pi / 4, 0.1};
}

}  // namespace

TEST_CASE("a perfect grid is perfect, whatever was visible") {
  const OccupancyImage map = room();
  const FloorView view = looking(0.5, 1.0, 0.0);
  for (const auto& views : {std::span<const FloorView>(), std::span(&view, 1)}) {
    const GridEvaluation e = evaluate_grid(map, map, {}, views);
    CHECK(e.iou() == 1.0);
    CHECK(e.recall() == 1.0);
    CHECK(e.precision() == 1.0);
    CHECK(e.right_wall_share() == 1.0);
    CHECK(e.found_wall_share() == 1.0);
    CHECK(e.free == 60 * 40);
  }
  const GridEvaluation all = evaluate_grid(map, map, {}, {});
  CHECK(all.visible == 60 * 40);
  CHECK(all.true_walls == 2 * 62 + 2 * 40);
}

TEST_CASE("an empty grid finds nothing, and counts are what they say") {
  const OccupancyImage map = room();
  const GridEvaluation none = evaluate_grid(OccupancyImage(), map, {}, {});
  CHECK(none.iou() == 0.0);
  CHECK(none.grid_walls == 0);
  CHECK(none.right_wall_share() == 0.0);
  OccupancyImage grid = map;
  for (int x = 2; x < 12; ++x) grid.cells(x, 20) = kWall;    // ten cells missed as walls, wrongly
  for (int x = 2; x < 7; ++x) grid.cells(x, 30) = kUnknown;  // five unknown
  for (int x = 10; x < 13; ++x) grid.cells(x, 43) = kFree;   // three free outside
  const GridEvaluation e = evaluate_grid(grid, map, {}, {});
  CHECK(e.visible - e.found == 15);
  CHECK(e.missed_as_wall == 10);
  CHECK(e.false_free == 3);
  CHECK(e.iou() == Approx((2400.0 - 15) / (2400 + 3)));
  // The first of the ten borders on the wall at the side; the others are too far from it.
  CHECK(e.grid_walls - e.right_walls == 9);
}

TEST_CASE(
    "a wall one cell off is right, farther off it is not; the grid's own frame is laid over the truth's") {
  const OccupancyImage map = room();
  for (const double shift : {0.049, 0.13}) {
    OccupancyImage grid = map;
    grid.origin.x() += shift;
    const GridEvaluation e = evaluate_grid(grid, map, {}, {});
    if (shift < 0.05) CHECK(e.right_wall_share() == 1.0);
    if (shift > 0.1) CHECK(e.right_wall_share() < 0.8);
    const GridEvaluation back = evaluate_grid(grid, map, {-shift, 0, 0}, {});
    CHECK(back.iou() == 1.0);
  }
  // The same grid as another frame sees it, half a turn round.
  OccupancyImage turned = map;
  for (int y = 0; y < 44; ++y)
    for (int x = 0; x < 64; ++x) turned.cells(x, y) = map.cells(63 - x, 43 - y);
  turned.origin = {-(-0.1 + 64 * 0.05) + 7.0, -(-0.1 + 44 * 0.05) - 2.0};
  const GridEvaluation e = evaluate_grid(turned, map, {7.0, -2.0, std::numbers::pi}, {});
  CHECK(e.iou() > 0.99);
}

TEST_CASE("what was visible lies in the field of view, in range, and before walls") {
  OccupancyImage map = room();
  for (int y = 1; y < 35; ++y) map.cells(32, y) = kWall;  // parts the room but for its lower end
  GridEvaluationOptions options;
  options.max_range = 1.2;
  const FloorView view = looking(0.5, 1.0, 0.0);
  const GrayImage visible = visible_floor(map, std::span(&view, 1), options);
  for (int y = 0; y < 44; ++y)
    for (int x = 0; x < 64; ++x) {
      const Vec2<double> d = map.centre_of(x, y) - Vec2<double>(0.5, 1.0);
      const double margin = 0.08;
      INFO(d.transpose());
      if (x > 32) CHECK(visible(x, y) == 0);
      if (d.norm() > 1.2 + margin || std::abs(std::atan2(d.y(), d.x())) > std::numbers::pi / 4 + 0.3)
        CHECK(visible(x, y) == 0);
      const bool inside = x > 1 && x < 32 && y > 1 && y < 42;
      if (inside && d.norm() < 1.2 - margin && d.norm() > 0.1 + margin &&
          std::abs(d.y()) < d.x() - 2 * margin)
        CHECK(visible(x, y) == 255);
      if (d.norm() < 0.04) CHECK(visible(x, y) == 0);
    }
  CHECK(visible(32, 20) == 255);
}

TEST_CASE("the figures are printed and written") {
  const OccupancyImage map = room();
  const GridEvaluation e = evaluate_grid(map, map, {}, {});
  CHECK(to_table(e).find("IoU") != std::string::npos);
  const auto json = nlohmann::json::parse(to_json(e));
  CHECK(json["grid_iou"] == 1.0);
  CHECK(json["cells"]["visible"] == 2400);
  GridEvaluationOptions options;
  options.max_range = -1;
  CHECK_THROWS_AS(evaluate_grid(map, map, {}, {}, options), Error);
}
