// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/scene.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <functional>
#include <numbers>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/data/flat.hpp"
#include "sweepkit/data/floor_plan.hpp"
#include "sweepkit/data/scene_file.hpp"
#include "sweepkit/data/scene_plot.hpp"

using namespace sweepkit;
using Vec2d = Vec2<double>;

namespace {

constexpr double kPi = std::numbers::pi;

/// Two rooms of 4 x 3 m and 3 x 3 m with a wall of 0.1 m between them and a door with a sill.
Scene two_rooms() {
  Scene scene;
  Room a;
  a.name = "a";
  a.corners = {{0, 0}, {4, 0}, {4, 3}, {0, 3}};
  Room b;
  b.name = "b";
  b.corners = {{4.1, 0}, {7.1, 0}, {7.1, 3}, {4.1, 3}};
  scene.rooms = {a, b};
  Door door;
  door.from = "a";
  door.to = "b";
  door.centre = {4.05, 1.5};
  door.width = 0.9;
  door.sill = 0.015;
  scene.doors = {door};
  return scene;
}

SceneObject object(ObjectKind kind, double x, double y, double yaw = 0) {
  SceneObject o;
  o.kind = kind;
  o.centre = {x, y};
  o.yaw = yaw;
  return o;
}

std::string complaint(const Scene& scene) {
  try {
    scene.check("file");
  } catch (const Error& e) {
    CHECK(e.kind() == ErrorKind::data);
    return e.what();
  }
  return {};
}

using Catch::Matchers::Contains;

}  // namespace

TEST_CASE("a sound scene passes, and what is wrong is named") {
  const Scene good = two_rooms();
  REQUIRE_NOTHROW(good.check());
  const auto refused = [&](const std::function<void(Scene&)>& spoil, const std::string& what) {
    Scene bad = good;
    spoil(bad);
    const std::string text = complaint(bad);
    INFO(text);
    CHECK_THAT(text, Contains(what));
    CHECK_THAT(text, Contains("file: "));
  };
  refused([](Scene& s) { s.rooms.clear(); }, "at least one room");
  refused(
      [](Scene& s) {
        s.rooms[0].corners = {{0, 0}, {4, 0}, {4, 0.01}, {0, 0.01}};
      },
      "room a: must have an area");
  refused([](Scene& s) { s.rooms[0].corners = {{0, 0}, {0, 3}, {4, 3}, {4, 0}}; }, "counter-clockwise");
  refused(
      [](Scene& s) {
        s.rooms[0].corners = {{0, 0}, {4, 0}, {1, 3}, {3.5, 3}, {0, 1}};
      },
      "cross each other");
  refused([](Scene& s) { s.rooms[1].corners = {{3, 1}, {7, 1}, {7, 2}, {3, 2}}; }, "room b: overlaps room a");
  refused([](Scene& s) { s.rooms[1].name = "a"; }, "two rooms have this name");
  refused([](Scene& s) { s.rooms[0].floor = "lava"; }, "no such material");
  refused([](Scene& s) { s.rooms[0].corners[0].x() = std::nan(""); }, "room a");
  refused([](Scene& s) { s.doors[0].to = "c"; }, "no such room");
  refused([](Scene& s) { s.doors[0].centre = {4.05, 0.3}; }, "reaches beyond the end of its wall");
  refused([](Scene& s) { s.doors[0].centre = {2, 0}; }, "lies too far from room b");
  refused([](Scene& s) { s.doors[0].sill = 0.2; }, "sill");
  refused(
      [](Scene& s) {
        s.windows.push_back({"a", 1, 1.5, 0.9, 1.0, 1.0});
      },
      "windows[0]: overlaps door a - b");
  refused([](Scene& s) { s.windows.push_back({"a", 7, 1.5, 0.9, 1.0, 1.0}); }, "no such wall");
  refused(
      [](Scene& s) {
        s.pictures.push_back({"a", 0, 3.9, 1.3, 0.5, 0.4, 0});
      },
      "pictures[0]: reaches beyond its wall");
  refused([](Scene& s) { s.objects = {object(ObjectKind::table, 3.8, 1.5)}; },
          "objects[0] (table at [3.80, 1.50]): reaches through a wall of room a");
  refused([](Scene& s) { s.objects = {object(ObjectKind::table, 9, 9)}; }, "stands in no room");
  refused([](Scene& s) { s.objects = {object(ObjectKind::bin, 4.05, 1.5)}; }, "stands in no room");
  refused(
      [](Scene& s) {
        s.objects = {object(ObjectKind::shelf, 1, 1), object(ObjectKind::bin, 1.2, 1.05)};
      },
      "objects[1] (bin at [1.20, 1.05]): stands in objects[0]");
  refused(
      [](Scene& s) {
        s.objects = {object(ObjectKind::carpet, 1, 1), object(ObjectKind::carpet, 1.5, 1)};
      },
      "stands in objects[0]");
  refused([](Scene& s) { s.objects = {object(ObjectKind::ball, 1, std::nan(""))}; }, "within 100 m");
  refused(
      [](Scene& s) {
        s.objects = {object(ObjectKind::sofa, 1, 1)};
        s.objects[0].size = {0.1, 0.1, 0.1};
      },
      "too small for its kind");
  refused([](Scene& s) { s.lights.push_back({{1, 1, 2}, -1, 0.1}); }, "lights[0] power");
}

