// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/motion/wheel_calibration.hpp"

#include <catch2/catch.hpp>
#include <limits>

#include "motion/drive_simulation.hpp"

using namespace sweepkit;
using test::DriveSimulation;

namespace {

struct Vision {
  double metres = 0.001, radians = 0.001;
  int every = 100;  // samples of the IMU, 0.5 s
};

/// Everything in the order of arrival; vision with noise, if there is any.
void feed(WheelCalibrator& calibrator, const DriveSimulation& drive, bool gyro,
          const std::optional<Vision>& vision) {
  Random random(7);
  calibrator.set_gyro_bias(drive.gyro_bias);
  std::size_t k = 0;
  for (std::size_t i = 0; i < drive.imu.size(); ++i) {
    while (k < drive.ticks.size() && drive.ticks[k].t <= drive.imu[i].t) calibrator.add(drive.ticks[k++]);
    if (gyro) calibrator.add(drive.imu[i]);
    if (!vision || i % vision->every != 0 || i == 0) continue;
    Vec6<double> e;
    UncertainMotion<double> motion;
    for (int a = 0; a < 6; ++a) {
      const double sigma = a < 3 ? vision->metres : vision->radians;
      e[a] = random.normal(0, sigma);
      motion.covariance(a, a) = sigma * sigma;
    }
    motion.T = drive.relative(i - vision->every, i) * SE3d::exp(e);
    calibrator.add_motion(drive.imu[i - vision->every].t, drive.imu[i].t, motion);
  }
}

DriveSimulation simulate(std::function<Eigen::Vector2d(double)> motion, double seconds) {
  DriveSimulation drive;
  drive.motion = motion;
  drive.wheel_noise = 0.001;
  drive.run(seconds);
  return drive;
}

Eigen::Vector2d repeated(double t) { return test::cleaning_motion(std::fmod(t, 27.0)); }

void check_estimate(const WheelCalibrator& c, const DriveSimulation& drive) {
  const Vec3<double> error = c.parameters().vector() - drive.wheels.vector();
  CAPTURE(error.transpose(), c.used(), c.rejected());
  CHECK(std::abs(error[0]) < 0.003);
  CHECK(std::abs(error[1]) < 0.003);
  CHECK(std::abs(error[2]) < 0.01 * drive.wheels.track_width);
  const Mat3<double> P = c.covariance().topLeftCorner<3, 3>();
  CHECK(error.dot(P.ldlt().solve(error)) < 16.3);  // chi-square, 3 degrees of freedom, 0.1 %
}

}  // namespace

TEST_CASE("radii and track are found against vision and gyro", "[motion][calibration]") {
  const DriveSimulation drive = simulate(repeated, 60);
  for (const bool gyro : {true, false}) {
    WheelCalibrator calibrator(drive.geometry, drive.T_body_base);
    feed(calibrator, drive, gyro, Vision{});
    check_estimate(calibrator, drive);
    CHECK(calibrator.observed() == std::array{true, true, true, false});
    CHECK(calibrator.radius_left() == Approx(0.035 * 1.01).epsilon(0.003));
    CHECK(calibrator.rejected() <= 3);
  }
}

TEST_CASE("what a drive does not tell stays uncertain", "[motion][calibration]") {
  SECTION("the common scale, without vision") {
    const DriveSimulation drive = simulate(repeated, 60);
    WheelCalibrator calibrator(drive.geometry, drive.T_body_base);
    feed(calibrator, drive, true, std::nullopt);
    const WheelParameters p = calibrator.parameters(), truth = drive.wheels;
    // The ratio is known, and the track in terms of it.
    CHECK(p.scale_left / p.scale_right == Approx(truth.scale_left / truth.scale_right).epsilon(0.002));
    CHECK(p.track_width / p.scale_right == Approx(truth.track_width / truth.scale_right).epsilon(0.01));
    CHECK_FALSE(calibrator.observed()[0]);
    CHECK_FALSE(calibrator.observed()[1]);
    CHECK(std::sqrt(calibrator.covariance()(0, 0)) > 0.02);
  }
  SECTION("the track, on a straight line") {
    const DriveSimulation drive =
        simulate([](double t) { return Eigen::Vector2d(t > 1 ? 0.3 : 0.0, 0.0); }, 30);
    WheelCalibrator calibrator(drive.geometry, drive.T_body_base);
    feed(calibrator, drive, true, Vision{});
    CHECK(calibrator.observed() == std::array{true, true, false, false});
    CHECK(std::sqrt(calibrator.covariance()(2, 2)) > 0.09 * 0.235);
  }
  SECTION("anything, at rest") {
    const DriveSimulation drive = simulate([](double) { return Eigen::Vector2d(0, 0); }, 20);
    WheelCalibrator calibrator(drive.geometry, drive.T_body_base);
    const auto before = calibrator.covariance();
    feed(calibrator, drive, true, Vision{});
    CHECK(calibrator.parameters().vector() == WheelParameters::nominal(drive.geometry).vector());
    CHECK((calibrator.covariance() - before).norm() < 1e-5);
  }
}

