// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <deque>
#include <optional>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/sample.hpp"
#include "sweepkit/geometry/so3.hpp"
#include "sweepkit/motion/wheel_decoder.hpp"

namespace sweepkit {

struct StandstillOptions {
  double window = 0.3;
  double noise_factor = 1.6;
  double max_rate = 6.0;
  double max_rate_from_bias = 0.5;
  double max_ticks = 1.0;
  double max_wheel_speed = 0.003;
  double velocity_step = 0.008;
  double max_gap = 0.1;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(window, "window", "s", range(0.02, 10.0), "all must be quiet for that long");
    v(noise_factor, "noise_factor", "", range(1.0, 100.0),
      "gyro and accelerometer are quiet while their spread is below that many times their noise");
    v(max_rate, "max_rate", "deg/s", range(0.0, 100.0),
      "largest mean rate while the gyro's bias is not known");
    v(max_rate_from_bias, "max_rate_from_bias", "deg/s", range(0.0, 100.0),
      "largest difference of the mean rate from the bias, once that is known");
    v(max_ticks, "max_ticks", "ticks", range(0.0, 1000.0), "a wheel at rest may count that many to and fro");
    v(max_wheel_speed, "max_wheel_speed", "m/s", range(0.0, 1.0), "of a wheel that tells its speed");
    v(velocity_step, "velocity_step", "m/s", range(1e-4, 1.0),
      "change of velocity that ends a stand, however smooth; half of what is not to be missed");
    v(max_gap, "max_gap", "s", range(1e-3, 10.0), "sensors silent for longer are taken as absent");
  }
};

/// Tells whether the robot stands still, from gyro, accelerometer and wheels, or those of them that there
/// are. All that speak must be quiet over the window: the wheels count nothing, and gyro and accelerometer
/// spread no more than their own noise, about a rate that can be a bias. Wheels at rest are not enough where
/// an IMU speaks (carried), nor is a quiet IMU where wheels do (creeping on a smooth floor).
///
/// Without wheels a smooth floor cannot be told from none, but the step of velocity into motion can: a stand
/// ends as soon as the acceleration since then integrates to velocity_step, and nothing is a stand again
/// until either the step is undone soon, or something shook and came to rest. So it begins with the first
/// quiet window: a recording that begins in smooth motion, without wheels, is beyond it. Not thread-safe.
class StandstillDetector {
 public:
  explicit StandstillDetector(const ImuNoise& noise, double imu_rate_hz, const WheelGeometry& geometry = {},
                              const StandstillOptions& options = {})
      : noise_(noise), imu_rate_(imu_rate_hz), geometry_(geometry), options_(options), decoder_(geometry) {
    require(std::isfinite(imu_rate_hz) && imu_rate_hz > 0, "StandstillDetector imu_rate_hz",
            "must be positive", imu_rate_hz);
    check_options(options);
  }

  /// False for a sample that is not newer than the last of its kind, or not finite.
  bool add(const ImuSample& sample);
  bool add(const WheelSample& sample);
  /// What the gyro says at rest, if somebody knows.
  void set_gyro_bias(const Vec3<double>& bias) { gyro_bias_ = bias; }

  bool standing() const { return standing_; }
  /// Since when: the begin of the first quiet window. Only while standing.
  TimeNs since() const { return since_; }

 private:
  struct Roll {
    TimeNs t;
    double left, right;
  };
  bool imu_quiet() const;
  /// Vibration: samples differ from their neighbours by more than noise. A smooth change of speed does not.
  bool shaking() const;
  bool wheels_quiet() const;
  bool covered(TimeNs first, TimeNs last) const {
    return last - first >= from_seconds(options_.window) - kNsPerSecond / 100;
  }
  void decide(TimeNs t);

  ImuNoise noise_;
  double imu_rate_;
  WheelGeometry geometry_;
  StandstillOptions options_;
  WheelDecoder decoder_;
  std::optional<Vec3<double>> gyro_bias_;
  std::deque<ImuSample> imu_;  // the window
  std::deque<Roll> rolls_;     // the window: where the wheels were
  Roll rolled_{0, 0, 0};
  bool speeds_ = false;
  bool standing_ = false;
  TimeNs since_ = 0;
  // Without wheels: velocity gained since the stand, and what the accelerometer said during it.
  Vec3<double> at_rest_ = Vec3<double>::Zero(), velocity_ = Vec3<double>::Zero();
  std::size_t at_rest_count_ = 0;
  bool left_smoothly_ = false;
  TimeNs left_at_ = 0;
};

inline bool StandstillDetector::add(const ImuSample& sample) {
  if (!std::isfinite(sample.gyro.sum() + sample.accel.sum()) || (!imu_.empty() && sample.t <= imu_.back().t))
    return false;
  if (!imu_.empty()) {
    const TimeNs gap = sample.t - imu_.back().t;
    if (gap > from_seconds(options_.max_gap)) {
      imu_.clear();
      left_smoothly_ = false;
      at_rest_count_ = 0;
    } else if (at_rest_count_ > 0) {
      const double dt = to_seconds(gap);
      velocity_ += (sample.accel - at_rest_) * dt;
      // At rest it forgets within a second, so that a slow drift of the accelerometer is no motion.
      if (!left_smoothly_) velocity_ *= std::exp(-dt);
    }
  }
  imu_.push_back(sample);
  while (imu_.size() > 1 && sample.t - imu_.front().t > from_seconds(options_.window)) imu_.pop_front();
  decide(sample.t);
  return true;
}

