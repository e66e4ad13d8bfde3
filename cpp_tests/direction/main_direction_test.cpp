// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/direction/main_direction.hpp"

#include <catch2/catch.hpp>

#include "line_scene.hpp"
#include "sweepkit/core/error.hpp"

using namespace sweepkit;
using namespace sweepkit::test;

namespace {

FrameDirection frame_at(TimeNs t, double yaw, double angle, double right_offset = 0) {
  FrameDirection f;
  f.t = t;
  f.yaw = yaw;
  f.left = {true, wrap_quarter_turn(angle), 0.003, 0.99, 20};
  f.right = {true, wrap_quarter_turn(angle + right_offset), 0.003, 0.99, 20};
  return f;
}

StereoRig rig() {
  const SE3d T_left(SO3d(), {0.1, 0, 0.05});
  return StereoRig(bent_camera(), plain_camera(), T_left,
                   T_left * SE3d(SO3d::exp(Vec3<double>(0.01, -0.005, 0.004)), {0.06, 0, 0}));
}

}  // namespace

TEST_CASE("angles modulo a quarter turn lie in (-45, 45] degrees") {
  CHECK(wrap_quarter_turn(45 * kDegree) == Approx(45 * kDegree));
  CHECK(wrap_quarter_turn(-45 * kDegree) == Approx(45 * kDegree));
  CHECK(wrap_quarter_turn(46 * kDegree) == Approx(-44 * kDegree));
  CHECK(wrap_quarter_turn(-200 * kDegree) == Approx(-20 * kDegree));
  Random random(1);
  for (int k = 0; k < 1000; ++k) {
    const double a = random.uniform(-20, 20), w = wrap_quarter_turn(a);
    CHECK(w > -45.000001 * kDegree);
    CHECK(w <= 45.000001 * kDegree);
    CHECK(std::abs(std::sin(2 * (a - w))) < 1e-9);
  }
}

TEST_CASE("a window carries every direction to its first frame, and that to the run's first") {
  MainDirectionOptions options;
  options.window = 20;
  for (const double room : {0.3, 45 * kDegree, -0.78}) {
    MainDirectionWindow window(options);
    // The first window sees nothing, the second answers. The robot turns on and on.
    Random random(3);
    std::optional<MainDirection> answer;
    for (int k = 0; k < 40; ++k) {
      const double yaw = 2.0 + 0.07 * k;
      FrameDirection f = frame_at(1000 + k, yaw, room - yaw + random.normal(0, 0.2) * kDegree);
      if (k < 20) f.right.found = false;
      REQUIRE_FALSE(answer);
      answer = window.add(f);
    }
    REQUIRE(answer);
    CHECK(window.restarts() == 1);
    CHECK(answer->window_begin == 1020);
    CHECK(answer->window_end == 1039);
    CHECK(answer->run_begin == 1000);
    CHECK(answer->confidence == 1);
    CHECK(std::abs(wrap_quarter_turn(answer->angle - (room - 2.0 - 0.07 * 20))) < 0.15 * kDegree);
    CHECK(std::abs(wrap_quarter_turn(answer->run_angle - (room - 2.0))) < 0.15 * kDegree);
    CHECK(answer->sigma < 0.2 * kDegree);
  }
}

TEST_CASE("a confidence of exactly the threshold is accepted, less begins anew") {
  MainDirectionOptions options;
  options.window = 10;
  for (const int inliers : {4, 5, 6}) {
    MainDirectionWindow window(options);
    std::optional<MainDirection> answer;
    for (int k = 0; k < 10; ++k) answer = window.add(frame_at(k, 0, k < inliers ? 0.1 : 0.2 + 0.1 * k));
    CHECK(answer.has_value() == (inliers >= 5));
    CHECK(window.restarts() == (inliers >= 5 ? 0 : 1));
    CHECK(window.last_confidence() == inliers / 10.0);
    if (answer) CHECK(answer->inliers == inliers);
  }
}

TEST_CASE("a yaw that drifts at a steady rate does no harm, known or not") {
  MainDirectionOptions options;
  Random random(5);
  for (const double rate : {0.0, 0.4, -4.0})
    for (const double sigma : {0.0, 3.0}) {
      MainDirectionWindow window(options);
      std::optional<MainDirection> answer;
      for (int k = 0; k < 100; ++k) {
        const double seconds = 0.1 * k, yaw = 1 + 0.2 * seconds;
        FrameDirection f = frame_at(from_seconds(seconds), yaw + rate * kDegree * seconds,
                                    0.3 - yaw + random.normal(0, 0.2) * kDegree);
        f.drift = {sigma == 0 ? rate * kDegree : 0, sigma * kDegree};
        if (k < 50 || k % 4 == 0) f.left.angle = f.right.angle = random.uniform(-0.7, 0.7);
        answer = window.add(f);
      }
      INFO("rate " << rate << " sigma " << sigma);
      REQUIRE(answer);
      CHECK(answer->confidence > 0.7);
      CHECK(std::abs(answer->drift / kDegree - rate) < 0.08);
      CHECK(std::abs(wrap_quarter_turn(answer->angle - (0.3 - 2.0))) < 0.2 * kDegree);
      CHECK(std::abs(wrap_quarter_turn(answer->run_angle - (0.3 - 1.0))) < 0.5 * kDegree);
    }
}