TEST_CASE("a chair may stand under a table, a ball on a carpet and a box on a box") {
  Scene scene = two_rooms();
  scene.objects = {object(ObjectKind::table, 1.5, 1.5), object(ObjectKind::ball, 3, 2),
                   object(ObjectKind::carpet, 3, 2)};
  scene.objects.push_back(object(ObjectKind::bin, 1.5, 1.5));
  SceneObject box = object(ObjectKind::box, 6, 2);
  scene.objects.push_back(box);
  box.base = 0.4;
  scene.objects.push_back(box);
  CHECK_NOTHROW(scene.check());
}

TEST_CASE("a room's main direction is that of its walls; a round room has none") {
  Scene scene = two_rooms();
  CHECK(scene.main_direction(scene.rooms[0]).value() == Approx(0).margin(1e-12));
  for (auto& corner : scene.rooms[0].corners) corner = Eigen::Rotation2Dd(0.3 + 3 * kPi / 2) * corner;
  CHECK(scene.main_direction(scene.rooms[0]).value() == Approx(0.3));
  Room round = scene.rooms[0];
  round.corners.clear();
  for (int i = 0; i < 12; ++i)
    round.corners.emplace_back(2 * std::cos(i * kPi / 6), 2 * std::sin(i * kPi / 6));
  CHECK_FALSE(scene.main_direction(round).has_value());
}

TEST_CASE("generated flats are sound, alike for one seed and all of them can be driven") {
  for (int seed = 0; seed < 12; ++seed) {
    FlatOptions options;
    options.seed = seed;
    options.rooms = 1 + seed % 4;
    options.odd_angles = seed % 3 * 0.5;
    options.sill = seed % 2 ? 0.015 : 0.0;
    options.bare_walls = seed % 5 == 4;
    const Scene scene = generate_flat(options);
    CHECK_NOTHROW(scene.check());
    CHECK(scene_to_yaml(generate_flat(options)) == scene_to_yaml(scene));
    CHECK(scene.rooms.size() == static_cast<std::size_t>(options.rooms));
    CHECK(scene.objects.size() > 4u);
    const FloorPlan plan(scene);
    for (const Door& door : scene.doors) CHECK(plan.is_free(door.centre.x(), door.centre.y(), 0.18));
    for (const Room& room : scene.rooms)
      CHECK(std::abs(std::remainder(scene.main_direction(room).value() - scene.yaw, kPi / 2)) < 1e-9);
  }
  FlatOptions wrong;
  wrong.room_min = 5;
  wrong.room_max = 4;
  CHECK_THROWS_AS(generate_flat(wrong), Error);
}

