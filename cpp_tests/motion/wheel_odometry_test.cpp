// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/motion/wheel_odometry.hpp"

#include <catch2/catch.hpp>
#include <limits>

#include "motion/drive_simulation.hpp"

using namespace sweepkit;
using test::cleaning_motion;
using test::DriveSimulation;

namespace {

DriveSimulation simulate(double seconds, bool exact, std::uint64_t seed = 1) {
  DriveSimulation drive;
  drive.motion = cleaning_motion;
  if (exact) {
    drive.gyro_noise = drive.accel_noise = 0;
    drive.whole_ticks = false;
  } else {
    drive.wheel_noise = 0.002;
  }
  drive.run(seconds, seed);
  return drive;
}

template <class Odometry = OdometryIntegrator>
Odometry feed(const DriveSimulation& drive, bool gyro = true, bool wheels = true,
              const OdometryOptions& options = {}) {
  Odometry odometry(drive.geometry, drive.T_body_base, ImuNoise{drive.gyro_noise}, options);
  odometry.set_gyro_bias(drive.gyro_bias);
  odometry.set_wheels(drive.wheels);
  if (gyro)
    for (const auto& s : drive.imu) odometry.add(s);
  if (wheels)
    for (const auto& s : drive.ticks) odometry.add(s);
  return odometry;
}

double distance(const SE3d& a, const SE3d& b) { return (a.inverse() * b).translation().norm(); }
double angle(const SE3d& a, const SE3d& b) { return (a.inverse() * b).rotation().angle(); }

}  // namespace

TEST_CASE("wheels to motion in the plane", "[motion][odometry]") {
  const WheelStep step{0, 20'000'000, 0.01, 0.03};
  const WheelParameters wheels{1.1, 0.9, 0.2};
  const PlanarStep planar = planar_step(step, wheels);
  CHECK(planar.forward == Approx(0.5 * (0.011 + 0.027)));
  CHECK(planar.turn == Approx((0.027 - 0.011) / 0.2));
  constexpr double h = 1e-6;
  for (int i = 0; i < 3; ++i) {
    Vec3<double> more = wheels.vector(), less = wheels.vector();
    more[i] += h;
    less[i] -= h;
    const auto a = planar_step(step, {more[0], more[1], more[2]}),
               b = planar_step(step, {less[0], less[1], less[2]});
    CHECK(planar.d_forward[i] == Approx((a.forward - b.forward) / (2 * h)).margin(1e-9));
    CHECK(planar.d_turn[i] == Approx((a.turn - b.turn) / (2 * h)).margin(1e-9));
  }
}

TEST_CASE("perfect sensors give the true motion, by gyro and by wheels alone", "[motion][odometry]") {
  const DriveSimulation drive = simulate(27, true);
  const auto both = feed(drive), wheels = feed(drive, false);
  for (const auto& [a, b] : {std::pair(0, 5400), std::pair(400, 1800), std::pair(2600, 3900)}) {
    const SE3d truth = drive.relative(a, b);
    const OdometryMotion m = both.between(drive.imu[a].t, drive.imu[b].t);
    CHECK(distance(m.motion.T, truth) < 2e-4);
    CHECK(angle(m.motion.T, truth) < 1e-4);
    CHECK(m.without_gyro == 0);
    CHECK(m.without_wheels == 0);
    const OdometryMotion w = wheels.between(drive.imu[a].t, drive.imu[b].t);
    CHECK(distance(w.motion.T, truth) < 2e-3);
    CHECK(angle(w.motion.T, truth) < 1e-3);
    CHECK(w.without_gyro == Approx(to_seconds(drive.imu[b].t - drive.imu[a].t)));
  }
  // Between samples, and one after the other.
  const auto whole = both.between(3'001'000'000, 9'999'000'000);
  const auto first = both.between(3'001'000'000, 4'567'800'000),
             second = both.between(4'567'800'000, 9'999'000'000);
  CHECK(distance(whole.motion.T, first.motion.T * second.motion.T) < 1e-5);
  CHECK(whole.rolled == Approx(first.rolled + second.rolled));
  const auto nothing = both.between(5, 5);
  CHECK(nothing.motion.T.translation().norm() < 1e-15);
  CHECK_THROWS_AS(both.between(5, 4), Error);
}

