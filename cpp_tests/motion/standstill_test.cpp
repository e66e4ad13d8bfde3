// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/motion/standstill.hpp"

#include <catch2/catch.hpp>
#include <limits>

#include "motion/drive_simulation.hpp"

using namespace sweepkit;
using test::DriveSimulation;

namespace {

/// Shaking while it moves, in proportion to the speed [m/s^2 for a m/s].
DriveSimulation simulate(std::function<Eigen::Vector2d(double)> motion, double seconds, double shake,
                         std::uint64_t seed = 1) {
  DriveSimulation drive;
  drive.motion = motion;
  drive.run(seconds, seed);
  Random random(seed + 100);
  for (auto& s : drive.imu) {
    const Eigen::Vector2d u = motion(to_seconds(s.t));
    const double size = shake * (std::abs(u[0]) + 0.1 * std::abs(u[1]));
    for (int i = 0; i < 3; ++i) {
      s.accel[i] += random.normal(0, size);
      s.gyro[i] += random.normal(0, 0.03 * size);
    }
  }
  return drive;
}

struct Counts {
  int right = 0, falsely = 0, missed = 0;  // samples standing told rightly, wrongly, not at all
  double precision() const { return right / std::max(1.0, static_cast<double>(right + falsely)); }
  double recall() const { return right / std::max(1.0, static_cast<double>(right + missed)); }
};

Counts detect(const DriveSimulation& drive, bool imu, bool wheels, const StandstillOptions& options = {}) {
  StandstillDetector detector({drive.gyro_noise, 2e-5, drive.accel_noise, 3e-3}, 200, drive.geometry,
                              options);
  Counts counts;
  std::size_t k = 0;
  for (const auto& s : drive.imu) {
    while (wheels && k < drive.ticks.size() && drive.ticks[k].t <= s.t) detector.add(drive.ticks[k++]);
    if (imu) detector.add(s);
    // Neither while it begins or ends to move, slower than anything here can tell.
    const double speed = drive.motion(to_seconds(s.t)).norm();
    if (speed > 1e-4 && speed < 0.005) continue;
    const bool truly = speed < 0.005;
    counts.right += truly && detector.standing();
    counts.falsely += !truly && detector.standing();
    counts.missed += truly && !detector.standing();
  }
  return counts;
}

/// Stands for 2 s, then creeps at 2 cm/s to 12 s, then stands.
Eigen::Vector2d creep(double t) {
  const auto edge = [](double x) {
    x = std::min(1.0, std::max(0.0, x));
    return x * x * (3 - 2 * x);
  };
  return {0.02 * edge((t - 2) / 0.2) * (1 - edge((t - 12) / 0.2)), 0.0};
}

}  // namespace

TEST_CASE("stands are told from any of the sensors", "[motion][standstill]") {
  const DriveSimulation drive = simulate(test::cleaning_motion, 27, 0.6);
  for (const auto& [imu, wheels] : {std::pair(true, true), std::pair(false, true), std::pair(true, false)}) {
    const Counts counts = detect(drive, imu, wheels);
    CAPTURE(imu, wheels, counts.right, counts.falsely, counts.missed);
    // Each stand loses its first window.
    CHECK(counts.precision() > 0.9);
    CHECK(counts.recall() > 0.6);
  }
  CHECK(detect(drive, false, false).right == 0);
}

