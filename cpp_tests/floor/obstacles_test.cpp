// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/obstacles.hpp"

#include <catch2/catch.hpp>
#include <deque>
#include <limits>
#include <numbers>
#include <set>
#include <utility>

#include "box_world.hpp"
#include "sweepkit/core/error.hpp"

using namespace sweepkit;
using box_world::standing;
using box_world::World;

namespace {

std::vector<Obstacle> found_in(const World& world, const Image<float>& disparities,
                               const ObstacleOptions& options = {}) {
  const GrayImage mask = world.mask(disparities);
  ObstacleFinder finder(options);
  return finder.find(disparities.view(), mask.view(), world.camera, world.plane);
}

bool same(const Obstacle& a, const Obstacle& b) {
  return a.kind == b.kind && a.pixels == b.pixels && a.p_camera == b.p_camera &&
         a.box.centre == b.box.centre && a.box.top == b.box.top && a.distance == b.distance;
}

}  // namespace

TEST_CASE("the floor's frame stands below the camera") {
  const GroundPlane plane{Vec3<double>(0.1, 0.9, -0.2).normalized(), 0.3};
  const SE3d T = floor_frame(plane);
  CHECK((T * Vec3<double>::Zero() - Vec3<double>(0, 0, 0.3)).norm() < 1e-12);
  for (const Vec3<double>& p : {Vec3<double>(0.2, 0.1, 1), Vec3<double>(-1, 2, 3)})
    CHECK((T * p).z() == Approx(plane.height_of(p)));
  const Vec3<double> ahead = T.rotation() * Vec3<double>::UnitZ();
  CHECK(ahead.x() > 0);
  CHECK(std::abs(ahead.y()) < 1e-12);
  // Straight down.
  const SE3d T_down = floor_frame({Vec3<double>::UnitZ(), 1.0});
  CHECK((T_down.rotation() * -Vec3<double>::UnitY() - Vec3<double>::UnitX()).norm() < 1e-12);
}

TEST_CASE("a box moves with its frame") {
  FloorBox box;
  box.centre = {1, 2};
  box.yaw = 0.3;
  box.top = 0.5;
  const SE3d T(SO3d::exp({0, 0, 1.5}), {3, -1, 0.25});
  const FloorBox there = moved(box, T);
  CHECK((there.centre - (T * Vec3<double>(1, 2, 0)).head<2>()).norm() < 1e-12);
  CHECK(there.yaw == Approx(0.3 + 1.5 - std::numbers::pi));
  CHECK(there.top == Approx(0.75));
  const FloorBox back = moved(there, T.inverse());
  CHECK((back.centre - box.centre).norm() < 1e-12);
  CHECK(back.yaw == Approx(box.yaw));
}

TEST_CASE("a box is found with its place, size and height") {
  for (const double distance : {0.25, 0.5, 0.9})
    for (const double height : {0.02, 0.05, 0.15}) {
      World world;
      world.boxes = {standing(distance, 0.05, 0.06, 0.1, height)};
      world.far_wall = 10;
      INFO("distance " << distance << " height " << height);
      const auto found = found_in(world, world.disparities(0.2));
      REQUIRE(found.size() == 1);
      const Obstacle& o = found[0];
      CHECK(o.kind == ObstacleKind::obstacle);
      CHECK(std::abs(o.distance - distance) < 0.01 + 0.04 * distance);
      CHECK(std::abs(o.box.centre.y() - 0.05) < 0.02);
      CHECK(o.box.top == Approx(height).margin(0.006 + 0.02 * distance));
      CHECK(o.box.bottom < 0.02);
      CHECK(std::max(o.box.length, o.box.width) > 0.08);
      const Vec3<double> p_floor = floor_frame(world.plane) * o.p_camera;
      CHECK(p_floor.x() > distance - 0.03);
      CHECK(p_floor.x() < distance + 0.09);
      // Its uncertainty grows along the ray, as stereo's does.
      CHECK(o.covariance(2, 2) > 0);
      CHECK(std::sqrt(o.covariance(2, 2)) ==
            Approx(0.5 * o.p_camera.z() * o.p_camera.z() / (world.camera.focal * world.camera.baseline))
                .epsilon(0.05));
    }
}

