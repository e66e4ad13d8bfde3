// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/odometry_bridge.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <functional>
#include <numbers>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "motion/body_signals.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

using test::BodySignals;
using test::difference;
using test::kGravity;
using test::smooth;

using Sees = std::function<bool(double)>;

/// Feeds all in the order of stamps, with an image each 0.1 s from 0.5 s on, which sees the true pose where
/// told; `at_image` is called after each.
struct Run {
  std::vector<Event> events;
  double worst = 0;  // distance from truth at images [m]
  SE3d T_true, T_last;

  static bool finite(const OdometryBridge& bridge) {
    const NavigationState& s = bridge.filter().state();
    return s.T_world_body.matrix().allFinite() && s.covariance.allFinite() && s.velocity.allFinite() &&
           s.covariance.diagonal().minCoeff() > 0;
  }

  Run(
      OdometryBridge& bridge, const BodySignals& signals, double seconds,
      const Sees& sees = [](double) { return true; },
      const std::function<void(double)>& at_image = [](double) {}) {
    std::size_t i = 0, w = 0;
    SE3d T_world_true;
    for (int image = 5; image <= std::lround(seconds * 10); ++image) {
      const TimeNs t = from_seconds(0.1 * image);
      for (;;) {
        const bool has_imu = i < signals.imu.size() && signals.imu[i].t <= t;
        const bool has_wheels = w < signals.wheels.size() && signals.wheels[w].t <= t;
        if (!has_imu && !has_wheels) break;
        if (has_imu && (!has_wheels || signals.imu[i].t <= signals.wheels[w].t))
          bridge.add(signals.imu[i++]);
        else
          bridge.add(signals.wheels[w++]);
      }
      const SE3d T_body = signals.T_world_body(0.1 * image);
      if (!bridge.started()) T_world_true = bridge.start(t) * T_body.inverse();
      bridge.advance(t);
      T_true = T_world_true * T_body;
      worst = std::max(worst, difference(bridge.pose().T, T_true).head<3>().norm());
      REQUIRE(finite(bridge));
      if (sees(0.1 * image)) {
        // Vision with the prediction as prior.
        const Mat6<double> P = bridge.pose().covariance, R = 1e-6 * Mat6<double>::Identity();
        const Mat6<double> K = P * (P + R).inverse(), left = Mat6<double>::Identity() - K;
        const SE3d T = bridge.pose().T * SE3d::exp(K * difference(bridge.pose().T, T_true));
        bridge.correct(T, left * P * left.transpose() + K * R * K.transpose());
      }
      at_image(0.1 * image);
      for (Event& event : bridge.take_events()) events.push_back(std::move(event));
    }
    T_last = bridge.pose().T;
  }

  std::vector<double> times(const std::string& name) const {
    std::vector<double> found;
    for (const Event& event : events)
      if (event.name == name) found.push_back(to_seconds(event.t));
    return found;
  }
  bool has(const std::string& name) const { return !times(name).empty(); }
};

/// On an arc of 80 cm radius: stands, drives 1.2 m from 2 s to 8 s, stands.
SE3d arc(double s) {
  constexpr double r = 0.8;
  return SE3d(SO3d::exp({0, 0, s / r}), {r * std::sin(s / r), r * (1 - std::cos(s / r)), 0});
}
double arc_length(double t) { return 1.2 * smooth(t, 2, 8); }
SE3d plain_drive(double t) { return arc(arc_length(t)); }

/// The same, over a sill of 1.5 cm in its middle.
SE3d drive_with_sill(double t) {
  const double s = arc_length(t), x = (s - 0.6) / 0.12;
  if (std::abs(x) >= 1) return arc(s);
  const double q = 1 - x * x;
  const double height = 0.015 * q * q * q, slope = 0.015 * -6 * x * q * q / 0.12;
  return arc(s) * SE3d(SO3d::exp({0, -std::atan(slope), 0}), {0, 0, height});
}

}  // namespace

