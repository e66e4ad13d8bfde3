// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <optional>

#include "sweepkit/core/options.hpp"
#include "sweepkit/motion/wheel_odometry.hpp"
#include "sweepkit/motion/wheel_track.hpp"

namespace sweepkit {

struct WheelCalibrationOptions {
  double scale_sigma = 0.03;
  double difference_sigma = 0.03;
  double track_sigma = 0.1;
  double offset_sigma = 0.0;
  double scale_walk = 1e-5;
  double wheel_noise = 0.002;
  double gyro_bias_sigma = 0.03;
  double gyro_interval = 0.5;
  double gate = 3.5;
  double max_scale_error = 0.2;
  double max_track_factor = 3.0;
  double max_offset = 0.2;
  double observed_share = 0.3;
  WheelDecoderOptions decoder;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(scale_sigma, "scale_sigma", "", range(0.0, 1.0), "how far both radii may lie off together, as a share");
    v(difference_sigma, "difference_sigma", "", range(0.0, 1.0),
      "how far the radii may differ, as a share; 0 estimates one scale for both");
    v(track_sigma, "track_sigma", "", range(0.0, 2.0), "how far the track width may lie off, as a share");
    v(offset_sigma, "offset_sigma", "s", range(0.0, 1.0),
      "how far the clock of the wheels may be off; 0 takes it as known");
    v(scale_walk, "scale_walk", "1/sqrt(s)", range(0.0, 1.0), "how fast radii and track change, as a share");
    v(wheel_noise, "wheel_noise", "m/sqrt(m)", range(0.0, 1.0), "error of a wheel after a metre rolled");
    v(gyro_bias_sigma, "gyro_bias_sigma", "deg/s", range(0.0, 100.0), "error of the gyro's bias");
    v(gyro_interval, "gyro_interval", "s", range(0.05, 10.0), "length of the turns compared with the gyro's");
    v(gate, "gate", "sigma", range(1.0, 1e6), "what disagrees by more is slip, and left out");
    v(max_scale_error, "max_scale_error", "", range(0.0, 0.9), "bound on either radius, as a share");
    v(max_track_factor, "max_track_factor", "", range(1.0, 100.0), "bound on the track width, up and down");
    v(max_offset, "max_offset", "s", range(0.0, 2.0), "bound on the offset of the clock");
    v(observed_share, "observed_share", "", range(0.01, 1.0),
      "a parameter counts as observed once its sigma is below this share of what it began with");
    v.group(decoder, "decoder", "from wheel samples to distances");
  }
};

/// Estimates radius of each wheel, track width and clock offset while driving, as a Kalman filter over
/// (scale_left, scale_right, track_width, offset). With L and R rolled by nominal radii:
///
///     0 = scale_right R - scale_left L - track psi     psi: turn by the gyro, else by vision
///     0 = (scale_right R + scale_left L) / 2 - f       f: arc length by vision
///
/// both linear but for the offset, which moves L and R by their speeds at the ends. What a drive does not
/// excite stays what it was with the uncertainty it had: straight lines tell nothing of the track, turns
/// without vision nothing of the common scale. What disagrees by more than the gate is taken as slip. Not
/// thread-safe.
class WheelCalibrator {
 public:
  using Vec4 = Eigen::Matrix<double, 4, 1>;
  using Mat4 = Eigen::Matrix<double, 4, 4>;

  WheelCalibrator(const WheelGeometry& geometry, const SE3d& T_body_base, const ImuNoise& noise = {},
                  const WheelCalibrationOptions& options = {})
      : geometry_(geometry),
        T_body_base_(T_body_base),
        options_(options),
        track_(geometry, T_body_base, noise, options.decoder),
        x_(1.0, 1.0, geometry.track_width, 0.0) {
    check_options(options);
    require(geometry.track_width > 0, "WheelCalibrator geometry", "must have a positive track width",
            geometry.track_width);
    const double common = options.scale_sigma * options.scale_sigma;
    const double apart = 0.25 * options.difference_sigma * options.difference_sigma;
    P_.setZero();
    P_(0, 0) = P_(1, 1) = common + apart;
    P_(0, 1) = P_(1, 0) = common - apart;
    P_(2, 2) = std::pow(options.track_sigma * geometry.track_width, 2);
    P_(3, 3) = options.offset_sigma * options.offset_sigma;
    P0_ = P_;
  }