TEST_CASE("creeping at 2 cm/s is no standstill", "[motion][standstill]") {
  for (const double shake : {0.0, 0.3, 3.0})
    for (const auto& [imu, wheels] : {std::pair(true, true), std::pair(false, true), std::pair(true, false)})
      for (std::uint64_t seed = 1; seed <= 3; ++seed) {
        const DriveSimulation drive = simulate(creep, 15, shake, seed);
        StandstillDetector detector({drive.gyro_noise, 2e-5, drive.accel_noise, 3e-3}, 200, drive.geometry);
        int falsely = 0, right = 0;
        std::size_t k = 0;
        for (const auto& s : drive.imu) {
          while (wheels && k < drive.ticks.size() && drive.ticks[k].t <= s.t) detector.add(drive.ticks[k++]);
          if (imu) detector.add(s);
          const double t = to_seconds(s.t);
          // Once it has reached half of its speed and until it gives that up.
          falsely += t > 2.2 && t < 12.0 && detector.standing();
          right += (t < 2 || t > 13) && detector.standing();
        }
        CAPTURE(shake, imu, wheels, seed);
        CHECK(falsely == 0);
        CHECK(right > (wheels ? 600 : 250));
      }
}

TEST_CASE("being carried with wheels at rest is no standstill", "[motion][standstill]") {
  DriveSimulation drive = simulate([](double) { return Eigen::Vector2d(0, 0); }, 6, 0);
  for (auto& s : drive.imu) {
    const double t = to_seconds(s.t);
    if (t > 2 && t < 4) s.accel.z() += std::sin(8 * t), s.gyro.x() += 0.3 * std::sin(5 * t);
  }
  StandstillDetector detector({drive.gyro_noise, 2e-5, drive.accel_noise, 3e-3}, 200, drive.geometry);
  std::size_t k = 0;
  for (const auto& s : drive.imu) {
    while (k < drive.ticks.size() && drive.ticks[k].t <= s.t) detector.add(drive.ticks[k++]);
    detector.add(s);
    const double t = to_seconds(s.t);
    if (t > 2.1 && t < 4) CHECK_FALSE(detector.standing());
    if (t > 0.4 && t < 2) CHECK(detector.standing());
    if (t > 4.4) CHECK(detector.standing());
    if (t > 5) CHECK(to_seconds(detector.since()) == Approx(4.0).margin(0.1));
  }
}

TEST_CASE("a known bias tells slow turns", "[motion][standstill]") {
  // A turntable at 1 degree/s: quiet, and within what a bias may be.
  for (const bool known : {false, true}) {
    StandstillDetector detector({2e-4, 2e-5, 2e-3, 3e-3}, 200);
    if (known) detector.set_gyro_bias({0.002, 0, 0});
    Random random(1);
    for (int k = 0; k < 400; ++k) {
      ImuSample s{k * 5'000'000, {0.002, 0, 0.01745}, {0, 0, 9.81}};
      for (int i = 0; i < 3; ++i) {
        s.gyro[i] += random.normal(0, 2.8e-3);
        s.accel[i] += random.normal(0, 0.028);
      }
      detector.add(s);
    }
    CHECK(detector.standing() == !known);
  }
}

TEST_CASE("bad samples do not make or keep a standstill", "[motion][standstill]") {
  const DriveSimulation drive = simulate([](double) { return Eigen::Vector2d(0, 0); }, 6, 0);
  StandstillDetector detector({drive.gyro_noise, 2e-5, drive.accel_noise, 3e-3}, 200, drive.geometry);
  for (std::size_t k = 0; k < 400; ++k) CHECK(detector.add(drive.imu[k]));
  CHECK(detector.standing());
  ImuSample bad = drive.imu[400];
  bad.gyro.x() = std::numeric_limits<double>::quiet_NaN();
  CHECK_FALSE(detector.add(bad));
  CHECK_FALSE(detector.add(drive.imu[300]));
  CHECK_FALSE(detector.add(drive.imu[399]));
  CHECK(detector.standing());
  // After a second of silence the window has to fill again.
  CHECK(detector.add(drive.imu[600]));
  CHECK_FALSE(detector.standing());
  for (std::size_t k = 601; k < 700; ++k) detector.add(drive.imu[k]);
  CHECK(detector.standing());
  CHECK_FALSE(detector.add(WheelSample{0, WheelReading::ticks, std::numeric_limits<double>::infinity(), 0}));
  CHECK_THROWS_AS(StandstillDetector({}, 0), Error);
}