TEST_CASE("OdometryBridge has nothing to report of an ordinary drive but its stands", "[bridge]") {
  for (const bool sill : {false, true})
    for (const auto& [imu, wheels] :
         {std::pair{true, true}, std::pair{false, true}, std::pair{true, false}}) {
      CAPTURE(sill, imu, wheels);
      BodySignals signals;
      signals.T_world_base = sill ? drive_with_sill : plain_drive;
      signals.make(11);
      OdometryBridge bridge(signals.sensors(imu, wheels), {});
      bool stood = false, moved = false;
      const Run run(
          bridge, signals, 11, [](double) { return true; },
          [&](double t) {
            stood = stood || (t > 1 && t < 2 && bridge.standing());
            moved = moved || (t > 2.7 && t < 7.3 && bridge.standing());
          });
      CHECK(stood);
      CHECK_FALSE(moved);
      // Without wheels a smooth end of a smooth drive is told from none by what shakes, and nothing does
      // here.
      if (wheels) CHECK(bridge.standing());
      for (const char* name : {"slip", "free_spin", "lifted", "put_down", "sensor_gap"}) {
        CAPTURE(name);
        CHECK_FALSE(run.has(name));
      }
      // One at the start, one at the end. Creeping in and out may make more.
      REQUIRE(run.has("standstill"));
      CHECK(run.times("standstill").front() < 1.2);
      if (wheels) CHECK(run.times("standstill").back() > 7.3);
      CHECK(run.worst < 0.03);
    }
}

TEST_CASE("OdometryBridge carries the pose through darkness", "[bridge]") {
  BodySignals signals;
  signals.T_world_base = drive_with_sill;
  signals.make(11);
  OdometryBridge bridge(signals.sensors(), {});
  const Run run(bridge, signals, 11, [](double t) { return t < 3; });
  // 1 % of the way and 1 cm.
  CHECK(run.worst < 0.022);
  const Vec6<double> e = difference(run.T_last, run.T_true);
  CHECK(e.dot(bridge.pose().covariance.ldlt().solve(e)) < 25);
}

TEST_CASE("OdometryBridge tells slip and does not believe it", "[bridge]") {
  for (const bool imu : {true, false}) {
    CAPTURE(imu);
    BodySignals signals;
    signals.T_world_base = plain_drive;
    signals.slide = [](double t) {
      return t > 4 && t < 5.5 ? Eigen::Vector2d(0.2, 0.2) : Eigen::Vector2d(0, 0);
    };
    signals.make(9);
    OdometryBridge bridge(signals.sensors(imu, true), {});
    bool slipped = false, after = false;
    const Run run(
        bridge, signals, 9, [&](double t) { return !imu || t < 4 || t > 5.5; },
        [&](double t) {
          slipped = slipped || (t > 4.5 && t < 5.4 && bridge.slipping());
          after = after || (t > 6.5 && bridge.slipping());
        });
    CHECK(slipped);
    CHECK_FALSE(after);
    REQUIRE(run.times("slip").size() >= 1);
    CHECK(run.times("slip").front() > 4);
    CHECK(run.times("slip").front() < (imu ? 4.2 : 4.8));
    CHECK(run.times("slip").back() < 6);
    CHECK_FALSE(run.has("lifted"));
    CHECK_FALSE(run.has("free_spin"));
    // The wheels rolled 30 cm too far.
    CHECK(run.worst < 0.05);
  }
}

TEST_CASE("OdometryBridge notices that it is lifted and put down, and wheels that spin meanwhile",
          "[bridge]") {
  for (const bool spins : {false, true}) {
    CAPTURE(spins);
    BodySignals signals;
    // Drives, is lifted by 30 cm while it stands, tilted and turned, put down elsewhere; stands.
    signals.T_world_base = [](double t) {
      const double up = smooth(t, 9, 10) - smooth(t, 12, 13);
      const double carried = smooth(t, 10, 12);
      return arc(arc_length(t)) *
             SE3d(SO3d::exp({0.15 * up, 0.1 * up, 0.8 * carried}), {0.3 * carried, 0.2 * carried, 0.3 * up});
    };
    signals.in_air = [](double t) { return t > 9 && t < 13; };
    if (spins)
      signals.slide = [](double t) {
        return t > 10.5 && t < 11.5 ? Eigen::Vector2d(0.4, 0.4) : Eigen::Vector2d(0, 0);
      };
    signals.make(16);
    OdometryBridge bridge(signals.sensors(), {});
    const Run run(bridge, signals, 16);
    REQUIRE(run.times("lifted").size() == 1);
    CHECK(run.times("lifted").front() > 9);
    CHECK(run.times("lifted").front() < 9.8);
    REQUIRE(run.times("put_down").size() == 1);
    CHECK(run.times("put_down").front() > 12.5);
    CHECK(run.times("put_down").front() < 14.5);
    CHECK_FALSE(bridge.lifted());
    CHECK(run.has("free_spin") == spins);
    CHECK_FALSE(run.has("slip"));
    CHECK(run.worst < 0.05);
  }
}

