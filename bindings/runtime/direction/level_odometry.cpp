// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/direction/level_odometry.hpp"

#include <cmath>
#include <numbers>

namespace sweepkit {

namespace {

constexpr double kDegree = std::numbers::pi / 180;
// More than this between the floor's normal and what the accelerometer reads is no acceleration of a robot on
// its wheels.
constexpr double kTilted = 8 * kDegree;

SO3d turn_onto(const Vec3<double>& from, const Vec3<double>& to) {
  return SO3d(Eigen::Quaterniond::FromTwoVectors(from, to));
}

}  // namespace

LevelOdometry::LevelOdometry(const MotionSensors& sensors, const SE3d& T_body_camera,
                             const LevelOdometryOptions& options)
    : options_(options), filter_(sensors, options.navigation) {
  check_options(options_);
  const Vec3<double> up = sensors.wheels
                              ? Vec3<double>(sensors.wheels->T_body_base.rotation() * Vec3<double>::UnitZ())
                              : Vec3<double>(T_body_camera.rotation() * -Vec3<double>::UnitY());
  R_level_body_ = turn_onto(up, Vec3<double>::UnitZ());
  gyro_sum_.setZero();
  gyro_squares_.setZero();
  accel_sum_.setZero();
  accel_squares_.setZero();
}

void LevelOdometry::begin(TimeNs t, const std::optional<Vec3<double>>& specific_force) {
  SO3d R = R_level_body_;
  const double gravity = options_.navigation.gravity;
  Vec3<double> force = R.inverse() * Vec3<double>(0, 0, gravity);
  if (specific_force && specific_force->norm() > 0.5 * gravity) {
    const Vec3<double> measured = R * specific_force->normalized();
    const double tilt = std::acos(std::min(1.0, measured.z()));
    if (!filter_.sensors().wheels || tilt > kTilted) {
      R = turn_onto(measured, Vec3<double>::UnitZ()) * R;
      force = *specific_force;
    }
  }
  filter_.start(t, SE3d(R, Vec3<double>::Zero()),
                filter_.sensors().imu ? std::optional<Vec3<double>>(force) : std::nullopt);
  rest_begin_ = t;
}

void LevelOdometry::add(const ImuSample& sample) {
  if (!sample.gyro.allFinite() || !sample.accel.allFinite() || (last_imu_ && sample.t <= last_imu_->t))
    return;
  if (!filter_.started()) begin(sample.t, sample.accel);
  if (sample.t < filter_.state().t) return;
  filter_.add(sample);
  last_imu_ = sample;
  // Sums about the first reading: variances stay exact.
  gyro_sum_ += sample.gyro;
  gyro_squares_ += sample.gyro.cwiseAbs2();
  accel_sum_ += sample.accel;
  accel_squares_ += sample.accel.cwiseAbs2();
  ++rest_samples_;
  if (to_seconds(sample.t - rest_begin_) >= options_.rest_time) {
    end_rest();
    rest_begin_ = sample.t;
  }
}

void LevelOdometry::add(const WheelSample& sample) {
  if (!std::isfinite(sample.left) || !std::isfinite(sample.right) ||
      (last_wheels_ && sample.t <= last_wheels_->t))
    return;
  if (!filter_.started()) {
    // The accelerometer, if there is one, is about to say how the body stands.
    if (filter_.sensors().imu) return;
    begin(sample.t, std::nullopt);
  }
  if (sample.t < filter_.state().t) return;
  filter_.add(sample);
  const bool rolled =
      sample.reading == WheelReading::speeds
          ? sample.left != 0 || sample.right != 0
          : !last_wheels_ || sample.left != last_wheels_->left || sample.right != last_wheels_->right;
  last_wheels_ = sample;
  if (!rolled) return;
  rest_begin_ = sample.t;
  rest_samples_ = 0;
  gyro_sum_.setZero();
  gyro_squares_.setZero();
  accel_sum_.setZero();
  accel_squares_.setZero();
}

void LevelOdometry::end_rest() {
  const double n = rest_samples_;
  const Vec3<double> gyro = gyro_sum_ / std::max(n, 1.0), accel = accel_sum_ / std::max(n, 1.0);
  const Vec3<double> gyro_variance = gyro_squares_ / std::max(n, 1.0) - gyro.cwiseAbs2();
  const Vec3<double> accel_variance = accel_squares_ / std::max(n, 1.0) - accel.cwiseAbs2();
  rest_samples_ = 0;
  gyro_sum_.setZero();
  gyro_squares_.setZero();
  accel_sum_.setZero();
  accel_squares_.setZero();
  if (n < 5) return;
  const MountedImu& imu = *filter_.sensors().imu;
  const double rate = n / options_.rest_time;
  const double noise = imu.noise.gyro_noise_density * imu.noise.gyro_noise_density * rate;
  const double spread = options_.rest_spread * kDegree;
  if (gyro_variance.maxCoeff() > spread * spread + 4 * noise) return;
  if (gyro.cwiseAbs().maxCoeff() > options_.rest_rate * kDegree) return;
  if (!filter_.sensors().wheels) {
    const double accel_noise = imu.noise.accel_noise_density * imu.noise.accel_noise_density * rate;
    if (accel_variance.maxCoeff() > options_.rest_acceleration * options_.rest_acceleration + 4 * accel_noise)
      return;
  }
  filter_.stand_still(gyro, options_.rest_time);
}

SO3d LevelOdometry::orientation(TimeNs t) {
  if (!filter_.started()) return R_level_body_;
  if (t > filter_.state().t) filter_.advance(t);
  return turn_onto(filter_.state().up, Vec3<double>::UnitZ()) * filter_.state().T_world_body.rotation();
}

}  // namespace sweepkit
