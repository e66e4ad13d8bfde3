// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/drive.hpp"

#include <array>
#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

#include "data/error_text.hpp"

using namespace sweepkit;
using Kind = DriveStep::Kind;

namespace {

constexpr double kRad = std::numbers::pi / 180.0;

// Two rooms of 4 m x 3 m with a door and a sill between them, a cabinet in the first and a carpet in the
// second.
Scene two_rooms() {
  Scene scene;
  const auto room = [](const std::string& name, double x) {
    Room r;
    r.name = name;
    r.corners = {{x, 0}, {x + 4, 0}, {x + 4, 3}, {x, 3}};
    return r;
  };
  scene.rooms = {room("west", 0), room("east", 4.1)};
  Door door;
  door.from = "west", door.to = "east", door.centre = {4.05, 1.5}, door.sill = 0.015;
  scene.doors = {door};
  SceneObject cabinet;
  cabinet.kind = ObjectKind::cabinet, cabinet.name = "cabinet", cabinet.centre = {2.0, 2.2},
  cabinet.size = {0.8, 0.4, 0.9};
  SceneObject carpet;
  carpet.kind = ObjectKind::carpet, carpet.name = "carpet", carpet.centre = {6.2, 1.5},
  carpet.size = {1.4, 1.2, 0.008};
  scene.objects = {cabinet, carpet};
  Light light;
  light.position = {2, 1.5, 2.3};
  scene.lights = {light};
  scene.check();
  return scene;
}

DriveStep step(Kind kind) {
  DriveStep s;
  s.kind = kind;
  s.place = "test";
  return s;
}

DriveStep stand(double seconds) {
  DriveStep s = step(Kind::stand);
  s.seconds = seconds;
  return s;
}

DriveStep to(Kind kind, std::vector<Vec2<double>> points, std::optional<double> yaw = {}) {
  DriveStep s = step(kind);
  s.points = std::move(points);
  s.yaw = yaw;
  return s;
}

DriveScript script(std::vector<DriveStep> steps) {
  DriveScript s;
  s.start = Vec2<double>(1, 1);
  s.place = "test";
  s.steps = std::move(steps);
  return s;
}

struct World {
  Scene scene = two_rooms();
  FloorPlan plan{scene};
  RobotOptions robot;

  Drive drive(const DriveScript& what, std::vector<DriveDisturbance> disturbances = {},
              double duration = 0) const {
    return make_drive(scene, plan, robot, what, disturbances, duration, 3);
  }
};

bool has(const Drive& drive, const std::string& kind) {
  for (const TimedEvent& e : drive.events)
    if (e.kind == kind) return true;
  return false;
}

double yaw_of(const SE3d& T) {
  const Vec3<double> x = T.rotation() * Vec3<double>(1, 0, 0);
  return std::atan2(x.y(), x.x());
}

std::string message_of(const World& world, const DriveScript& what) {
  return error_text([&] { world.drive(what); });
}

}  // namespace

TEST_CASE("a drive comes where it was sent", "[drive]") {
  const World world;
  const Drive drive = world.drive(script(
      {stand(1), to(Kind::drive, {{3, 1}, {3, 1.5}, {4.9, 1.5}}), to(Kind::go, {{1, 2.5}}, 90 * kRad)}));
  const SE3d end = drive.base.pose(drive.base.duration());
  CHECK((end.translation() - Vec3<double>(1, 2.5, 0)).norm() < 1e-6);
  CHECK(std::abs(std::remainder(yaw_of(end) - 90 * kRad, 2 * std::numbers::pi)) < 1e-6);
  CHECK(has(drive, "standstill"));
  CHECK(has(drive, "turn_in_place"));
  CHECK(has(drive, "door_passage"));
}

TEST_CASE("on flat floor a robot moves neither sideways nor too fast, and keeps off what stands there",
          "[drive]") {
  World world;
  DriveStep lanes = step(Kind::lanes);
  lanes.room = "west";
  lanes.spacing = 0.5;
  DriveStep wall = step(Kind::follow_wall);
  wall.distance = 0.25;
  wall.length = 6;
  const Drive drive = world.drive(script({stand(1), lanes, wall, step(Kind::home)}));
  CHECK(drive.base.duration() > 40);
  double sideways = 0, fastest = 0, nearest = 9;
  for (double t = 0; t < drive.base.duration(); t += 0.013) {
    const MotionState s = drive.base.at(t);
    const Vec3<double> v = s.T_world_body.rotation().inverse() * s.velocity;
    const Vec3<double>& p = s.T_world_body.translation();
    if (p.x() < 3.7) sideways = std::max(sideways, std::abs(v.y()));
    fastest = std::max(fastest, v.norm());
    nearest = std::min(nearest, world.plan.clearance(p.x(), p.y()));
    CHECK(std::abs(s.angular_rate.z()) < 1.1 * world.robot.turn_rate_deg * kRad);
    CHECK(s.acceleration.norm() < 1.5);
  }
  CHECK(sideways < 2e-4);
  CHECK(fastest < 1.02 * world.robot.speed);
  CHECK(nearest > world.robot.radius - 1e-3);
  CHECK((drive.base.pose(drive.base.duration()).translation() - Vec3<double>(1, 1, 0)).norm() < 1e-6);
}