TEST_CASE("OdometryBridge tells silence of a sensor and goes on", "[bridge]") {
  for (const bool of_imu : {true, false}) {
    CAPTURE(of_imu);
    BodySignals signals;
    signals.T_world_base = plain_drive;
    signals.make(9);
    const auto silent = [](const auto& s) { return to_seconds(s.t) > 4 && to_seconds(s.t) < 5; };
    if (of_imu)
      std::erase_if(signals.imu, silent);
    else
      std::erase_if(signals.wheels, silent);
    OdometryBridge bridge(signals.sensors(), {});
    const Run run(bridge, signals, 9);
    REQUIRE(run.times("sensor_gap").size() == 1);
    CHECK(run.times("sensor_gap").front() == Approx(5).margin(0.03));
    CHECK_FALSE(run.has("lifted"));
    CHECK(run.worst < 0.05);
    CHECK(difference(run.T_last, run.T_true).norm() < 0.005);
  }
}

TEST_CASE("OdometryBridge::take_motion is the true motion where nothing disturbs it", "[bridge]") {
  for (const auto& [imu, wheels, metres] : {std::tuple{true, true, 1e-4}, std::tuple{false, true, 1e-4}}) {
    CAPTURE(imu, wheels);
    BodySignals signals;
    signals.noise = 0;
    signals.T_world_base = plain_drive;
    signals.make(9);
    OdometryBridge bridge(signals.sensors(imu, wheels), {});
    std::optional<double> taken;
    double worst = 0, least = 1;
    // At intervals from an image to several seconds.
    int n = 0;
    const Run run(
        bridge, signals, 9, [](double) { return true; },
        [&](double t) {
          if (!taken) {
            bridge.take_motion();
            taken = t;
          }
          if (++n % 7 != 0 && n < 30) return;
          if (n >= 30 && n != 60 && n != 61) return;
          const UncertainMotion<double> motion = bridge.take_motion();
          const SE3d T = signals.T_world_body(*taken).inverse() * signals.T_world_body(t);
          worst = std::max(worst, difference(motion.T, T).norm());
          const Eigen::SelfAdjointEigenSolver<Mat6<double>> eigen(motion.covariance);
          least = std::min(least, eigen.eigenvalues().minCoeff());
          taken = t;
        });
    CHECK(worst < 20 * metres);
    CHECK(least > 0);
  }
}

TEST_CASE("OdometryBridge stands for an hour", "[bridge]") {
  BodySignals signals;
  signals.T_world_base = [](double) { return SE3d(); };
  signals.make(3600);
  OdometryBridge bridge(signals.sensors(), {});
  const Run run(bridge, signals, 3600, [](double t) { return t < 1; });
  CHECK(bridge.standing());
  CHECK(run.times("standstill").size() == 1);
  CHECK(run.worst < 0.02);
  CHECK(difference(run.T_last, run.T_true).tail<3>().norm() < 0.05);
  const UncertainMotion<double> motion = bridge.take_motion();
  CHECK(motion.T.translation().norm() < 0.01);
  CHECK(motion.T.rotation().angle() < 0.1);
  CHECK(motion.covariance.allFinite());
  // Taken: nothing is left of the hour.
  const UncertainMotion<double> rest = bridge.take_motion();
  CHECK(rest.T.log().norm() < 1e-12);
  CHECK(rest.covariance.trace() < 1e-8);
}

