// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/obstacle_tracker.hpp"

#include <catch2/catch.hpp>
#include <utility>

#include "box_world.hpp"
#include "sweepkit/core/error.hpp"

using namespace sweepkit;
using box_world::standing;
using box_world::World;

namespace {

constexpr TimeNs kStep = 100'000'000;

/// A camera that moves over the floor and tells a tracker what it sees.
struct Watch {
  World world;
  ObstacleFinder finder;
  ObstacleTracker tracker;
  TimeNs t = 0;

  void look(const Vec2<double>& at, bool blind = false) {
    Image<float> disparities = world.disparities(0.1, at, static_cast<std::uint64_t>(t / kStep) + 1);
    if (blind) disparities.fill(0);
    const GrayImage mask = world.mask(disparities);
    const auto& found =
        finder.find(std::as_const(disparities).view(), mask.view(), world.camera, world.plane);
    const SE3d T_world_camera = SE3d(SO3d(), Vec3<double>(at.x(), at.y(), 0)) * floor_frame(world.plane);
    tracker.update(t += kStep, found, std::as_const(disparities).view(), world.camera, world.plane,
                   T_world_camera);
  }
};

}  // namespace

TEST_CASE("an obstacle is confirmed, kept under one id and dropped when it is gone") {
  Watch watch;
  watch.world.far_wall = 10;
  watch.world.boxes = {standing(0.9, 0.05, 0.06, 0.1, 0.06)};
  watch.look({0, 0});
  REQUIRE(watch.tracker.tracked().size() == 1);
  CHECK_FALSE(watch.tracker.tracked()[0].confirmed);
  CHECK(watch.tracker.tracked()[0].confidence() > 0.5);
  for (int i = 1; i < 10; ++i) watch.look({0.03 * i, 0.005 * i});
  REQUIRE(watch.tracker.tracked().size() == 1);
  const TrackedObstacle& thing = watch.tracker.tracked()[0];
  CHECK(thing.id == 1);
  CHECK(thing.confirmed);
  CHECK(thing.hits == 10);
  CHECK(thing.confidence() > 0.95);
  CHECK(thing.p_world.x() == Approx(0.92).margin(0.03));
  CHECK(thing.p_world.y() == Approx(0.05).margin(0.01));
  CHECK(thing.box.centre.y() == Approx(0.05).margin(0.01));
  CHECK(thing.last == 0);

  SECTION("taken away") {
    watch.world.boxes.clear();
    for (int i = 0; i < 20; ++i) watch.look({0.3, 0.05});
    CHECK(watch.tracker.tracked().empty());
  }
  SECTION("blind") {
    const double before = thing.log_odds;
    for (int i = 0; i < 20; ++i) watch.look({0.3, 0.05}, true);
    REQUIRE(watch.tracker.tracked().size() == 1);
    CHECK(watch.tracker.tracked()[0].log_odds == before);
    CHECK(watch.tracker.tracked()[0].last == -1);
  }
  SECTION("hidden") {
    watch.world.boxes.push_back(standing(0.6, 0.05, 0.05, 0.5, 0.2));
    for (int i = 0; i < 20; ++i) watch.look({0.3, 0.05});
    REQUIRE(watch.tracker.tracked().size() == 2);
    CHECK(watch.tracker.tracked()[0].id == 1);
    CHECK(watch.tracker.tracked()[0].confirmed);
  }
  SECTION("passed") {
    for (int i = 0; i < 20; ++i) watch.look({2.0, 0.05});
    REQUIRE(watch.tracker.tracked().size() == 1);
    watch.t += 60'000'000'000;
    watch.look({2.0, 0.05});
    CHECK(watch.tracker.tracked().empty());
  }
}

TEST_CASE("two things near each other keep their ids") {
  Watch watch;
  watch.world.far_wall = 10;
  watch.world.boxes = {standing(0.6, 0.12, 0.05, 0.06, 0.05), standing(0.8, -0.12, 0.05, 0.06, 0.08)};
  for (int i = 0; i < 8; ++i) watch.look({0.02 * i, 0});
  REQUIRE(watch.tracker.tracked().size() == 2);
  for (const TrackedObstacle& thing : watch.tracker.tracked()) {
    CHECK(thing.hits == 8);
    CHECK(thing.confirmed);
  }
  CHECK(watch.tracker.tracked()[0].p_world.y() > 0.05);
  CHECK(watch.tracker.tracked()[1].p_world.y() < -0.05);
  watch.tracker.reset();
  watch.look({0.2, 0});
  REQUIRE(watch.tracker.tracked().size() == 2);
  CHECK(watch.tracker.tracked()[0].id == 3);
}

TEST_CASE("faint sightings keep a thing but never confirm it") {
  Watch watch;
  watch.world.far_wall = 10;
  watch.world.boxes = {standing(0.9, 0.05, 0.06, 0.1, 0.06)};
  const Image<float> disparities = watch.world.disparities(0.1);
  const GrayImage mask = watch.world.mask(disparities);
  std::vector<Obstacle> found = watch.finder.find(std::as_const(disparities).view(), mask.view(),
                                                  watch.world.camera, watch.world.plane);
  REQUIRE(found.size() == 1);
  const auto look = [&](bool clear) {
    found[0].clear = clear;
    watch.tracker.update(watch.t += kStep, found, std::as_const(disparities).view(), watch.world.camera,
                         watch.world.plane, floor_frame(watch.world.plane));
    REQUIRE(watch.tracker.tracked().size() == 1);
    return watch.tracker.tracked()[0];
  };
  for (int i = 0; i < 30; ++i) CHECK_FALSE(look(false).confirmed);
  CHECK(look(false).log_odds == 0);
  CHECK(look(false).hits == 32);
  for (int i = 0; i < 2; ++i) CHECK_FALSE(look(true).confirmed);
  CHECK(look(true).confirmed);
  CHECK(look(false).log_odds == look(false).log_odds);
}

TEST_CASE("options of the tracker are checked") {
  ObstacleTrackerOptions options;
  options.hit = -1;
  CHECK_THROWS_AS(ObstacleTracker(options), Error);
}
