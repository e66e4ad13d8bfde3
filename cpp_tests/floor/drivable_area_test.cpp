// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/drivable_area.hpp"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

#include "sweepkit/core/random.hpp"
#include "sweepkit/floor/distance_transform.hpp"
#include "sweepkit/floor/reachable_floor.hpp"

using namespace sweepkit;

namespace {

OccupancyImage room(int width, int height) {
  OccupancyImage map;
  map.cells.resize(width, height);
  map.cells.fill(OccupancyImage::kFree);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      if (x == 0 || y == 0 || x == width - 1 || y == height - 1) map.cells(x, y) = OccupancyImage::kOccupied;
  return map;
}

}  // namespace

TEST_CASE("distances are those of a search through all pixels") {
  Random random(7);
  Image<std::int64_t> squared;
  for (int n = 0; n < 60; ++n) {
    const int width = 1 + static_cast<int>(random.index(30)), height = 1 + static_cast<int>(random.index(30));
    const double share = n % 3 == 0 ? 0.01 : random.uniform(0, 0.3);
    GrayImage marked(width, height);
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) marked(x, y) = random.uniform() < share ? 200 : 0;
    distance_transform(marked, squared);
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        std::int64_t best = kNoDistance;
        for (int v = 0; v < height; ++v)
          for (int u = 0; u < width; ++u)
            if (marked(u, v)) best = std::min<std::int64_t>(best, (u - x) * (u - x) + (v - y) * (v - y));
        REQUIRE(squared(x, y) == best);
      }
  }
  distance_transform(GrayView(), squared);
  CHECK(squared.empty());
}

TEST_CASE("a robot reaches what its radius lets it reach") {
  OccupancyImage map = room(62, 42);  // 3 x 2 m inside
  const double radius = 0.2;
  DrivableArea area = drivable_area(map, {1.5, 1.0}, radius);
  CHECK(area.found);
  CHECK(area.centres_m2 == Approx(52 * 32 * map.cell * map.cell));
  // All but the corners' rounding, to within a cell along the rim.
  const double exact = 3.0 * 2.0 - (4 - std::numbers::pi) * radius * radius;
  CHECK(area.covered_m2 == Approx(exact).margin(map.cell * 10));
  SECTION("a gap narrower than the robot parts the room") {
    for (int y = 0; y < 42; ++y)
      if (y < 18 || y > 24) map.cells(30, y) = OccupancyImage::kOccupied;  // 7 cells: 0.35 m
    area = drivable_area(map, {0.7, 1.0}, radius);
    CHECK(area.centres_m2 < 0.5 * 52 * 32 * map.cell * map.cell);
    for (int y = 0; y < 42; ++y)
      for (int x = 30; x < 62; ++x) REQUIRE(area.centres(x, y) == 0);
    CHECK(drivable_area(map, {0.7, 1.0}, 0.1).centres_m2 > 0.5 * 52 * 32 * map.cell * map.cell);
  }
  SECTION("unknown is not driven on") {
    map.cells(30, 20) = OccupancyImage::kUnknown;
    CHECK(drivable_area(map, {0.7, 1.0}, radius).centres_m2 < area.centres_m2);
  }
  SECTION("a robot that stands too near a wall starts beside") {
    CHECK(drivable_area(map, {0.1, 1.0}, radius).centres_m2 == area.centres_m2);
    CHECK_FALSE(drivable_area(map, {-5, 1.0}, radius).found);
    CHECK_FALSE(drivable_area(map, {std::nan(""), 1.0}, radius).found);
    CHECK_FALSE(drivable_area(map, {1, 1}, 3.0).found);
  }
  CHECK_FALSE(drivable_area(OccupancyImage(), {0, 0}, radius).found);
  CHECK_THROWS_AS(drivable_area(map, {0, 0}, -1.0), Error);
}

TEST_CASE("no cell of a drivable area is nearer to a wall than the radius") {
  Random random(12);
  for (int n = 0; n < 10; ++n) {
    OccupancyImage map = room(40, 30);
    for (int k = 0; k < 15; ++k)
      map.cells(static_cast<int>(random.index(40)), static_cast<int>(random.index(30))) =
          OccupancyImage::kOccupied;
    const double radius = random.uniform(0.03, 0.2);
    const DrivableArea area = drivable_area(map, {1.0, 0.75}, radius);
    for (int y = 0; y < 30; ++y)
      for (int x = 0; x < 40; ++x)
        for (int v = 0; v < 30; ++v)
          for (int u = 0; u < 40; ++u)
            if (area.centres(x, y) && map.cells(u, v) != OccupancyImage::kFree)
              REQUIRE(std::hypot(u - x, v - y) * map.cell >= radius + map.cell / 2 - 1e-9);
  }
}

TEST_CASE("what lies behind walls by error is taken out") {
  OccupancyImage map;
  map.cells.resize(50, 40);
  map.cells.fill(OccupancyImage::kUnknown);
  for (int y = 5; y < 30; ++y)
    for (int x = 5; x < 30; ++x)
      map.cells(x, y) =
          x == 5 || y == 5 || x == 29 || y == 29 ? OccupancyImage::kOccupied : OccupancyImage::kFree;
  map.cells(15, 15) = OccupancyImage::kOccupied;  // a thing on the floor
  const OccupancyImage clean = map;
  for (int x = 35; x < 40; ++x) map.cells(x, 10) = OccupancyImage::kFree;  // rays gone wrong
  map.cells(40, 10) = map.cells(33, 36) = OccupancyImage::kOccupied;
  const Vec2<double> place = map.centre_of(10, 10), nowhere = map.centre_of(45, 35);
  OccupancyImage untouched = map;
  keep_reachable(untouched, std::span(&nowhere, 1));
  keep_reachable(map, std::span(&place, 1));
  for (int y = 0; y < 40; ++y) {
    CHECK(std::equal(map.cells.row(y), map.cells.row(y) + 50, clean.cells.row(y)));
  }
  CHECK(untouched.cells(37, 10) == OccupancyImage::kFree);
}