TEST_CASE("OdometryBridge starts with z up and yaw zero, however the body is mounted", "[bridge]") {
  Random random(4);
  for (int draw = 0; draw < 200; ++draw) {
    SO3d R_world_body = SO3d::exp({random.normal(0, 1.5), random.normal(0, 1.5), random.normal(0, 1.5)});
    if (draw == 0) R_world_body = SO3d();
    if (draw == 1) R_world_body = SO3d::exp({std::numbers::pi, 0, 0});       // upside down
    if (draw == 2) R_world_body = SO3d::exp({0, -std::numbers::pi / 2, 0});  // x upright
    if (draw == 3) R_world_body = SO3d::exp({0, std::numbers::pi / 2, 0});   // x down
    const Vec3<double> up = R_world_body.inverse() * Vec3<double>::UnitZ();
    MotionSensors sensors;
    sensors.imu = MountedImu{};
    OdometryBridge bridge(sensors, {});
    CHECK_FALSE(bridge.started());
    for (int k = 0; k < 20; ++k) bridge.add(ImuSample{k * 5'000'000, Vec3<double>::Zero(), kGravity * up});
    const SE3d T = bridge.start(100'000'000);
    CHECK(bridge.started());
    CHECK(T.translation().norm() == 0);
    CHECK((T.rotation() * up - Vec3<double>::UnitZ()).norm() < 1e-9);
    CHECK((bridge.filter().state().up - Vec3<double>::UnitZ()).norm() < 1e-9);
    const Vec3<double> x = T.rotation() * Vec3<double>::UnitX(), y = T.rotation() * Vec3<double>::UnitY();
    const Vec3<double>& ahead = std::abs(up.x()) < 0.98 ? x : y;
    CHECK(std::abs(ahead.y()) < 1e-9);
    CHECK(ahead.x() > 0);
    CHECK(T.rotation().matrix().determinant() == Approx(1));
  }
  // Nothing tells the vertical: the body's own axes.
  BodySignals signals;
  OdometryBridge bridge(signals.sensors(false, true), {});
  CHECK(bridge.start(0).matrix() == SE3d().matrix());
}

TEST_CASE("OdometryBridge bears clocks that differ by 50 ms", "[bridge]") {
  for (const double shift : {-0.05, 0.05})
    for (const double seen_until : {20.0, 4.0}) {
      CAPTURE(shift, seen_until);
      BodySignals signals;
      signals.T_world_base = plain_drive;
      signals.wheel_shift = from_seconds(shift);
      signals.make(10);
      OdometryBridge bridge(signals.sensors(), {});
      const Run run(bridge, signals, 10, [&](double t) { return t < seen_until; });
      CHECK(run.worst < 0.06);
      CHECK_FALSE(run.has("lifted"));
      CHECK_FALSE(run.has("sensor_gap"));
    }
}

TEST_CASE("OdometryBridge bears saturation, resets and nonsense", "[bridge]") {
  BodySignals signals;
  signals.T_world_base = plain_drive;
  signals.make(10);
  for (ImuSample& s : signals.imu) {
    const double t = to_seconds(s.t);
    if (t > 4 && t < 4.02) s.gyro = Vec3<double>(1e6, -1e6, 1e6);
    if (t > 5 && t < 5.02) s.accel = Vec3<double>(-1e9, 1e9, 1e9);
  }
  for (WheelSample& s : signals.wheels) {
    const double t = to_seconds(s.t);
    if (t > 6) s.left -= 1000, s.right -= 1200;
    if (t > 6.5) s.left -= 0x1p16;
    if (t > 7 && t < 7.05) s.right = 1e18;
  }
  OdometryBridge bridge(signals.sensors(), {});
  // Seen again, it is where it is; meanwhile it is finite, which Run checks.
  const Run run(bridge, signals, 10);
  CHECK(difference(run.T_last, run.T_true).norm() < 0.01);
  CHECK(run.T_last.matrix().allFinite());
}

TEST_CASE("OdometryBridge follows the map", "[bridge]") {
  BodySignals signals;
  signals.T_world_base = plain_drive;
  signals.make(6);
  OdometryBridge bridge(signals.sensors(), {});
  Run run(bridge, signals, 6);
  const Vec6<double> twist = bridge.filter().body_twist();
  // A loop: all turns with the map.
  const SE3d T_far(SO3d::exp({0, 0, 2}), {5, 3, 1});
  const SE3d T_before = bridge.pose().T;
  bridge.follow_map(T_far);
  CHECK(difference(bridge.pose().T, T_far * T_before).norm() < 1e-9);
  CHECK((bridge.filter().body_twist() - twist).norm() < 1e-9);
  // A small adjustment: the pose goes there just the same.
  const SE3d T_near(SO3d::exp({0, 0, 1e-4}), {0.001, 0.002, 0});
  const SE3d T_then = bridge.pose().T;
  bridge.follow_map(T_near);
  CHECK(difference(bridge.pose().T, T_near * T_then).norm() < 1e-9);
  CHECK(Run::finite(bridge));
}
