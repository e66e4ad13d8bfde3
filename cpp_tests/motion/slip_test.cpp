// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/motion/slip.hpp"

#include <catch2/catch.hpp>
#include <limits>

#include "motion/drive_simulation.hpp"

using namespace sweepkit;
using test::DriveSimulation;

namespace {

SlipDetector watch(const DriveSimulation& drive, bool gyro, bool vision, double vision_until = 1e9) {
  SlipDetector detector(drive.geometry, drive.T_body_base);
  detector.set_gyro_bias(drive.gyro_bias);
  Random random(3);
  std::size_t k = 0;
  for (std::size_t i = 0; i < drive.imu.size(); ++i) {
    while (k < drive.ticks.size() && drive.ticks[k].t <= drive.imu[i].t) detector.add(drive.ticks[k++]);
    if (gyro) detector.add(drive.imu[i]);
    if (!vision || i % 40 != 0 || i == 0 || to_seconds(drive.imu[i].t) > vision_until) continue;
    Vec6<double> e;
    for (int a = 0; a < 6; ++a) e[a] = random.normal(0, 0.001);
    UncertainMotion<double> motion{drive.relative(i - 40, i) * SE3d::exp(e), 1e-6 * Mat6<double>::Identity()};
    detector.add_motion(drive.imu[i - 40].t, drive.imu[i].t, motion);
  }
  return detector;
}

DriveSimulation simulate(std::function<Eigen::Vector2d(double)> slip) {
  DriveSimulation drive;
  drive.motion = test::cleaning_motion;
  drive.wheel_noise = 0.001;
  drive.slip = slip;
  drive.run(27);
  return drive;
}

}  // namespace

TEST_CASE("a drive without slip has no episode", "[motion][slip]") {
  const DriveSimulation drive = simulate([](double) { return Eigen::Vector2d(0, 0); });
  for (const auto& [gyro, vision] : {std::pair(true, true), std::pair(true, false), std::pair(false, true)}) {
    const SlipDetector detector = watch(drive, gyro, vision);
    CHECK(detector.episodes().empty());
    CHECK_FALSE(detector.slipping());
  }
}

TEST_CASE("one wheel that slips is seen by the gyro", "[motion][slip]") {
  const DriveSimulation drive =
      simulate([](double t) { return t > 4 && t < 5.5 ? Eigen::Vector2d(0.1, 0) : Eigen::Vector2d(0, 0); });
  for (const bool vision : {true, false}) {
    const SlipDetector detector = watch(drive, true, vision);
    REQUIRE(detector.episodes().size() == 1);
    const SlipEpisode& e = detector.episodes()[0];
    CHECK(to_seconds(e.begin) == Approx(4.0).margin(0.25));
    CHECK(to_seconds(e.end) == Approx(5.5).margin(0.25));
    CHECK(e.kind == SlipEpisode::Kind::slip);
    CHECK(e.worst > 25);
  }
}

TEST_CASE("both wheels alike are seen by vision alone; spinning on the spot is free spin", "[motion][slip]") {
  const auto spin = [](double t) {
    return t > 26.1 - 2 && t < 26.1 ? Eigen::Vector2d(0.35, 0.35) : Eigen::Vector2d(0, 0);
  };
  const DriveSimulation drive = simulate(spin);
  CHECK(watch(drive, true, false).episodes().empty());
  const SlipDetector detector = watch(drive, true, true);
  REQUIRE(detector.episodes().size() == 1);
  const SlipEpisode& e = detector.episodes()[0];
  CHECK(to_seconds(e.begin) == Approx(24.1).margin(0.25));
  CHECK(to_seconds(e.end) == Approx(26.1).margin(0.25));
  CHECK(e.rolled > 0.3);
}

TEST_CASE("an episode that vision opened ends when vision is gone and the wheels rest", "[motion][slip]") {
  const auto spin = [](double t) {
    return t > 8.4 && t < 8.9 ? Eigen::Vector2d(0.3, 0.3) : Eigen::Vector2d(0, 0);
  };
  const DriveSimulation drive = simulate(spin);
  const SlipDetector detector = watch(drive, true, true, 8.85);
  REQUIRE(detector.episodes().size() == 1);
  CHECK(detector.episodes()[0].kind == SlipEpisode::Kind::free_spin);
  CHECK_FALSE(detector.slipping());
}

TEST_CASE("bad input makes no slip", "[motion][slip]") {
  DriveSimulation drive = simulate([](double) { return Eigen::Vector2d(0, 0); });
  // Counters set to zero, a second without gyro, a sample that is not a number, steps back in time.
  for (auto& s : drive.ticks)
    if (s.t > 5 * kNsPerSecond) s.left -= 5000, s.right -= 7000;
  std::erase_if(drive.imu,
                [](const ImuSample& s) { return s.t > 6 * kNsPerSecond && s.t < 7 * kNsPerSecond; });
  drive.imu[500].gyro.x() = std::numeric_limits<double>::quiet_NaN();
  SlipDetector detector(drive.geometry, drive.T_body_base);
  detector.set_gyro_bias(drive.gyro_bias);
  std::size_t k = 0;
  for (const auto& s : drive.imu) {
    while (k < drive.ticks.size() && drive.ticks[k].t <= s.t) detector.add(drive.ticks[k++]);
    detector.add(s);
  }
  CHECK_FALSE(detector.add(drive.ticks[5]));
  detector.add_motion(5, 4, {});
  CHECK(detector.episodes().empty());
}