  /// False for a sample that is refused.
  bool add(const ImuSample& sample) {
    const bool taken = track_.add(sample);
    if (taken) compare();
    return taken;
  }
  bool add(const WheelSample& sample) {
    const bool taken = track_.add(sample);
    if (taken) compare();
    return taken;
  }
  void set_gyro_bias(const Vec3<double>& bias) { gyro_bias_ = bias; }
  /// The motion of the body from one time to a later one by vision, with the covariance of its perturbation
  /// on the right: neighbouring keyframes, 0.2 to 2 s apart. Used once the wheels have come that far; left
  /// out if time runs backwards or numbers are not finite.
  void add_motion(TimeNs begin, TimeNs end, const UncertainMotion<double>& T_begin_end) {
    if (end <= begin || !T_begin_end.T.matrix().allFinite() || !T_begin_end.covariance.allFinite()) return;
    waiting_.push_back({begin, end, T_begin_end});
    if (waiting_.size() > 100) waiting_.pop_front();
    compare();
  }

  WheelParameters parameters() const { return {x_[0], x_[1], x_[2]}; }
  double radius_left() const { return x_[0] * geometry_.wheel_radius; }   ///< [m]
  double radius_right() const { return x_[1] * geometry_.wheel_radius; }  ///< [m]
  double offset() const { return x_[3]; }  ///< to add to the stamps of the wheels [s]
  /// Of (scale_left, scale_right, track_width [m], offset [s]).
  const Mat4& covariance() const { return P_; }
  /// Whether the drive so far has told: scale of the left wheel, of the right, track width, offset.
  std::array<bool, 4> observed() const {
    std::array<bool, 4> result{};
    for (int i = 0; i < 4; ++i)
      result[i] = P0_(i, i) > 0 && P_(i, i) < options_.observed_share * options_.observed_share * P0_(i, i);
    return result;
  }
  int used() const { return used_; }          ///< comparisons taken in
  int rejected() const { return rejected_; }  ///< comparisons taken as slip

 private:
  struct Motion {
    TimeNs begin, end;
    UncertainMotion<double> T;
  };

  void compare();
  void compare_with_gyro(TimeNs begin, TimeNs end);
  void compare_with_vision(const Motion& motion);
  void update(double residual, const Vec4& J, double variance);
  double wheel_variance(const WheelRoll& roll) const {
    const double tick = geometry_.metres_per_tick();
    return options_.wheel_noise * options_.wheel_noise * roll.path + tick * tick / 3;
  }

  WheelGeometry geometry_;
  SE3d T_body_base_;
  WheelCalibrationOptions options_;
  WheelTrack track_;
  Vec3<double> gyro_bias_ = Vec3<double>::Zero();
  Vec4 x_;
  Mat4 P_, P0_;
  std::deque<Motion> waiting_;
  std::optional<TimeNs> compared_;  // turns up to here have been compared
  int used_ = 0, rejected_ = 0;
};

inline void WheelCalibrator::compare() {
  const auto wheel = track_.newest_wheel();
  if (!wheel) return;
  const TimeNs ready = *wheel + from_seconds(x_[3]);
  const TimeNs length = from_seconds(options_.gyro_interval);
  if (const auto gyro = track_.newest_gyro()) {
    const TimeNs until = std::min(ready, *gyro);
    if (!compared_) compared_ = until;
    // After a silence it starts again behind it.
    if (until - *compared_ > 20 * length) compared_ = until - length;
    for (; *compared_ + length <= until; *compared_ += length)
      compare_with_gyro(*compared_, *compared_ + length);
  }
  while (!waiting_.empty() && waiting_.front().end <= ready) {
    compare_with_vision(waiting_.front());
    waiting_.pop_front();
  }
}

