// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/floor_map.hpp"

#include <algorithm>
#include <catch2/catch.hpp>
#include <vector>

#include "floor/random_scan.hpp"

using namespace sweepkit;

namespace {

std::vector<std::int32_t> values(const OccupancyGrid& grid) {
  const auto v = grid.cells();
  return {v.data, v.data + static_cast<std::ptrdiff_t>(v.width) * v.height};
}

bool same_picture(const OccupancyGrid& a, const OccupancyGrid& b) {
  const OccupancyImage i = a.image(), j = b.image();
  if (i.origin != j.origin || i.cells.width() != j.cells.width() || i.cells.height() != j.cells.height())
    return false;
  for (int y = 0; y < i.cells.height(); ++y)
    if (!std::equal(i.cells.row(y), i.cells.row(y) + i.cells.width(), j.cells.row(y))) return false;
  return true;
}

SE3d level(double x, double y, double yaw) { return {SO3d::exp({0, 0, yaw}), Vec3<double>(x, y, 0.08)}; }

}  // namespace

TEST_CASE("scans follow their keyframes: correcting is building anew") {
  Random random(8);
  FloorMapOptions options;
  options.move = options.turn = 0;
  FloorMap map(options);
  OccupancyGrid fresh;
  for (std::uint32_t k = 0; k < 10; ++k)
    for (int n = 0; n < 3; ++n) map.add({k}, level(0.03 * n, 0, 0.01 * n), random_scan(random));
  CHECK(map.scans() == 30);
  CHECK(map.bytes() < 30 * 2000);
  CHECK(map.update() == 0);  // nobody knows yet where the keyframes are
  for (std::uint32_t k = 0; k < 10; ++k) map.set_pose({k}, level(0.3 * k, 0, 0.1 * k));
  CHECK(map.update() == 30);
  CHECK(map.update() == 0);
  // A loop is closed: all but the first move.
  for (std::uint32_t k = 1; k < 10; ++k) map.set_pose({k}, level(0.29 * k, 0.02 * k, 0.11 * k));
  CHECK(map.update() == 27);
  FloorMap anew(options);
  Random again(8);
  for (std::uint32_t k = 0; k < 10; ++k) {
    for (int n = 0; n < 3; ++n) anew.add({k}, level(0.03 * n, 0, 0.01 * n), random_scan(again));
    anew.set_pose({k}, k == 0 ? level(0, 0, 0) : level(0.29 * k, 0.02 * k, 0.11 * k));
  }
  anew.update();
  CHECK(same_picture(map.grid(), anew.grid()));
  const auto updated = values(map.grid());
  map.rebuild();
  CHECK(same_picture(map.grid(), anew.grid()));
  CHECK(values(map.grid()) == values(anew.grid()));
}

TEST_CASE("small corrections leave scans where they are") {
  Random random(4);
  FloorMap map;
  map.add({1}, SE3d(), random_scan(random));
  map.set_pose({1}, level(1, 2, 0.3));
  CHECK(map.update() == 1);
  const auto before = values(map.grid());
  map.set_pose({1}, level(1.005, 2, 0.302));
  CHECK(map.update() == 0);
  CHECK(values(map.grid()) == before);
  // They do not creep: the distance counts from where it is drawn.
  map.set_pose({1}, level(1.012, 2, 0.302));
  CHECK(map.update() == 1);
}

TEST_CASE("keyframes of other maps, removed ones and tilted ones draw nothing") {
  Random random(6);
  FloorMapOptions options;
  options.move = options.turn = 0;
  FloorMap map(options), reference(options);
  const FloorScan a = random_scan(random), b = random_scan(random);
  map.add({1}, SE3d(), a);
  map.add({2}, SE3d(), b);
  map.set_pose({1}, level(0, 0, 0));
  map.set_pose({2}, level(1, 0, 0));
  map.update();
  reference.add({1}, SE3d(), a);
  reference.set_pose({1}, level(0, 0, 0));
  reference.update();
  SECTION("without a pose") {
    map.set_pose({2}, std::nullopt);
    map.update();
    CHECK(same_picture(map.grid(), reference.grid()));
    CHECK(map.drawn() == 1);
  }
  SECTION("tilted") {
    map.set_pose({2}, SE3d(SO3d::exp({0.2, 0, 0}), {1, 0, 0}));
    map.update();
    CHECK(same_picture(map.grid(), reference.grid()));
  }
  SECTION("removed") {
    map.erase({2});
    CHECK(map.scans() == 1);
    CHECK(same_picture(map.grid(), reference.grid()));
  }
  SECTION("hung on another keyframe they stay where they are") {
    map.rehang({2}, {1}, level(0, 0, 0).inverse() * level(1, 0, 0));
    CHECK(map.scans() == 2);
    map.rebuild();
    reference.add({2}, SE3d(), b);
    reference.set_pose({2}, level(1, 0, 0));
    reference.update();
    CHECK(same_picture(map.grid(), reference.grid()));
    CHECK_THROWS_AS(map.rehang({1}, {1}, SE3d()), Error);
  }
  CHECK_THROWS_AS(map.add({}, SE3d(), a), Error);
}
