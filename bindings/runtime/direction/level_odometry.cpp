// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/direction/level_odometry.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace sweepkit {

namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kSmoothing = 0.5;  // of the specific force [s]
constexpr double kHold = 0.1;       // of the last rate beyond the last sample [s]
constexpr double kUsualRate = 200;  // of an IMU that does not tell its own [Hz]

SO3d turn_onto(const Vec3<double>& from, const Vec3<double>& to) {
  return SO3d(Eigen::Quaterniond::FromTwoVectors(from, to));
}

}  // namespace

LevelOdometry::LevelOdometry(const MotionSensors& sensors, const SE3d& T_body_camera,
                             const LevelOdometryOptions& options)
    : sensors_(sensors), options_(options) {
  check_options(options_);
  floor_up_ = sensors_.wheels ? Vec3<double>(sensors_.wheels->T_body_base.rotation() * Vec3<double>::UnitZ())
                              : Vec3<double>(T_body_camera.rotation() * -Vec3<double>::UnitY());
  R_world_body_ = turn_onto(floor_up_, Vec3<double>::UnitZ());
  if (sensors_.wheels) decoder_.emplace(sensors_.wheels->geometry, options_.decoder);
  if (sensors_.imu)
    standstill_.emplace(sensors_.imu->noise, sensors_.imu->rate_hz > 0 ? sensors_.imu->rate_hz : kUsualRate,
                        sensors_.wheels ? sensors_.wheels->geometry : WheelGeometry(), options_.standstill);
}

void LevelOdometry::level(double seconds) {
  const double norm = force_.norm();
  if (!(norm > 1e-3)) return;
  const Vec3<double> measured = force_ / norm;
  const bool on_floor = sensors_.wheels && measured.dot(floor_up_) > std::cos(options_.max_tilt * kDegree);
  const Vec3<double> up = on_floor ? floor_up_ : measured;
  const double gain = on_floor ? options_.floor_gain : options_.gravity_gain;
  // The turn that brings it to z, about a horizontal axis: the yaw is left alone.
  const Vec3<double> error = (R_world_body_ * up).cross(Vec3<double>::UnitZ());
  R_world_body_ = SO3d::exp(std::min(1.0, gain * seconds) * error) * R_world_body_;
  const Vec3<double> z = R_world_body_.inverse() * Vec3<double>::UnitZ();
  // Critically damped.
  tilt_bias_ -= 0.25 * gain * gain * seconds * (R_world_body_.inverse() * error);
  tilt_bias_ -= z * z.dot(tilt_bias_);
}

void LevelOdometry::rest(const ImuSample& sample) {
  if (!standstill_->standing()) {
    rest_count_ = 0;
    return;
  }
  if (rest_count_ == 0) {
    rest_sum_.setZero();
    rest_since_ = sample.t;
  }
  rest_sum_ += sample.gyro;
  ++rest_count_;
  const double seconds = to_seconds(sample.t - rest_since_);
  const double sigma = sensors_.imu->noise.gyro_noise_density / std::sqrt(std::max(seconds, 1e-3));
  // A short rest does not replace what a long one said, unless that is old.
  const double age = to_seconds(sample.t - bias_time_);
  if (bias_ && sigma > std::hypot(bias_sigma_, options_.bias_walk * kDegree * std::sqrt(std::max(age, 0.0))))
    return;
  bias_ = rest_sum_ / rest_count_;
  bias_sigma_ = sigma;
  bias_time_ = sample.t;
  standstill_->set_gyro_bias(*bias_);
}

void LevelOdometry::add(const ImuSample& sample) {
  if (!sensors_.imu || !standstill_->add(sample)) return;
  rest(sample);
  if (!last_imu_) {
    force_ = sample.accel;
    // The first reading decides whether the floor is to be believed.
    const Vec3<double> measured = force_.normalized();
    const bool on_floor = sensors_.wheels && measured.dot(floor_up_) > std::cos(options_.max_tilt * kDegree);
    if (!on_floor && force_.norm() > 1e-3) R_world_body_ = turn_onto(measured, Vec3<double>::UnitZ());
    last_imu_ = sample;
    return;
  }
  const double dt = to_seconds(sample.t - last_imu_->t);
  if (dt < options_.max_gap) {
    // The mean of two readings over the interval between them.
    const Vec3<double> rate = 0.5 * (last_imu_->gyro + sample.gyro);
    R_world_body_ = R_world_body_ * SO3d::exp((rate - tilt_bias_) * dt);
    force_ += std::min(1.0, dt / kSmoothing) * (sample.accel - force_);
    level(dt);
  } else {
    force_ = sample.accel;
    level(1.0);
  }
  last_imu_ = sample;
}

void LevelOdometry::add(const WheelSample& sample) {
  if (!sensors_.wheels) return;
  if (standstill_) standstill_->add(sample);
  const auto step = decoder_->push(sample);
  if (sensors_.imu || !step) return;
  const double turned = (step->right - step->left) / sensors_.wheels->geometry.track_width;
  R_world_body_ = SO3d::exp(Vec3<double>(0, 0, turned)) * R_world_body_;
  wheel_rate_ = turned / std::max(step->seconds(), 1e-3);
  last_wheels_ = step->end;
}

SO3d LevelOdometry::orientation(TimeNs t) const {
  const auto ahead = [&](TimeNs last) { return std::clamp(to_seconds(t - last), 0.0, kHold); };
  if (last_imu_) return R_world_body_ * SO3d::exp((last_imu_->gyro - tilt_bias_) * ahead(last_imu_->t));
  if (last_wheels_ != 0)
    return SO3d::exp(Vec3<double>(0, 0, wheel_rate_ * ahead(last_wheels_))) * R_world_body_;
  return R_world_body_;
}

YawDrift LevelOdometry::drift() const {
  if (!sensors_.imu) return {0, sensors_.wheels ? options_.wheel_yaw_sigma * kDegree : 0.0};
  if (!bias_ || !last_imu_) return {0, options_.gyro_bias_sigma * kDegree};
  const Vec3<double> up = R_world_body_.inverse() * Vec3<double>::UnitZ();
  const double age = std::max(0.0, to_seconds(last_imu_->t - bias_time_));
  return {up.dot(*bias_), std::hypot(bias_sigma_, options_.bias_walk * kDegree * std::sqrt(age))};
}

}  // namespace sweepkit
