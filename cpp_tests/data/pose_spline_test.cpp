// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/pose_spline.hpp"

#include <catch2/catch.hpp>

#include "data/moving_body.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;
using Vector = Vec3<double>;

namespace {

double distance(const SE3d& a, const SE3d& b) {
  return (a.translation() - b.translation()).norm() + (a.rotation().inverse() * b.rotation()).angle();
}

}  // namespace

TEST_CASE("derivatives of a motion are those of its poses", "[pose_spline]") {
  const PoseSpline motion = test::tumble(6.0);
  constexpr double kH = 1e-5;
  Random random(3);
  for (int i = 0; i < 200; ++i) {
    const double t = random.uniform(0.1, 5.9);
    const MotionState s = motion.at(t), before = motion.at(t - kH), after = motion.at(t + kH);
    const Vector v = (after.T_world_body.translation() - before.T_world_body.translation()) / (2 * kH);
    const Vector w =
        (before.T_world_body.rotation().inverse() * after.T_world_body.rotation()).log() / (2 * kH);
    CHECK((v - s.velocity).norm() < 1e-8);
    CHECK((w - s.angular_rate).norm() < 1e-8);
    CHECK(((after.velocity - before.velocity) / (2 * kH) - s.acceleration).norm() < 1e-6);
    CHECK(((after.angular_rate - before.angular_rate) / (2 * kH) - s.angular_acceleration).norm() < 1e-6);
  }
}

TEST_CASE("accelerations do not jump at knots", "[pose_spline]") {
  const PoseSpline motion = test::tumble(3.0);
  for (int i = 5; i < 145; ++i) {
    const MotionState before = motion.at(0.02 * i - 1e-9), after = motion.at(0.02 * i + 1e-9);
    CHECK((before.acceleration - after.acceleration).norm() < 1e-6);
    CHECK((before.angular_acceleration - after.angular_acceleration).norm() < 1e-6);
  }
}

TEST_CASE("a sensor on a body moves as its pose says", "[pose_spline]") {
  const PoseSpline motion = test::tumble(4.0);
  const SE3d T_body_sensor(SO3d::exp({0.3, -1.0, 0.4}), {0.2, -0.1, 0.3});
  constexpr double kH = 1e-5;
  for (const double t : {0.5, 1.7, 3.1}) {
    const MotionState s = motion.at(t).of(T_body_sensor);
    const MotionState a = motion.at(t - kH).of(T_body_sensor), b = motion.at(t + kH).of(T_body_sensor);
    CHECK(distance(s.T_world_body, motion.pose(t) * T_body_sensor) < 1e-12);
    CHECK(((b.T_world_body.translation() - a.T_world_body.translation()) / (2 * kH) - s.velocity).norm() <
          1e-8);
    CHECK(((b.velocity - a.velocity) / (2 * kH) - s.acceleration).norm() < 1e-6);
    const Vector w = (a.T_world_body.rotation().inverse() * b.T_world_body.rotation()).log() / (2 * kH);
    CHECK((w - s.angular_rate).norm() < 1e-8);
    CHECK(((b.angular_rate - a.angular_rate) / (2 * kH) - s.angular_acceleration).norm() < 1e-6);
  }
}

TEST_CASE("equal poses are rest", "[pose_spline]") {
  const SE3d pose(SO3d::exp({0.1, 0.2, 0.3}), {1, 2, 3});
  const PoseSpline motion(std::vector<SE3d>(8, pose), 0.1);
  CHECK(motion.duration() == Approx(0.7));
  for (const double t : {-1.0, 0.0, 0.33, 0.7, 9.0}) {
    const MotionState s = motion.at(t);
    CHECK(distance(s.T_world_body, pose) < 1e-14);
    CHECK(s.velocity.norm() < 1e-12);
    CHECK(s.acceleration.norm() < 1e-10);
    CHECK(s.angular_rate.norm() < 1e-12);
  }
}

TEST_CASE("a spline goes through given poses", "[pose_spline]") {
  const PoseSpline truth = test::tumble(5.0);
  SECTION("stamps evenly apart") {
    Trajectory poses;
    for (int i = 0; i <= 100; ++i) poses.push_back({5'000'000'000 + i * 50'000'000LL, truth.pose(0.05 * i)});
    const PoseSpline motion = PoseSpline::through(poses);
    CHECK(motion.duration() == Approx(5.0));
    for (int i = 0; i <= 100; ++i) CHECK(distance(motion.pose(0.05 * i), truth.pose(0.05 * i)) < 1e-6);
    for (double t = 0.5; t < 4.5; t += 0.013) {
      CHECK(distance(motion.pose(t), truth.pose(t)) < 1e-5);
      CHECK((motion.at(t).acceleration - truth.at(t).acceleration).norm() < 0.02);
      CHECK((motion.at(t).angular_rate - truth.at(t).angular_rate).norm() < 1e-3);
    }
  }
  SECTION("stamps rounded to microseconds, a gap among them") {
    Trajectory poses;
    for (int i = 0; i <= 200; ++i)
      if (i < 90 || i > 92) poses.push_back({i * 25'000'000LL + (i % 3) * 1000, truth.pose(0.025 * i)});
    const PoseSpline motion = PoseSpline::through(poses);
    for (double t = 0.5; t < 2.0; t += 0.013) CHECK(distance(motion.pose(t), truth.pose(t)) < 1e-4);
    for (double t = 2.2; t < 2.4; t += 0.013) CHECK(distance(motion.pose(t), truth.pose(t)) < 0.05);
  }
}

TEST_CASE("motions from nothing or against time are refused", "[pose_spline]") {
  CHECK_THROWS_AS(PoseSpline({}, 0.1), Error);
  CHECK_THROWS_AS(PoseSpline({SE3d()}, 0.0), Error);
  CHECK_THROWS_AS(PoseSpline::through(Trajectory(3)), Error);
  CHECK_THROWS_AS(PoseSpline::through(Trajectory(5)), Error);
}