TEST_CASE("truth boxes hold the objects, along their own axes") {
  Scene scene = two_rooms();
  scene.objects = {object(ObjectKind::box, 1, 1, 0.4), object(ObjectKind::ball, 2, 2),
                   object(ObjectKind::sofa, 5.5, 1.5, 1.0)};
  const auto truth = object_truth(scene);
  REQUIRE(truth.size() == 3);
  CHECK((truth[0].size - Vec3<double>(0.4, 0.4, 0.4)).norm() < 1e-9);
  CHECK((truth[0].centre - Vec3<double>(1, 1, 0.2)).norm() < 1e-9);
  CHECK(truth[0].yaw == 0.4);
  CHECK(truth[0].object_class == "furniture");
  CHECK(truth[1].object_class == "small");
  CHECK(truth[1].label == SceneLabel::small);
  CHECK(truth[2].size.x() == Approx(1.9));
  CHECK(truth[2].size.y() == Approx(0.85));
  CHECK(truth[2].size.z() == Approx(0.8));
}

TEST_CASE("the floor rises over carpets and sills, twice differentiable") {
  Scene scene = two_rooms();
  SceneObject carpet = object(ObjectKind::carpet, 2, 1.5, 0.3);
  carpet.size = {1.2, 0.8, 0.01};
  scene.objects = {carpet, object(ObjectKind::cable, 1, 0.5)};
  scene.check();
  const FloorPlan plan(scene);
  CHECK(plan.height(0.5, 2.5) == 0.0);
  CHECK(plan.height(2, 1.5) == Approx(0.01));
  CHECK(plan.height(4.05, 1.5) == Approx(0.015));
  CHECK(plan.carpet_at(2, 1.5) == 0);
  CHECK(plan.carpet_at(3.5, 1.5) == -1);
  CHECK(plan.room_at(1, 1) == 0);
  CHECK(plan.room_at(5, 1) == 1);
  CHECK(plan.room_at(4.05, 1.5) == -1);
  // Neither value nor the first two derivatives jump: their changes shrink with the step.
  const auto worst_jump = [&](double step) {
    double worst = 0, last = 0;
    for (double x = 1.2; x < 4.6; x += step) {
      const double h = 1e-4;
      const double second =
          (plan.height(x + h, 1.5) - 2 * plan.height(x, 1.5) + plan.height(x - h, 1.5)) / (h * h);
      if (x > 1.2) worst = std::max(worst, std::abs(second - last));
      last = second;
    }
    return worst;
  };
  const double coarse = worst_jump(4e-4), fine = worst_jump(1e-4);
  CHECK(fine < 0.35 * coarse);
}