inline void WheelCalibrator::compare_with_gyro(TimeNs begin, TimeNs end) {
  const double dt = to_seconds(end - begin), walk = options_.scale_walk * options_.scale_walk * dt;
  P_.diagonal().head<2>().array() += options_.difference_sigma > 0 ? walk : 0.0;
  P_(2, 2) += walk * geometry_.track_width * geometry_.track_width;
  const auto roll = track_.roll(begin, end, from_seconds(x_[3]));
  const auto turn = track_.turn(begin, end, gyro_bias_);
  if (!roll || !turn || roll->path < 5 * geometry_.metres_per_tick()) return;
  constexpr double kDegree = 0.017453292519943295;
  const double bias = options_.gyro_bias_sigma * kDegree * dt;
  const double psi = turn->angle;
  update(x_[1] * roll->right - x_[0] * roll->left - x_[2] * psi,
         {-roll->left, roll->right, -psi, x_[1] * roll->right_slope - x_[0] * roll->left_slope},
         x_[2] * x_[2] * (turn->variance + bias * bias) + wheel_variance(*roll));
}

inline void WheelCalibrator::compare_with_vision(const Motion& motion) {
  const auto roll = track_.roll(motion.begin, motion.end, from_seconds(x_[3]));
  if (!roll) return;
  // In the base, as a screw: its length along x is that of the arc.
  const SE3d T_base_body = T_body_base_.inverse();
  const Vec6<double> xi = (T_base_body * motion.T.T * T_body_base_).log();
  const Mat6<double> Ad = T_base_body.adjoint();
  const Mat6<double> P = Ad * motion.T.covariance * Ad.transpose();
  // Lifted, or nonsense: not what a robot does on a floor.
  if (std::abs(xi[1]) + std::abs(xi[2]) > 0.3 * std::abs(xi[0]) + 0.05 || std::hypot(xi[3], xi[4]) > 0.3)
    return;
  update(0.5 * (x_[0] * roll->left + x_[1] * roll->right) - xi[0],
         {0.5 * roll->left, 0.5 * roll->right, 0.0,
          0.5 * (x_[0] * roll->left_slope + x_[1] * roll->right_slope)},
         P(0, 0) + 0.5 * wheel_variance(*roll));
  // The gyro knows turns better.
  if (!track_.newest_gyro())
    update(x_[1] * roll->right - x_[0] * roll->left - x_[2] * xi[5],
           {-roll->left, roll->right, -xi[5], x_[1] * roll->right_slope - x_[0] * roll->left_slope},
           x_[2] * x_[2] * P(5, 5) + wheel_variance(*roll));
}

inline void WheelCalibrator::update(double residual, const Vec4& J, double variance) {
  const Vec4 PJ = P_ * J;
  const double S = J.dot(PJ) + variance;
  if (!(residual * residual <= options_.gate * options_.gate * S)) {
    ++rejected_;
    return;
  }
  ++used_;
  const Vec4 K = PJ / S;
  x_ -= K * residual;
  const Mat4 A = Mat4::Identity() - K * J.transpose();
  P_ = A * P_ * A.transpose() + variance * (K * K.transpose());
  for (int i = 0; i < 2; ++i)
    x_[i] = std::clamp(x_[i], 1 - options_.max_scale_error, 1 + options_.max_scale_error);
  x_[2] = std::clamp(x_[2], geometry_.track_width / options_.max_track_factor,
                     geometry_.track_width * options_.max_track_factor);
  x_[3] = std::clamp(x_[3], -options_.max_offset, options_.max_offset);
}

}  // namespace sweepkit