TEST_CASE("floor, carpets and missing disparities are no obstacles") {
  World world;
  world.far_wall = 10;
  SECTION("bare floor") {}
  SECTION("a carpet") { world.boxes = {{{0.3, -0.4, 0}, {1.2, 0.5, 0.012}}}; }
  SECTION("a thick carpet") { world.boxes = {{{0.3, -0.4, 0}, {1.2, 0.5, 0.019}}}; }
  SECTION("bare floor around the carpet under the wheels") { world.pits = {{{0.4, -5}, {9, 5}, 0.015}}; }
  Image<float> disparities = world.disparities(0.25);
  CHECK(found_in(world, disparities).empty());
  // A carpet without texture: nothing is known of it.
  for (int v = 120; v < 170; ++v)
    for (int u = 60; u < 250; ++u)
      disparities(u, v) = u % 3 == 0 ? std::numeric_limits<float>::quiet_NaN() : (u % 3 == 1 ? 0.0f : -1.0f);
  CHECK(found_in(world, disparities).empty());
  disparities.fill(0);
  CHECK(found_in(world, disparities).empty());
  disparities.fill(std::numeric_limits<float>::infinity());
  CHECK(found_in(world, disparities).empty());
}

TEST_CASE("a step down and a hole are of their own kind") {
  World world;
  world.far_wall = 10;
  SECTION("a step") { world.pits = {{{0.6, -5}, {9, 5}, 0.1}}; }
  SECTION("a hole") { world.pits = {{{0.6, -0.2}, {0.9, 0.2}, 0.08}}; }
  const auto found = found_in(world, world.disparities(0.2));
  REQUIRE(found.size() >= 1);
  CHECK(found[0].kind == ObstacleKind::hole);
  CHECK(found[0].distance == Approx(0.6).margin(0.07));
  CHECK(found[0].box.bottom < -0.035);
  for (const Obstacle& o : found) CHECK(o.kind == ObstacleKind::hole);
}

TEST_CASE("things at different depths stay apart, walls are cut") {
  World world;
  world.far_wall = 1.5;
  world.boxes = {standing(0.4, 0.0, 0.05, 0.08, 0.06), standing(0.7, 0.02, 0.05, 0.2, 0.12)};
  const auto found = found_in(world, world.disparities(0.1));
  REQUIRE(found.size() >= 4);
  CHECK(found[0].distance == Approx(0.4).margin(0.02));
  CHECK(found[1].distance == Approx(0.7).margin(0.03));
  for (std::size_t i = 2; i < found.size(); ++i) {
    CHECK(found[i].distance > 1.3);
    CHECK(found[i].box.length <= ObstacleOptions().max_length + 1e-6);
    CHECK(found[i].distance >= found[i - 1].distance);
  }
}