TEST_CASE("sills and carpets lift and pitch the body", "[drive]") {
  const World world;
  const Drive drive = world.drive(script({stand(1), to(Kind::drive, {{1, 1.5}, {6.2, 1.5}})}));
  double highest = 0, pitch = 0;
  for (double t = 0; t < drive.base.duration(); t += 0.01) {
    const SE3d T = drive.base.pose(t);
    highest = std::max(highest, T.translation().z());
    pitch = std::max(pitch, std::abs((T.rotation() * Vec3<double>(1, 0, 0)).z()));
  }
  CHECK(highest == Approx(0.015).epsilon(0.1));
  CHECK(pitch > 2 * kRad);
  CHECK(pitch < 12 * kRad);
  CHECK(drive.base.pose(drive.base.duration()).translation().z() == Approx(0.008).margin(1e-4));
  CHECK(has(drive, "on_carpet"));
}

TEST_CASE("a bare wall is faced, then left backwards", "[drive]") {
  const World world;
  DriveStep face = step(Kind::face_wall);
  face.room = "west", face.wall = 3, face.along = 1.0, face.distance = 0.05, face.seconds = 2,
  face.angle = 10 * kRad;
  const Drive drive = world.drive(script({stand(1), face}));
  double nearest = 9;
  for (double t = 0; t < drive.base.duration(); t += 0.01)
    nearest = std::min(nearest, drive.base.pose(t).translation().x());
  CHECK(nearest == Approx(world.robot.radius + 0.05).margin(1e-3));
  CHECK(has(drive, "bare_wall"));
}

TEST_CASE("carried through the air the wheels do not count the way", "[drive]") {
  const World world;
  DriveStep carry = to(Kind::carry, {{6.2, 1.5}}, 200 * kRad);
  carry.seconds = 5, carry.height = 0.5;
  const Drive drive = world.drive(script({stand(2), carry, stand(1)}));
  double highest = 0;
  for (double t = 0; t < drive.base.duration(); t += 0.01)
    highest = std::max(highest, drive.base.pose(t).translation().z());
  CHECK(highest > 0.35);
  const SE3d end = drive.base.pose(drive.base.duration());
  CHECK((end.translation() - Vec3<double>(6.2, 1.5, 0.008)).norm() < 1e-6);
  CHECK(std::abs(std::remainder(yaw_of(end) - 200 * kRad, 2 * std::numbers::pi)) < 1e-6);
  REQUIRE(has(drive, "lifted"));
  const WheelSimulationOptions wheels;
  const auto ticks = simulate_wheels(drive.base, 0, wheels.ideal(), drive.episodes, 1);
  const double rolled = (ticks.back().left - ticks.front().left) * wheels.nominal().metres_per_tick();
  // They run on for 1.6 s.
  CHECK(rolled > 0.2);
  CHECK(rolled < 0.6);
}

TEST_CASE("carried anywhere it is put down in all rooms, where it fits and nothing is overhead", "[drive]") {
  Scene scene = two_rooms();
  SceneObject table;  // it could drive under it
  table.kind = ObjectKind::table, table.name = "table", table.centre = {6.2, 1.5},
  table.size = {1.8, 1.2, 0.7};
  scene.objects = {scene.objects[0], table};
  scene.check();
  const World world{.scene = scene, .plan = FloorPlan(scene), .robot = {}};
  REQUIRE(world.plan.is_free(6.2, 1.5, world.robot.radius));
  CHECK_FALSE(world.plan.open_above(6.2, 1.5, world.robot.radius));
  CHECK(world.plan.open_above(6.2, 2.2 + world.robot.radius, world.robot.radius));
  CHECK_FALSE(world.plan.open_above(6.2, 1.98 + world.robot.radius, world.robot.radius));
  std::vector<DriveStep> steps;
  for (int k = 0; k < 24; ++k) {
    DriveStep carry = step(Kind::carry);
    carry.seconds = 1;
    steps.push_back(carry);
    steps.push_back(stand(1));
  }
  const Drive drive = world.drive(script(steps));
  int west = 0, east = 0;
  std::array<int, 4> quadrants{};
  for (int k = 0; k < 24; ++k) {
    const SE3d T = drive.base.pose(2 * k + 1.5);
    const Vec3<double>& p = T.translation();
    CHECK(world.plan.clearance(p.x(), p.y()) >= world.robot.radius + world.robot.margin - 1e-6);
    CHECK(world.plan.open_above(p.x(), p.y(), world.robot.radius - 1e-6));
    ++(world.plan.room_at(p.x(), p.y()) == 0 ? west : east);
    ++quadrants[static_cast<std::size_t>(std::floor(yaw_of(T) / (90 * kRad)) + 2) % 4];
  }
  CHECK(west >= 5);
  CHECK(east >= 5);
  for (const int count : quadrants) CHECK(count >= 1);
  const Drive again = world.drive(script(steps));
  CHECK(again.base.pose(30).translation() == drive.base.pose(30).translation());
}

