// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// The floor beside the frame path, through the whole system.
#include <catch2/catch.hpp>
#include <cmath>

#include "sweepkit/core/error.hpp"
#include "sweepkit/system/sweeper.hpp"
#include "system/room.hpp"

using namespace sweepkit;

namespace {

// The body of the room's rig stands on the floor; its cameras are 10 cm above it and look level.
SweeperOptions floor_options(bool realtime = false) {
  SweeperOptions options;
  options.realtime = realtime;
  options.image_queue = 100;
  options.frontend.orb.count = 500;
  options.floor.enabled = true;
  options.floor.every = 0.3;
  options.floor.mounting.camera_height = 0.1;
  options.floor.detector.disparity.disparities = 64;
  return options;
}

}  // namespace

TEST_CASE("a Sweeper maps the floor that it drives over, alike in every run", "[floor_stage]") {
  const auto run = [](double every) {
    SweeperOptions options = floor_options();
    options.floor.every = every;
    Sweeper sweeper(Room().rig(), options);
    for (const StereoImage& image : drive_images()) sweeper.feed(image);
    sweeper.finish();
    REQUIRE(sweeper.grid());
    return *sweeper.grid();
  };
  const OccupancyImage once = run(0.3), again = run(0.3);
  REQUIRE(once.cells.view().width == again.cells.view().width);
  REQUIRE(once.cells.view().height == again.cells.view().height);
  int free = 0, occupied = 0;
  for (int y = 0; y < once.cells.view().height; ++y)
    for (int x = 0; x < once.cells.view().width; ++x) {
      CHECK(once.cells.view()(x, y) == again.cells.view()(x, y));
      free += once.cells.view()(x, y) == OccupancyImage::kFree;
      occupied += once.cells.view()(x, y) == OccupancyImage::kOccupied;
    }
  // A room of 13 m2, seen in part.
  CHECK(free * once.cell * once.cell > 0.5);
  CHECK(free * once.cell * once.cell < 14);
  CHECK(occupied > 5);
}

TEST_CASE("the floor does not change where the robot is", "[floor_stage]") {
  const auto run = [](bool floor) {
    SweeperOptions options = floor_options();
    options.floor.enabled = floor;
    Sweeper sweeper(Room().rig(), options);
    for (const StereoImage& image : drive_images()) sweeper.feed(image);
    sweeper.finish();
    CHECK(sweeper.grid().has_value() == floor);
    CHECK((sweeper.obstacles() != nullptr) == floor);
    return sweeper.images();
  };
  const auto with = run(true), without = run(false);
  REQUIRE(with.size() == without.size());
  for (std::size_t i = 0; i < with.size(); ++i)
    CHECK(with[i].T_map_body.matrix() == without[i].T_map_body.matrix());
}

TEST_CASE("in real time the floor has a thread of its own", "[floor_stage][realtime]") {
  Sweeper sweeper(Room().rig(), floor_options(true));
  for (const StereoImage& image : drive_images()) sweeper.feed(image);
  for (int i = 0; i < 5; ++i) CHECK_NOTHROW(sweeper.grid());
  sweeper.finish();
  CHECK(sweeper.obstacles() != nullptr);
  CHECK(sweeper.images().size() == drive_images().size());
}

TEST_CASE("a floor that nothing tells of is refused", "[floor_stage]") {
  SweeperOptions options = floor_options();
  options.floor.mounting.camera_height = 0;
  CHECK_THROWS_WITH(Sweeper(Room().rig(), options), Catch::Contains("camera_height"));
  CHECK_THROWS_AS(Sweeper(Room().rig(MotionSensors{}), options), Error);
}