TEST_CASE("regions are those of a flood fill") {
  World world;
  world.far_wall = 2.5;
  world.boxes = {standing(0.3, 0.1, 0.05, 0.05, 0.03), standing(0.35, -0.1, 0.05, 0.08, 0.1),
                 standing(0.8, 0.3, 0.2, 0.3, 0.2), standing(1.1, -0.4, 0.1, 0.3, 0.07)};
  const Image<float> disparities = world.disparities(0.15);
  const GrayImage mask = world.mask(disparities);
  ObstacleOptions options;
  options.min_pixels = 1;
  options.min_area = 0;
  options.min_top = 0.001;
  options.carpet_top = 0;
  options.max_length = 100;
  options.clearance = 10;
  ObstacleFinder finder(options);
  const auto& found = finder.find(disparities.view(), mask.view(), world.camera, world.plane);

  // What takes part: high enough, near enough.
  const auto height = [&](int u, int v) {
    const double d = disparities(u, v);
    const double s = world.camera.baseline / d;
    return world.plane.height_of(
        {s * (u - world.camera.cx), s * (v - world.camera.cy), s * world.camera.focal});
  };
  const auto counts = [&](int u, int v) {
    return mask(u, v) == 2 && height(u, v) >= options.min_height && height(u, v) <= options.max_height &&
           world.camera.depth(disparities(u, v)) <= options.max_range;
  };
  std::set<std::pair<int, int>> seen;
  std::multiset<int> sizes;
  int pixels = 0;
  for (int v = 0; v < world.height; ++v)
    for (int u = 0; u < world.width; ++u) {
      if (!counts(u, v) || seen.count({u, v})) continue;
      std::deque<std::pair<int, int>> open{{u, v}};
      seen.insert({u, v});
      int size = 0;
      const int region = finder.regions()(u, v);
      CHECK(region > 0);
      while (!open.empty()) {
        const auto [x, y] = open.front();
        open.pop_front();
        ++size;
        CHECK(finder.regions()(x, y) == region);
        for (int dy = -2; dy <= 2; ++dy)
          for (int dx = -2; dx <= 2; ++dx) {
            if ((std::abs(dx) == 2 || std::abs(dy) == 2) && dx != 0 && dy != 0) continue;
            const int a = x + dx, b = y + dy;
            if (a < 0 || b < 0 || a >= world.width || b >= world.height) continue;
            if (!counts(a, b) || seen.count({a, b})) continue;
            // The pixel that comes later in the image tells the step.
            const double d = b > y || (b == y && a > x) ? disparities(a, b) : disparities(x, y);
            const double step =
                std::max(options.link_disparity,
                         d * d * options.link_gap / (world.camera.focal * world.camera.baseline));
            if (std::abs(disparities(a, b) - disparities(x, y)) > step) continue;
            seen.insert({a, b});
            open.push_back({a, b});
          }
      }
      sizes.insert(size);
      pixels += size;
    }
  CHECK(sizes.size() == found.size());
  CHECK(pixels > 1000);
}

TEST_CASE("both disparity types and repeated calls agree") {
  World world;
  world.boxes = {standing(0.5, 0.0, 0.1, 0.1, 0.05)};
  const Image<float> disparities = world.disparities(0.1);
  Image<std::int16_t> sixteenths(world.width, world.height);
  Image<float> rounded(world.width, world.height);
  for (int v = 0; v < world.height; ++v)
    for (int u = 0; u < world.width; ++u) {
      sixteenths(u, v) = static_cast<std::int16_t>(std::lround(16 * disparities(u, v)));
      rounded(u, v) = sixteenths(u, v) / 16.0f;
    }
  const GrayImage mask = world.mask(rounded);
  ObstacleFinder a, b;
  b.find(disparities.view(), world.mask(disparities).view(), world.camera, world.plane);
  const auto first = a.find(std::as_const(rounded).view(), mask.view(), world.camera, world.plane);
  const auto& second = b.find(std::as_const(sixteenths).view(), mask.view(), world.camera, world.plane);
  REQUIRE(first.size() == second.size());
  for (std::size_t i = 0; i < first.size(); ++i) CHECK(same(first[i], second[i]));
}

TEST_CASE("the images themselves refute a thing that is none") {
  // A floor with a random texture, and disparities that claim a box on it.
  World world;
  world.far_wall = 10;
  World claimed = world;
  claimed.boxes = {standing(0.5, 0.0, 0.05, 0.1, 0.05)};
  Random random(3);
  GrayImage left(world.width, world.height), right(world.width, world.height);
  // Each row is a row of noise, smoothed; the left image is the right one moved by the disparity.
  const auto draw = [&](const World& shown) {
    for (int v = 0; v < world.height; ++v) {
      std::vector<double> row(static_cast<std::size_t>(world.width) + 2);
      for (double& value : row) value = random.uniform(0, 255);
      const auto at = [&](double x) {
        const double c = std::clamp(x, 0.0, world.width - 1.0);
        const auto i = static_cast<std::size_t>(c);
        return row[i] + (c - static_cast<double>(i)) * (row[i + 1] - row[i]);
      };
      for (int u = 0; u < world.width; ++u) {
        right(u, v) = static_cast<std::uint8_t>(at(u));
        left(u, v) = static_cast<std::uint8_t>(at(u - shown.disparity(u, v)));
      }
    }
  };
  const Image<float> disparities = claimed.disparities(0.05);
  const GrayImage mask = world.mask(disparities);
  ObstacleFinder finder;
  draw(claimed);
  CHECK(finder.find(disparities.view(), mask.view(), world.camera, world.plane, left.view(), right.view())
            .size() == 1);
  draw(world);
  CHECK(finder.find(disparities.view(), mask.view(), world.camera, world.plane, left.view(), right.view())
            .empty());
  // Without texture the images tell nothing.
  left.fill(20);
  right.fill(20);
  CHECK(finder.find(disparities.view(), mask.view(), world.camera, world.plane, left.view(), right.view())
            .empty());
}