TEST_CASE("slip slows a robot, hanging stops it, a bump throws it back", "[drive]") {
  const World world;
  const DriveScript ahead = script({stand(1), to(Kind::drive, {{3.2, 1}})});
  const auto x = [](const Drive& drive, double t) { return drive.base.pose(t).translation().x(); };
  DriveDisturbance slip;
  slip.begin = 3, slip.end = 5, slip.grip = 0.1;
  const Drive slipping = world.drive(ahead, {slip});
  CHECK(x(slipping, 4.9) - x(slipping, 3.1) == Approx(0.1 * 0.3 * 1.8).epsilon(0.1));
  const WheelSimulationOptions wheels;
  const auto ticks = simulate_wheels(slipping.base, 0, wheels.ideal(), slipping.episodes, 1);
  CHECK((ticks[245].left - ticks[155].left) * wheels.nominal().metres_per_tick() ==
        Approx(0.3 * 1.8).epsilon(0.05));
  CHECK(x(slipping, slipping.base.duration()) == Approx(3.2).margin(1e-6));

  DriveDisturbance hang = slip;
  hang.kind = DriveDisturbance::Kind::free_spin;
  const Drive hanging = world.drive(ahead, {hang});
  CHECK(std::abs(x(hanging, 4.9) - x(hanging, 3.1)) < 1e-6);
  CHECK(has(hanging, "free_spin"));

  DriveDisturbance bump;
  bump.kind = DriveDisturbance::Kind::bump, bump.begin = 3;
  const Drive bumped = world.drive(ahead, {bump});
  CHECK(bumped.base.at(3.2).velocity.dot(bumped.base.at(2.9).velocity) < 0);
  double hardest = 0;
  for (double t = 3; t < 3.3; t += 0.001) hardest = std::max(hardest, bumped.base.at(t).acceleration.norm());
  CHECK(hardest > 3.0);
}

TEST_CASE("without steps a robot covers the flat and comes home", "[drive]") {
  const World world;
  DriveScript nothing;
  const Drive drive = world.drive(nothing);
  bool west = false, east = false;
  for (double t = 0; t < drive.base.duration(); t += 0.1) {
    const Vec3<double> p = drive.base.pose(t).translation();
    west = west || world.plan.room_at(p.x(), p.y()) == 0;
    east = east || world.plan.room_at(p.x(), p.y()) == 1;
  }
  CHECK(west);
  CHECK(east);
  const SE3d start = drive.base.pose(0), end = drive.base.pose(drive.base.duration());
  CHECK((start.translation() - end.translation()).norm() < 1e-6);
  const Drive again = world.drive(nothing);
  REQUIRE(again.base.duration() == drive.base.duration());
  CHECK(again.base.pose(20).translation() == drive.base.pose(20).translation());
  CHECK(world.drive(nothing, {}, 12.5).base.duration() == Approx(12.5));
}

TEST_CASE("ways through furniture and impossible starts are refused with their place", "[drive]") {
  const World world;
  const std::string through = message_of(world, script({to(Kind::drive, {{2, 1}, {2, 2.7}})}));
  CHECK(through.find("test") != std::string::npos);
  CHECK(through.find("cabinet") != std::string::npos);
  CHECK(through.find("[2.00,") != std::string::npos);
  CHECK(message_of(world, script({to(Kind::go, {{2, 2.2}})})).find("no way") != std::string::npos);
  CHECK(message_of(world, script({to(Kind::carry, {{20, 2.2}})})).find("put down") != std::string::npos);
  DriveScript inside = script({stand(1)});
  inside.start = Vec2<double>(2, 2.2);
  CHECK(message_of(world, inside).find("does not fit") != std::string::npos);
  DriveStep lanes = step(Kind::lanes);
  lanes.room = "cellar";
  CHECK(message_of(world, script({lanes})).find("cellar") != std::string::npos);
  DriveDisturbance wrong;
  wrong.begin = 3, wrong.end = 2;
  CHECK_THROWS_AS(world.drive(script({stand(1)}), {wrong}), Error);
}
