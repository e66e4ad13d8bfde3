// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/direction/level_odometry.hpp"

#include <catch2/catch.hpp>
#include <limits>

#include "line_scene.hpp"

using namespace sweepkit;
using namespace sweepkit::test;

namespace {

/// A robot that rests for `rest` seconds, then turns at 0.5 rad/s, with an IMU mounted askew and biased.
struct Turning {
  SO3d R_body_base = SO3d::exp(Vec3<double>(0.3, -2.0, 0.9));
  Vec3<double> bias{0.004, -0.006, 0.008};
  double rest = 2;
  double tilt = 0;  ///< of the base from t = 4 s on [rad]

  MotionSensors sensors(bool imu, bool wheels) const {
    MotionSensors s;
    if (imu) s.imu = MountedImu{SE3d(), {2e-4, 1e-5, 2e-3, 3e-4}, 200};
    if (wheels) s.wheels = MountedWheels{SE3d(R_body_base, {0.01, 0.02, -0.05}), {1000, 0.035, 0.23}, 50};
    return s;
  }
  double yaw(double t) const { return 0.5 * std::max(0.0, t - rest); }
  SO3d R_world_base(double t) const {
    const double lean = tilt * std::clamp(t - 4, 0.0, 1.0);
    return SO3d::exp(Vec3<double>(0, 0, yaw(t))) * SO3d::exp(Vec3<double>(lean, 0, 0));
  }
  SO3d R_world_body(double t) const { return R_world_base(t) * R_body_base.inverse(); }

  void feed(LevelOdometry& odometry, double end, bool imu, bool wheels, Random& random) const {
    for (int k = 0; k < end * 200; ++k) {
      const double t = k / 200.0;
      const SO3d R = R_world_body(t);
      if (imu) {
        const Vec3<double> rate = (R.inverse() * R_world_body(t + 1e-4)).log() / 1e-4;
        const Vec3<double> noise(random.normal(), random.normal(), random.normal());
        odometry.add(ImuSample{from_seconds(t), rate + bias + 2e-4 * std::sqrt(200.0) * noise,
                               R.inverse() * Vec3<double>(0, 0, 9.81) + 0.02 * noise});
      }
      if (wheels && k % 4 == 0) {
        const double ticks = yaw(t) * 0.5 * 0.23 / (2 * std::numbers::pi * 0.035) * 1000;
        odometry.add(
            WheelSample{from_seconds(t), WheelReading::ticks, -std::round(ticks), std::round(ticks)});
      }
    }
  }
};

double tilt_between(const SO3d& a, const SO3d& b) {
  const Vec3<double> z = Vec3<double>::UnitZ();
  return std::acos(std::min(1.0, (a.inverse() * z).dot(b.inverse() * z))) / kDegree;
}

}  // namespace

TEST_CASE("yaw is the gyro's, up is the floor's, and a rest tells the drift") {
  Random random(1);
  for (const bool wheels : {true, false})
    for (const double rest : {2.0, 0.0}) {
      Turning robot;
      robot.rest = rest;
      LevelOdometry odometry(robot.sensors(true, wheels), SE3d(), {});
      robot.feed(odometry, 1.0, true, wheels, random);
      const SO3d first = odometry.orientation(from_seconds(1.0));
      robot.feed(odometry, 10.0, true, wheels, random);
      const SO3d last = odometry.orientation(from_seconds(10.0));
      INFO("wheels " << wheels << " rest " << rest);
      CHECK(tilt_between(last, robot.R_world_body(10)) < (wheels ? 0.4 : 1.2));
      // Body axis that is level: the base's x.
      const auto yaw = [&](const SO3d& R) {
        const Vec3<double> x = R * (robot.R_body_base * Vec3<double>::UnitX());
        return std::atan2(x.y(), x.x());
      };
      const double turned =
          std::remainder(yaw(last) - yaw(first) - (robot.yaw(10) - robot.yaw(1)), 2 * std::numbers::pi);
      const double drift = (robot.R_body_base * Vec3<double>::UnitZ()).dot(robot.bias);
      CHECK(std::abs(turned - 9 * drift) < 0.4 * kDegree);
      const YawDrift told = odometry.drift();
      if (rest > 0) {
        CHECK(std::abs(told.rate - drift) < 0.05 * kDegree);
        CHECK(told.sigma < 0.05 * kDegree);
      } else if (wheels) {
        CHECK(told.rate == 0);
        CHECK(told.sigma > 0.5 * kDegree);
      }
    }
}

TEST_CASE("without a gyro the wheels turn it, and with neither nothing does") {
  Random random(2);
  Turning robot;
  LevelOdometry odometry(robot.sensors(false, true), SE3d(), {});
  const SO3d first = odometry.orientation(0);
  robot.feed(odometry, 6.0, false, true, random);
  const SO3d turned = odometry.orientation(from_seconds(6.0)) * first.inverse();
  CHECK(std::abs(std::remainder(turned.log().z() - robot.yaw(6), 2 * std::numbers::pi)) < 1 * kDegree);
  CHECK(odometry.drift().sigma > 0);

  LevelOdometry blind({}, SE3d(SO3d::exp(Vec3<double>(-1.5, 0, 0)), Vec3<double>::Zero()));
  robot.feed(blind, 1.0, true, true, random);
  CHECK(blind.orientation(5).matrix() == blind.orientation(from_seconds(9)).matrix());
  CHECK((blind.orientation(5) * (SO3d::exp(Vec3<double>(-1.5, 0, 0)) * -Vec3<double>::UnitY()) -
         Vec3<double>::UnitZ())
            .norm() < 1e-9);
}

TEST_CASE("a robot that is lifted and tilted follows the accelerometer") {
  Random random(3);
  Turning robot;
  robot.tilt = 0.4;
  LevelOdometry odometry(robot.sensors(true, true), SE3d(), {});
  robot.feed(odometry, 15.0, true, true, random);
  CHECK(tilt_between(odometry.orientation(from_seconds(15)), robot.R_world_body(15)) < 3);
}

TEST_CASE("samples that are not finite or out of order change nothing") {
  Random random(4);
  Turning robot;
  LevelOdometry odometry(robot.sensors(true, true), SE3d(), {});
  robot.feed(odometry, 3.0, true, true, random);
  const Mat3<double> before = odometry.orientation(from_seconds(3)).matrix();
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  odometry.add(ImuSample{from_seconds(4), Vec3<double>(kNan, 0, 0), Vec3<double>(0, 0, 9.8)});
  odometry.add(ImuSample{from_seconds(1), Vec3<double>(1, 0, 0), Vec3<double>(0, 0, 9.8)});
  odometry.add(WheelSample{from_seconds(4), WheelReading::ticks, kNan, 0});
  CHECK(odometry.orientation(from_seconds(3)).matrix() == before);
  CHECK(odometry.orientation(from_seconds(1000)).matrix().allFinite());
}