TEST_CASE("no hole is found where the right image does not reach the floor") {
  World world;
  world.far_wall = 10;
  Image<float> disparities = world.disparities();
  const FloorDisparity floor = world.plane.disparity(world.camera);
  const auto sink = [&](int first, int count) {
    for (int v = 150; v < 175; ++v)
      for (int u = first; u < first + count; ++u) disparities(u, v) = 0.5f * static_cast<float>(floor(u, v));
  };
  // At the left the floor's partner lies left of the right image; what is found there is by chance.
  sink(3, 38);
  CHECK(floor(40, 150) > 40);
  CHECK(found_in(world, disparities).empty());
  sink(150, 38);
  const auto found = found_in(world, disparities);
  REQUIRE(found.size() == 1);
  CHECK(found[0].kind == ObstacleKind::hole);
  CHECK(found[0].image.u_min >= 150);
}

namespace {

/// A pair of images of one edge, with a disparity for all of it: the pixels around the edge are claimed to
/// stand on the floor of the world.
struct Edge {
  World world;
  GrayImage left{320, 200}, right{320, 200};
  Image<float> claimed;

  /// @param rise rows that the edge rises in a column @param rows by which the right image lies lower
  /// @param truth, claim disparities of the edge beyond those of the floor [px]
  Edge(double rise, double rows, double truth, double claim) {
    world.far_wall = 10;
    claimed = world.disparities();
    const double band = 3 * std::hypot(1.0, rise);
    const FloorDisparity floor = world.plane.disparity(world.camera);
    const auto shade = [&](double u, double v) {
      return static_cast<std::uint8_t>(
          std::lround(120 + 100 * std::tanh((v - 107 + rise * (u - 165)) / 1.5)));
    };
    for (int v = 0; v < 200; ++v)
      for (int u = 0; u < 320; ++u) {
        left(u, v) = shade(u, v);
        right(u, v) = shade(u + floor(165, v) + truth, v + rows);
        if (std::abs(u - 165) < 25 && std::abs(v - 107) < 8 && std::abs(v - 107 + rise * (u - 165)) < band)
          claimed(u, v) = static_cast<float>(floor(165, v) + claim);
      }
  }
  std::vector<Obstacle> find(bool with_images, const FloorDoubt& doubt = {}) const {
    const GrayImage mask = world.mask(claimed);
    ObstacleFinder finder;
    if (!with_images) return finder.find(claimed.view(), mask.view(), world.camera, world.plane);
    return finder.find(claimed.view(), mask.view(), world.camera, world.plane, left.view(), right.view(),
                       doubt);
  }
};

}  // namespace

TEST_CASE("a level edge is no obstacle, whatever disparity fits it best") {
  // On the floor, in images whose rows do not meet exactly: a disparity that is wrong by rows / rise fits.
  const double rise = 1.0 / 30;
  for (const double rows : {0.1, 0.2, 0.35}) {
    const Edge edge(rise, rows, 0.0, rows / rise);
    CAPTURE(rows);
    if (rows > 0.15) CHECK(edge.find(false).size() == 1);
    if (rows < 0.3) CHECK(edge.find(true).empty());
    for (const Obstacle& o : edge.find(true)) CHECK_FALSE(o.clear);
  }
  // Too high by 8 px: the images say so, but its edge alone is not beyond doubt.
  const Edge level(rise, 0.0, 8.0, 8.0);
  for (const Obstacle& o : level.find(true)) CHECK_FALSE(o.clear);
}