TEST_CASE("derivatives of odometry with respect to bias and wheels", "[motion][odometry]") {
  const DriveSimulation drive = simulate(20, false);
  for (const bool with_gyro : {true, false}) {
    auto odometry = feed(drive, with_gyro);
    const TimeNs from = 6'003'000'000, to = 19'002'000'000;
    const OdometryMotion m = odometry.between(from, to);
    const SE3d back = m.motion.T.inverse();
    constexpr double h = 1e-5;
    for (int i = 0; i < 3; ++i) {
      const Vec3<double> bias = odometry.gyro_bias();
      const auto with_bias = [&](double d) {
        Vec3<double> moved = bias;
        moved[i] += d;
        odometry.set_gyro_bias(moved);
        const Vec6<double> e = (back * odometry.between(from, to).motion.T).log();
        odometry.set_gyro_bias(bias);
        return e;
      };
      CHECK(((with_bias(h) - with_bias(-h)) / (2 * h) - m.d_gyro_bias.col(i)).norm() < 1e-3);
      const auto with_wheels = [&](double d) {
        Vec3<double> moved = drive.wheels.vector();
        moved[i] += d;
        odometry.set_wheels({moved[0], moved[1], moved[2]});
        const Vec6<double> e = (back * odometry.between(from, to).motion.T).log();
        odometry.set_wheels(drive.wheels);
        return e;
      };
      CHECK(((with_wheels(h) - with_wheels(-h)) / (2 * h) - m.d_wheels.col(i)).norm() < 2e-3);
    }
    if (!with_gyro) CHECK(m.d_gyro_bias.norm() == 0);
    if (with_gyro) CHECK(m.d_wheels.col(2).norm() == 0);
  }
}

TEST_CASE("the covariance of odometry is honest", "[motion][odometry]") {
  // Normalised errors squared over many runs average to the number of dimensions that noise reaches.
  for (const bool with_gyro : {true, false}) {
    double sum = 0;
    int count = 0;
    for (std::uint64_t seed = 1; seed <= 12; ++seed) {
      const DriveSimulation drive = simulate(22, false, seed);
      OdometryOptions options;
      options.wheel_noise = 0.002;
      options.lateral_noise = options.tilt_noise = 1e-4;
      const auto odometry = feed(drive, with_gyro, true, options);
      for (int a = 500; a + 700 < 4400; a += 700) {
        const OdometryMotion m = odometry.between(drive.imu[a].t, drive.imu[a + 700].t);
        // In the base, where the plane is: forward, sideways, turn.
        const Vec6<double> e = (drive.T_body_base.inverse() * drive.relative(a, a + 700).inverse() *
                                m.motion.T * drive.T_body_base)
                                   .log();
        const Mat6<double> P = carry_covariance(m.motion.covariance, drive.T_body_base);
        const Eigen::Vector3d planar(e[0], e[1], e[5]);
        Mat3<double> Q;
        const int axes[] = {0, 1, 5};
        for (int i = 0; i < 3; ++i)
          for (int j = 0; j < 3; ++j) Q(i, j) = P(axes[i], axes[j]);
        sum += planar.dot(Q.ldlt().solve(planar));
        ++count;
      }
    }
    CAPTURE(with_gyro, sum / count);
    CHECK(sum / count > 1.0);
    CHECK(sum / count < 6.0);
  }
}

TEMPLATE_TEST_CASE("odometry takes any integrator", "[motion][odometry]", EulerIntegrator, MidpointIntegrator,
                   ClosedFormIntegrator) {
  const DriveSimulation drive = simulate(27, true);
  const auto odometry = feed<BasicOdometryIntegrator<TestType>>(drive);
  const double tolerance = std::is_same_v<TestType, EulerIntegrator> ? 5e-3 : 2e-4;
  CHECK(distance(odometry.between(0, drive.imu[5000].t).motion.T, drive.relative(0, 5000)) < tolerance);
}