TEST_CASE("directions at the end of a window do not fix its begin while the drift is unknown") {
  for (const double sigma : {0.0, 1.0}) {
    MainDirectionWindow window;
    std::optional<MainDirection> answer;
    for (int k = 0; k < 50; ++k) {
      FrameDirection f = frame_at(from_seconds(0.1 * k), 0, 0.3);
      f.drift.sigma = sigma * kDegree;
      f.left.found = k >= 32;
      answer = window.add(f);
    }
    CHECK(answer.has_value() == (sigma == 0));
  }
}

TEST_CASE("frames whose cameras disagree or doubt are not collected") {
  MainDirectionOptions options;
  const FrameDirection good = frame_at(0, 0, 44.5 * kDegree, 1 * kDegree);
  REQUIRE(agreed_direction(good, options));
  CHECK(std::abs(wrap_quarter_turn(*agreed_direction(good, options) - 45 * kDegree)) < 1e-9);
  CHECK_FALSE(agreed_direction(frame_at(0, 0, 0, 3 * kDegree), options));
  FrameDirection doubtful = good;
  doubtful.left.confidence = 0.3;
  CHECK_FALSE(agreed_direction(doubtful, options));
  FrameDirection half = good;
  half.right.found = false;
  CHECK_FALSE(agreed_direction(half, options));

  // Few frames with a direction are not enough, however well they agree.
  options.window = 50;
  MainDirectionWindow window(options);
  for (int k = 0; k < 50; ++k) CHECK_FALSE(window.add(k % 10 == 0 ? frame_at(k, 0, 0.1) : half));
  CHECK(window.restarts() == 1);
  CHECK(window.last_confidence() == 0);
  options.window = 0;
  CHECK_THROWS_AS(MainDirectionWindow(options), Error);
}

TEST_CASE("two cameras on a turning robot find the room's direction") {
  const StereoRig r = rig();
  MainDirectionOptions options;
  options.window = 12;
  // The body's z axis is the camera's: the world has z up, so the camera's y axis points down.
  const SO3d R_level(Mat3<double>((Mat3<double>() << 0, 0, 1, -1, 0, 0, 0, -1, 0).finished()));
  for (const double room : {0.0, 20 * kDegree, 44 * kDegree}) {
    MainDirectionEstimator estimator(r, options);
    std::optional<MainDirection> answer;
    for (int k = 0; k < 12; ++k) {
      const double yaw = 1 + 0.05 * k;
      const SO3d R_world_body =
          SO3d::exp(Vec3<double>(0, 0, yaw)) * R_level * SO3d::exp(Vec3<double>(-0.03, 0, 0));
      std::vector<LineSegment> segments[2];
      for (const Side side : {Side::left, Side::right}) {
        const SO3d R_camera_world = (R_world_body * r.T_body_raw(side).rotation()).inverse();
        const SO3d R_camera_room = R_camera_world * SO3d::exp(Vec3<double>(0, 0, room));
        segments[static_cast<int>(side)] =
            line_scene(100 * k + static_cast<int>(side), r.camera(side), R_camera_room, {25, 25, 25}, 50)
                .segments;
      }
      answer = estimator.add(k, segments[0], segments[1], R_world_body);
      CHECK(estimator.finder().labels(Side::left).size() == segments[0].size());
    }
    REQUIRE(answer);
    CHECK(answer->confidence > 0.8);
    const Vec3<double> forward = SO3d::exp(Vec3<double>(0, 0, 1)) * R_level * Vec3<double>::UnitZ();
    CHECK(std::abs(wrap_quarter_turn(answer->angle - (room - std::atan2(forward.y(), forward.x())))) <
          0.4 * kDegree);
  }
}

TEST_CASE("no segments, a camera that looks up, and lines that run anywhere give no answer") {
  const StereoRig r = rig();
  MainDirectionOptions options;
  options.window = 10;
  MainDirectionEstimator estimator(r, options);
  const SO3d R_level(Mat3<double>((Mat3<double>() << 0, 0, 1, -1, 0, 0, 0, -1, 0).finished()));
  Random random(1);
  for (int k = 0; k < 30; ++k) {
    std::vector<LineSegment> left, right;
    SO3d R = R_level;
    if (k >= 10) {
      left = line_scene(k, r.camera(Side::left), SO3d(), {0, 0, 0}, 60).segments;
      right = line_scene(1000 + k, r.camera(Side::right), SO3d(), {0, 0, 0}, 60).segments;
    }
    if (k >= 20) R = SO3d();  // z of the camera along z of the world
    CHECK_FALSE(estimator.add(k, left, right, R));
    CHECK(std::isfinite(estimator.last().yaw));
    if (k < 10 || k >= 20) CHECK_FALSE(estimator.last().left.found);
  }
  CHECK(estimator.window().restarts() == 3);
}

TEST_CASE("replaying cached frames gives what feeding them gave") {
  MainDirectionOptions options;
  options.window = 10;
  std::vector<FrameDirection> frames;
  Random random(2);
  for (int k = 0; k < 100; ++k)
    frames.push_back(frame_at(k, 0.02 * k, k < 35 ? random.uniform(-3, 3) : 0.4 - 0.02 * k));
  const auto answer = first_main_direction(frames, options);
  REQUIRE(answer);
  CHECK(answer->window_begin == 30);
  const auto later = first_main_direction(std::span(frames).subspan(42), options);
  REQUIRE(later);
  CHECK(later->run_begin == 42);
  CHECK(std::abs(wrap_quarter_turn(later->angle - (0.4 - 0.02 * 42))) < 1e-9);
  CHECK_FALSE(first_main_direction({}, options));
}