TEST_CASE("what would not stand out of a floor a little off its plane is not clear") {
  const World world;
  const Edge upright(1.5, 0.0, 8.0, 8.0);
  const auto sure = upright.find(true);
  REQUIRE(sure.size() == 1);
  CHECK(sure[0].clear);
  // Three standard deviations of the tilt lift the floor by 6 px, and a carpet by more than 8.
  const double tilt = 2 * world.plane.height / (world.camera.focal * world.camera.baseline);
  const auto unsure = upright.find(true, {tilt, false});
  REQUIRE(unsure.size() == 1);
  CHECK_FALSE(unsure[0].clear);
  CHECK(unsure[0].pixels == sure[0].pixels);
}

TEST_CASE("a carpet whose pattern repeats is no hole") {
  World world;
  world.far_wall = 10;
  const FloorDisparity floor = world.plane.disparity(world.camera);
  constexpr double kPeriod = 10, kDeep = -8;
  Image<float> claimed = world.disparities();
  for (int v = 103; v < 112; ++v)
    for (int u = 130; u < 200; ++u) claimed(u, v) = static_cast<float>(floor(u, v) + kDeep);
  const GrayImage mask = world.mask(claimed);
  const auto stripes = [&](double x, double v) {
    return static_cast<std::uint8_t>(
        std::lround(120 + 15 * std::sin(2 * std::numbers::pi / kPeriod * x + 0.3 * v)));
  };
  ObstacleFinder finder;
  // The carpet is 9 mm thick; a period of its pattern makes it a hole.
  GrayImage left(world.width, world.height), right(world.width, world.height);
  for (int v = 0; v < world.height; ++v)
    for (int u = 0; u < world.width; ++u) {
      left(u, v) = stripes(u, v);
      right(u, v) = stripes(u + floor(165, v) + kDeep + kPeriod, v);
    }
  CHECK(finder.find(std::as_const(claimed).view(), mask.view(), world.camera, world.plane).size() == 1);
  CHECK(finder
            .find(std::as_const(claimed).view(), mask.view(), world.camera, world.plane, left.view(),
                  right.view())
            .empty());
}

TEST_CASE("a hole is not clear where the image contradicts the plane") {
  World world;
  world.far_wall = 10;
  world.pits = {{{0.4, -0.1}, {0.7, 0.1}, 0.06}};
  const Image<float> disparities = world.disparities();
  const GrayImage mask = world.mask(disparities);
  ObstacleFinder finder;
  const auto clear = [&](const FloorDoubt& doubt) {
    const auto& found =
        finder.find(disparities.view(), mask.view(), world.camera, world.plane, {}, {}, doubt);
    REQUIRE(found.size() == 1);
    REQUIRE(found[0].kind == ObstacleKind::hole);
    return found[0].clear;
  };
  CHECK(clear({}));
  CHECK(clear({0.005, false}));
  CHECK_FALSE(clear({0.0, true}));
}

TEST_CASE("wrong sizes and options are refused") {
  World world;
  const Image<float> disparities = world.disparities();
  ObstacleFinder finder;
  const GrayImage small(10, 10);
  CHECK_THROWS_AS(finder.find(disparities.view(), small.view(), world.camera, world.plane), Error);
  const GrayImage mask = world.mask(disparities);
  CHECK_THROWS_AS(
      finder.find(disparities.view(), mask.view(), world.camera, world.plane, small.view(), small.view()),
      Error);
  CHECK_THROWS_AS(finder.find(disparities.view(), mask.view(), world.camera, {Vec3<double>::UnitY(), -1}),
                  Error);
  ObstacleOptions options;
  options.min_height = -1;
  CHECK_THROWS_AS(ObstacleFinder(options), Error);
  CHECK(finder.find(View2d<const float>{}, GrayView{}, world.camera, world.plane).empty());
}