TEST_CASE("one scale for both wheels", "[motion][calibration]") {
  DriveSimulation drive;
  drive.motion = repeated;
  drive.wheels = {1.02, 1.02, 0.30};
  drive.run(60);
  WheelCalibrationOptions options;
  options.difference_sigma = 0;
  options.track_sigma = 0.5;
  WheelCalibrator calibrator(drive.geometry, drive.T_body_base, {}, options);
  feed(calibrator, drive, true, Vision{});
  CHECK(calibrator.parameters().scale_left == calibrator.parameters().scale_right);
  check_estimate(calibrator, drive);
}

TEST_CASE("the offset of the wheels' clock", "[motion][calibration]") {
  for (const double offset : {0.05, -0.05, 0.0}) {
    DriveSimulation drive;
    drive.motion = repeated;
    drive.wheel_offset = -from_seconds(offset);
    drive.run(60);
    WheelCalibrationOptions options;
    options.offset_sigma = 0.03;
    options.gate = 10;
    WheelCalibrator calibrator(drive.geometry, drive.T_body_base, {}, options);
    feed(calibrator, drive, true, Vision{});
    CHECK(calibrator.offset() == Approx(offset).margin(0.004));
    CHECK(calibrator.observed()[3]);
    check_estimate(calibrator, drive);
  }
}

TEST_CASE("slip is not learnt, bounds hold, bad input does not matter", "[motion][calibration]") {
  DriveSimulation drive;
  drive.motion = repeated;
  drive.slip = [](double t) {
    return t > 33 && t < 35 ? Eigen::Vector2d(0.25, 0.25) : Eigen::Vector2d(0, 0);
  };
  drive.run(60);
  WheelCalibrator calibrator(drive.geometry, drive.T_body_base);
  feed(calibrator, drive, true, Vision{});
  check_estimate(calibrator, drive);
  CHECK(calibrator.rejected() >= 3);

  const auto before = calibrator.parameters().vector();
  UncertainMotion<double> nonsense;
  nonsense.T = SE3d(SO3d(), Vec3<double>::Constant(std::numeric_limits<double>::quiet_NaN()));
  calibrator.add_motion(0, kNsPerSecond, nonsense);
  calibrator.add_motion(kNsPerSecond, 0, {});
  CHECK_FALSE(calibrator.add(drive.imu[10]));
  CHECK_FALSE(calibrator.add(drive.ticks[10]));
  // Seconds of silence, counters set to zero.
  WheelSample zero = drive.ticks.back();
  zero.t += 3 * kNsPerSecond;
  zero.left = zero.right = 0;
  calibrator.add(zero);
  ImuSample late = drive.imu.back();
  late.t += 4 * kNsPerSecond;
  calibrator.add(late);
  CHECK((calibrator.parameters().vector() - before).norm() == 0);

  WheelCalibrationOptions tight;
  tight.max_scale_error = 0.005;
  WheelCalibrator bounded(drive.geometry, drive.T_body_base, {}, tight);
  feed(bounded, drive, true, Vision{});
  CHECK(std::abs(bounded.parameters().scale_left - 1) <= 0.005 + 1e-12);
  CHECK(std::abs(bounded.parameters().scale_right - 1) <= 0.005 + 1e-12);
}