inline bool StandstillDetector::add(const WheelSample& sample) {
  const std::size_t refused = decoder_.refused();
  const auto step = decoder_.push(sample);
  if (decoder_.refused() != refused) return false;
  speeds_ = sample.reading == WheelReading::speeds;
  if (!step || !step->measured || step->seconds() > options_.max_gap) {
    rolls_.clear();
  } else {
    rolled_.left += step->left;
    rolled_.right += step->right;
  }
  rolled_.t = sample.t;
  rolls_.push_back(rolled_);
  while (rolls_.size() > 1 && sample.t - rolls_.front().t > from_seconds(options_.window)) rolls_.pop_front();
  decide(sample.t);
  return true;
}

inline bool StandstillDetector::imu_quiet() const {
  if (imu_.size() < 5 || !covered(imu_.front().t, imu_.back().t)) return false;
  constexpr double kDegree = 0.017453292519943295;
  Vec3<double> gyro = Vec3<double>::Zero(), accel = gyro, gyro2 = gyro, accel2 = gyro;
  const Vec3<double> g0 = imu_.front().gyro, a0 = imu_.front().accel;
  for (const ImuSample& s : imu_) {
    const Vec3<double> g = s.gyro - g0, a = s.accel - a0;
    gyro += g;
    accel += a;
    gyro2 += g.cwiseAbs2();
    accel2 += a.cwiseAbs2();
  }
  const auto n = static_cast<double>(imu_.size());
  const auto loud = [&](const Vec3<double>& sum, const Vec3<double>& squares, double density) {
    const Vec3<double> variance = (squares - sum.cwiseAbs2() / n) / (n - 1);
    const double most = options_.noise_factor * density;
    return variance.maxCoeff() > most * most * imu_rate_;
  };
  if (loud(gyro, gyro2, noise_.gyro_noise_density) || loud(accel, accel2, noise_.accel_noise_density))
    return false;
  const Vec3<double> mean = g0 + gyro / n;
  return gyro_bias_ ? (mean - *gyro_bias_).norm() <= options_.max_rate_from_bias * kDegree
                    : mean.norm() <= options_.max_rate * kDegree;
}

inline bool StandstillDetector::shaking() const {
  if (imu_.size() < 5 || !covered(imu_.front().t, imu_.back().t)) return false;
  Vec3<double> squares = Vec3<double>::Zero();
  for (std::size_t k = 1; k < imu_.size(); ++k) squares += (imu_[k].accel - imu_[k - 1].accel).cwiseAbs2();
  const double most = options_.noise_factor * noise_.accel_noise_density;
  return squares.maxCoeff() / (2.0 * static_cast<double>(imu_.size() - 1)) > most * most * imu_rate_;
}

inline bool StandstillDetector::wheels_quiet() const {
  if (rolls_.size() < 2 || !covered(rolls_.front().t, rolls_.back().t)) return false;
  double low_left = rolled_.left, high_left = low_left, low_right = rolled_.right, high_right = low_right;
  for (const Roll& roll : rolls_) {
    low_left = std::min(low_left, roll.left);
    high_left = std::max(high_left, roll.left);
    low_right = std::min(low_right, roll.right);
    high_right = std::max(high_right, roll.right);
  }
  const double most = speeds_ ? options_.max_wheel_speed * to_seconds(rolls_.back().t - rolls_.front().t)
                              : (options_.max_ticks + 1e-6) * geometry_.metres_per_tick();
  return high_left - low_left <= most && high_right - low_right <= most;
}

inline void StandstillDetector::decide(TimeNs t) {
  const TimeNs stale = t - from_seconds(options_.max_gap);
  const bool has_imu = !imu_.empty() && imu_.back().t >= stale;
  const bool has_wheels = !rolls_.empty() && rolls_.back().t >= stale;
  const bool imu_rests = has_imu && imu_quiet();
  bool rests = (has_imu || has_wheels) && (!has_imu || imu_rests) && (!has_wheels || wheels_quiet());

  if (has_wheels) {
    left_smoothly_ = false;
    at_rest_count_ = 0;
  } else if (has_imu) {
    const double step = velocity_.norm();
    // Something that shook and came to rest tells a stop; a smooth step has to be undone.
    if (left_smoothly_ && !imu_rests && shaking()) {
      left_smoothly_ = false;
      at_rest_count_ = 0;
      velocity_.setZero();
    }
    if (left_smoothly_) {
      const double drift = 3 * noise_.accel_noise_density * std::sqrt(to_seconds(t - left_at_));
      const bool undone = step + drift < options_.velocity_step;
      rests = rests && undone;
      if (rests) left_smoothly_ = false;
    } else if (standing_ && at_rest_count_ > 0) {
      rests = rests && step <= options_.velocity_step;
      left_smoothly_ = !rests && !shaking();
      left_at_ = t;
    }
  }
  if (rests && !standing_) {
    since_ = t - from_seconds(options_.window);
    velocity_.setZero();
    at_rest_count_ = 0;
  }
  standing_ = rests;
  if (standing_ && has_imu && !has_wheels && imu_.back().t == t) {
    if (at_rest_count_ == 0) {
      at_rest_.setZero();
      for (const ImuSample& s : imu_) at_rest_ += s.accel / static_cast<double>(imu_.size());
      at_rest_count_ = imu_.size();
    } else {
      // The mean of the last two seconds.
      at_rest_count_ = std::min(at_rest_count_ + 1, static_cast<std::size_t>(2 * imu_rate_) + 1);
      at_rest_ += (imu_.back().accel - at_rest_) / static_cast<double>(at_rest_count_);
    }
  }
}

}  // namespace sweepkit