TEST_CASE("silence, absence and distrust show in the covariance", "[motion][odometry]") {
  const DriveSimulation drive = simulate(27, false);
  const TimeNs from = 3 * kNsPerSecond, to = 6 * kNsPerSecond;
  const SE3d truth = drive.relative(600, 1200);
  const auto inside = [&](const OdometryMotion& m) {
    const Vec6<double> e = (m.motion.T.inverse() * truth).log();
    CHECK(e.allFinite());
    CHECK(m.motion.covariance.allFinite());
    CHECK(e.dot(m.motion.covariance.ldlt().solve(e)) < 22.5);  // chi-square, 6 degrees of freedom, 0.1 %
  };
  OdometryOptions options;
  options.lateral_noise = 0.002;
  SECTION("both") { inside(feed(drive).between(from, to)); }
  SECTION("neither") {
    const OdometryMotion m = feed(drive, false, false).between(from, to);
    inside(m);
    CHECK(m.motion.T.translation().norm() < 1e-15);
    CHECK(m.without_gyro == Approx(3));
    CHECK(m.without_wheels == Approx(3));
  }
  SECTION("gyro only") {
    const OdometryMotion m = feed(drive, true, false).between(from, to);
    inside(m);
    CHECK(angle(m.motion.T, truth) < 0.003);
  }
  SECTION("a second without wheels, half a second without gyro, in turns") {
    OdometryIntegrator odometry(drive.geometry, drive.T_body_base, ImuNoise{drive.gyro_noise}, options);
    odometry.set_gyro_bias(drive.gyro_bias);
    odometry.set_wheels(drive.wheels);
    for (const auto& s : drive.imu)
      if (s.t < 4'500'000'000 || s.t > 5'000'000'000) odometry.add(s);
    for (const auto& s : drive.ticks)
      if (s.t < 3'200'000'000 || s.t > 4'200'000'000) odometry.add(s);
    const OdometryMotion m = odometry.between(from, to);
    CHECK(m.without_gyro == Approx(0.51).margin(0.011));
    CHECK(m.without_wheels == 0);  // ticks count on
    inside(m);
    CHECK(distance(m.motion.T, truth) < 0.05);
  }
  SECTION("counters reset, wrap, not a number, steps back in time") {
    OdometryIntegrator odometry(drive.geometry, drive.T_body_base, ImuNoise{drive.gyro_noise}, options);
    odometry.set_gyro_bias(drive.gyro_bias);
    odometry.set_wheels(drive.wheels);
    for (auto s : drive.imu) {
      if (s.t == 4'000'000'000) s.gyro.y() = std::numeric_limits<double>::quiet_NaN();
      CHECK(odometry.add(s) == s.gyro.allFinite());
    }
    const double left = drive.ticks[200].left, right = drive.ticks[200].right;
    for (auto s : drive.ticks) {
      if (s.t > 4'000'000'000) s.left -= left, s.right -= right;
      odometry.add(s);
    }
    CHECK_FALSE(odometry.add(drive.ticks[100]));
    CHECK_FALSE(odometry.add(drive.imu[100]));
    CHECK(odometry.decoder().resets() == 1);
    const OdometryMotion m = odometry.between(from, to);
    CHECK(m.without_wheels == Approx(0.02));
    inside(m);
    CHECK(distance(m.motion.T, truth) < 0.02);
  }
  SECTION("wheels that are not believed") {
    auto odometry = feed(drive);
    odometry.distrust_wheels(4 * kNsPerSecond, 5 * kNsPerSecond);
    const OdometryMotion m = odometry.between(from, to);
    CHECK(m.without_wheels == Approx(1));
    CHECK(distance(m.motion.T, truth) > 0.2);
    inside(m);
  }
  SECTION("wheels at rest in the air say nothing") {
    OdometryIntegrator carried(drive.geometry, drive.T_body_base, ImuNoise{drive.gyro_noise}, options);
    carried.set_gyro_bias(drive.gyro_bias);
    for (const auto& s : drive.imu) carried.add(s);
    for (auto s : drive.ticks) {
      s.left = s.right = 7;
      carried.add(s);
    }
    carried.distrust_wheels(from, to, true);
    const OdometryMotion m = carried.between(from, to);
    CHECK(m.without_wheels == Approx(3));
    CHECK(std::sqrt(m.motion.covariance(0, 0)) >= 3 * options.unknown_speed * 0.99);
    inside(m);
  }
  SECTION("beyond the newest sample rates are held, then unknown") {
    OdometryIntegrator odometry(drive.geometry, drive.T_body_base, ImuNoise{drive.gyro_noise}, options);
    odometry.set_gyro_bias(drive.gyro_bias);
    odometry.set_wheels(drive.wheels);
    for (const auto& s : drive.imu)
      if (s.t <= 4 * kNsPerSecond) odometry.add(s);
    for (const auto& s : drive.ticks)
      if (s.t <= 4 * kNsPerSecond) odometry.add(s);
    CHECK(odometry.covered_until() == 4 * kNsPerSecond);
    const OdometryMotion soon = odometry.between(from, 4'050'000'000);
    CHECK(distance(soon.motion.T, drive.relative(600, 810)) < 0.005);
    CHECK(soon.without_gyro == Approx(0.05));
    inside(odometry.between(from, to));
    CHECK(odometry.between(from, to).motion.covariance(0, 0) > 100 * soon.motion.covariance(0, 0));
    CHECK(odometry.between(-5 * kNsPerSecond, -kNsPerSecond).motion.T.translation().norm() < 1e-15);
  }
}

TEST_CASE("the wheels' clock may be off", "[motion][odometry]") {
  DriveSimulation drive;
  drive.motion = cleaning_motion;
  drive.gyro_noise = 0;
  drive.whole_ticks = false;
  drive.wheel_offset = 50'000'000;
  drive.run(27);
  OdometryIntegrator right(drive.geometry, drive.T_body_base, {}, {}, -50'000'000);
  OdometryIntegrator wrong(drive.geometry, drive.T_body_base);
  for (auto* odometry : {&right, &wrong}) {
    odometry->set_gyro_bias(drive.gyro_bias);
    odometry->set_wheels(drive.wheels);
    for (const auto& s : drive.imu) odometry->add(s);
    for (const auto& s : drive.ticks) odometry->add(s);
  }
  const SE3d truth = drive.relative(400, 5300);
  CHECK(distance(right.between(drive.imu[400].t, drive.imu[5300].t).motion.T, truth) < 5e-4);
  CHECK(distance(wrong.between(drive.imu[400].t, drive.imu[5300].t).motion.T, truth) > 1e-3);
}

TEST_CASE("forgetting does not change what comes later", "[motion][odometry]") {
  const DriveSimulation drive = simulate(27, false);
  const auto all = feed(drive);
  OdometryIntegrator odometry(drive.geometry, drive.T_body_base, ImuNoise{drive.gyro_noise});
  odometry.set_gyro_bias(drive.gyro_bias);
  odometry.set_wheels(drive.wheels);
  std::size_t k = 0;
  for (const auto& s : drive.imu) {
    while (k < drive.ticks.size() && drive.ticks[k].t <= s.t) odometry.add(drive.ticks[k++]);
    odometry.add(s);
    odometry.forget_before(s.t - kNsPerSecond);
    if (s.t < 2 * kNsPerSecond || s.t % 100'000'000 != 0) continue;
    CHECK(odometry.gyro_samples().size() < 1000);
    const SE3d a = odometry.between(s.t - kNsPerSecond, s.t).motion.T;
    CHECK(distance(a, all.between(s.t - kNsPerSecond, s.t).motion.T) < 1e-15);
  }
}