TEST_CASE("clearance agrees with a slow look at what stands around") {
  Scene scene = two_rooms();
  SceneObject box = object(ObjectKind::box, 1, 1, 0.5);
  SceneObject drum = object(ObjectKind::cylinder, 2.5, 2);
  SceneObject high = object(ObjectKind::box, 3, 0.6);
  high.base = 0.3;
  SceneObject flat = object(ObjectKind::box, 0.6, 2.3);
  flat.size = {0.3, 0.3, 0.01};
  scene.objects = {box, drum, high, flat, object(ObjectKind::table, 5.5, 1.5)};
  scene.check();
  const FloorPlan plan(scene);
  // The reference: points on a fine grid, solid or not by plain arithmetic.
  const auto solid = [&](const Vec2d& p) {
    const bool in_a = p.x() > 0 && p.x() < 4 && p.y() > 0 && p.y() < 3;
    const bool in_b = p.x() > 4.1 && p.x() < 7.1 && p.y() > 0 && p.y() < 3;
    const bool in_door = p.x() >= 4 && p.x() <= 4.1 && std::abs(p.y() - 1.5) < 0.45;
    if (!in_a && !in_b && !in_door) return true;
    const Vec2d q = Eigen::Rotation2Dd(-0.5) * (p - Vec2d(1, 1));
    if (q.cwiseAbs().maxCoeff() < 0.2) return true;
    if ((p - Vec2d(2.5, 2)).norm() < 0.15) return true;
    // The table's four legs.
    return ((p - Vec2d(5.5, 1.5)).cwiseAbs() - Vec2d(0.67, 0.37)).cwiseAbs().maxCoeff() < 0.03;
  };
  constexpr double kStep = 0.01;
  Random random(3);
  for (int n = 0; n < 60; ++n) {
    const Vec2d p(random.uniform(0.05, 7.05), random.uniform(0.05, 2.95));
    double nearest = 1e9;
    for (double x = -0.1; x < 7.2; x += kStep)
      for (double y = -0.1; y < 3.1; y += kStep)
        if (solid({x, y})) nearest = std::min(nearest, std::hypot(x - p.x(), y - p.y()));
    const double clearance = plan.clearance(p.x(), p.y());
    INFO(p.transpose() << " slow " << nearest << " fast " << clearance);
    if (solid(p))
      CHECK(clearance < kStep);
    else
      CHECK(std::abs(clearance - nearest) < 1.5 * kStep);
    CHECK(plan.is_free(p.x(), p.y(), 0.1) == (clearance >= 0.1));
  }
  CHECK(plan.clearance(-0.5, 1) < 0);
  CHECK(plan.clearance(4.05, 2.5) < 0);
}

TEST_CASE("true occupancy: free where reached, occupied along what is solid, unknown behind") {
  Scene scene = two_rooms();
  SceneObject crate = object(ObjectKind::box, 1, 1);
  crate.size = {0.8, 0.8, 0.5};
  SceneObject carpet = object(ObjectKind::carpet, 2.8, 1.5);
  carpet.size = {1.0, 0.8, 0.01};
  scene.objects = {crate, carpet, object(ObjectKind::cable, 5.5, 1.5)};
  const auto map = true_occupancy(scene, {3, 2});
  const auto at = [&](double x, double y) {
    const int u = static_cast<int>((x - map.origin.x()) / map.cell);
    const int v = map.cells.height() - 1 - static_cast<int>((y - map.origin.y()) / map.cell);
    return static_cast<int>(map.cells(u, v));
  };
  CHECK(at(3, 2) == 254);
  CHECK(at(2.8, 1.5) == 254);   // carpet
  CHECK(at(4.05, 1.5) == 254);  // sill
  CHECK(at(5.5, 1.5) == 254);   // cable
  CHECK(at(1, 1) == 205);       // inside the crate
  CHECK(at(1.39, 1) == 0);      // its side
  CHECK(at(-0.2, 1) == 205);    // outside
  CHECK(at(4.05, 2.5) != 254);  // within the wall
  Scene closed = scene;
  closed.doors.clear();
  const auto half = true_occupancy(closed, {3, 2});
  CHECK(half.cells(static_cast<int>((5.5 - half.origin.x()) / 0.05), half.cells.height() / 2) == 205);
  CHECK_THROWS_AS(true_occupancy(scene, {1, 1}), Error);
  CHECK_THROWS_AS(true_occupancy(scene, {50, 50}), Error);
}

TEST_CASE("a plan shows each room, object, path and mark") {
  Scene scene = two_rooms();
  scene.objects = {object(ObjectKind::table, 1.5, 1.5)};
  scene.objects[0].name = "desk <b>";
  const std::string svg =
      scene_to_svg(scene, {{{{1, 1}, {2, 1}}, "#d62728", "driven"}}, {{{1, 1}, "start", "#000"}});
  CHECK_THAT(svg, Contains("desk &lt;b&gt;"));
  CHECK_THAT(svg, Contains("driven"));
  CHECK_THAT(svg, Contains("start"));
  CHECK_THAT(svg, Contains("</svg>"));
  CHECK_THROWS_AS(scene_to_svg(scene, {}, {}, 3), Error);
}
