// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "sweepkit/motion/wheel_odometry.hpp"

namespace sweepkit {

/// Errors are kept in the frame that the motion starts in: position p + dp, rotation Exp(dtheta) R. A step
/// then moves them by [I, -[R rho]x; 0, I], which costs cross products only; the frame of the end is taken
/// once.
template <TwistIntegrator I>
struct BasicOdometryIntegrator<I>::Accumulated {
  SE3d T;
  Mat3<double> P_pp = Mat3<double>::Zero(), P_pt = Mat3<double>::Zero(), P_tt = Mat3<double>::Zero();
  // Derivatives of (p, theta) with respect to the gyro's bias and the wheels.
  Mat3<double> p_bias = Mat3<double>::Zero(), t_bias = Mat3<double>::Zero();
  Mat3<double> p_wheels = Mat3<double>::Zero(), t_wheels = Mat3<double>::Zero();
  double unknown_distance = 0.0, unknown_angle = 0.0;

  /// @param noise covariance of xi
  /// @param xi_bias, xi_wheels derivatives of xi
  void append(const Vec6<double>& xi, const Mat6<double>& noise, const Mat3<double>& phi_bias,
              const Eigen::Matrix<double, 6, 3>& xi_wheels) {
    const SE3d step = I::template motion<double>(xi);
    const SE3d next = T * step;
    const Mat3<double> X = SO3d::hat(next.translation() - T.translation());
    P_pp += X * P_tt * X.transpose() - X * P_pt.transpose() - P_pt * X.transpose();
    P_pt -= X * P_tt;
    p_bias -= X * t_bias;
    p_wheels -= X * t_wheels;

    const Mat6<double> J = I::template jacobian<double>(xi);
    const Mat3<double> R = next.rotation().matrix();
    Eigen::Matrix<double, 3, 6> J_p = R * J.template topRows<3>(), J_t = R * J.template bottomRows<3>();
    const Eigen::Matrix<double, 6, 3> noise_t = noise * J_t.transpose();
    P_pp += J_p * noise * J_p.transpose();
    P_pt += J_p * noise_t;
    P_tt += J_t * noise_t;
    p_bias += J_p.template rightCols<3>() * phi_bias;
    t_bias += J_t.template rightCols<3>() * phi_bias;
    p_wheels += J_p * xi_wheels;
    t_wheels += J_t * xi_wheels;
    T = next;
  }
};

template <TwistIntegrator I>
BasicOdometryIntegrator<I>::BasicOdometryIntegrator(const WheelGeometry& geometry, const SE3d& T_body_base,
                                                    const ImuNoise& noise, const OdometryOptions& options,
                                                    TimeNs wheel_offset)
    : geometry_(geometry),
      T_body_base_(T_body_base),
      noise_(noise),
      options_(options),
      wheel_offset_(wheel_offset),
      decoder_(geometry, options.decoder) {
  check_options(options);
  set_wheels(WheelParameters::nominal(geometry));
}

template <TwistIntegrator I>
bool BasicOdometryIntegrator<I>::add(const ImuSample& sample) {
  if (!sample.gyro.allFinite() || (!gyro_.empty() && sample.t <= gyro_.back().t)) return false;
  gyro_.push_back(sample);
  return true;
}

template <TwistIntegrator I>
bool BasicOdometryIntegrator<I>::add(const WheelSample& sample) {
  const std::size_t refused = decoder_.refused();
  WheelSample moved = sample;
  moved.t += wheel_offset_;
  if (const auto step = decoder_.push(moved)) steps_.push_back(*step);
  return decoder_.refused() == refused;
}

template <TwistIntegrator I>
void BasicOdometryIntegrator<I>::set_wheels(const WheelParameters& wheels) {
  const Vec3<double> v = wheels.vector();
  require(v.allFinite() && v.minCoeff() > 0, "set_wheels wheels", "must be positive", v.transpose());
  wheels_ = wheels;
}

template <TwistIntegrator I>
std::optional<TimeNs> BasicOdometryIntegrator<I>::covered_until() const {
  if (gyro_.empty() && steps_.empty()) return std::nullopt;
  if (gyro_.empty()) return steps_.back().end;
  if (steps_.empty()) return gyro_.back().t;
  return std::min(gyro_.back().t, steps_.back().end);
}

template <TwistIntegrator I>
void BasicOdometryIntegrator<I>::forget_before(TimeNs t) {
  // Removed in lumps, so that each sample is moved a bounded number of times.
  const auto unneeded = std::upper_bound(gyro_.begin(), gyro_.end(), t,
                                         [](TimeNs time, const ImuSample& s) { return time < s.t; });
  const auto keep = unneeded - gyro_.begin() - 1;
  if (keep > 256 || keep > static_cast<std::ptrdiff_t>(gyro_.size() / 2))
    gyro_.erase(gyro_.begin(), gyro_.begin() + std::max<std::ptrdiff_t>(keep, 0));
  auto step =
      std::partition_point(steps_.begin(), steps_.end(), [&](const WheelStep& s) { return s.end <= t; });
  // The newest step is what a held speed comes from.
  if (step == steps_.end() && !steps_.empty()) --step;
  if (step - steps_.begin() > 128 || step - steps_.begin() > static_cast<std::ptrdiff_t>(steps_.size() / 2))
    steps_.erase(steps_.begin(), step);
  std::erase_if(distrusted_, [&](const Span& s) { return s.to <= t; });
}

template <TwistIntegrator I>
auto BasicOdometryIntegrator<I>::trust(TimeNs a, TimeNs b) const -> Trust {
  Trust trust = Trust::full;
  for (const Span& s : distrusted_)
    if (s.from < b && s.to > a) trust = std::max(trust, s.in_the_air ? Trust::in_the_air : Trust::slipping);
  return trust;
}

template <TwistIntegrator I>
TimeNs BasicOdometryIntegrator<I>::next_break(TimeNs t, TimeNs to, std::size_t gyro, std::size_t step) const {
  TimeNs next = to;
  if (gyro < gyro_.size() && gyro_[gyro].t > t) next = std::min(next, gyro_[gyro].t);
  if (gyro + 1 < gyro_.size()) next = std::min(next, gyro_[gyro + 1].t);
  if (step < steps_.size())
    next = std::min(next, steps_[step].begin > t ? steps_[step].begin : steps_[step].end);
  return next;
}

template <TwistIntegrator I>
typename BasicOdometryIntegrator<I>::GyroRate BasicOdometryIntegrator<I>::gyro_rate(std::size_t k, TimeNs a,
                                                                                    TimeNs b) const {
  GyroRate rate;
  if (gyro_.empty() || gyro_[k].t > a) return rate;
  if (k + 1 == gyro_.size()) {
    rate.held = to_seconds(b - gyro_[k].t);
    rate.known = rate.held <= options_.hold;
    rate.rate = gyro_[k].gyro - gyro_bias_;
    return rate;
  }
  const TimeNs gap = gyro_[k + 1].t - gyro_[k].t;
  if (gap > from_seconds(options_.max_gap)) return rate;
  const double s = (0.5 * to_seconds(a - gyro_[k].t) + 0.5 * to_seconds(b - gyro_[k].t)) / to_seconds(gap);
  rate.rate = (1 - s) * gyro_[k].gyro + s * gyro_[k + 1].gyro - gyro_bias_;
  rate.known = true;
  return rate;
}

template <TwistIntegrator I>
void BasicOdometryIntegrator<I>::add_piece(Accumulated& sum, TimeNs a, TimeNs b, const GyroRate& gyro,
                                           std::size_t step) const {
  const double dt = to_seconds(b - a);
  Vec6<double> xi = Vec6<double>::Zero();
  Mat6<double> noise = Mat6<double>::Zero();
  Mat3<double> phi_bias = Mat3<double>::Zero();
  Eigen::Matrix<double, 6, 3> xi_wheels = Eigen::Matrix<double, 6, 3>::Zero();

  // The wheels over this piece: a part of a step, or the newest one held.
  std::optional<PlanarStep> wheels;
  double held_wheels = 0.0;
  if (step < steps_.size() && steps_[step].begin <= a) {
    if (steps_[step].measured) {
      wheels = planar_step(steps_[step], wheels_);
      const double part = to_seconds(b - a) / steps_[step].seconds();
      wheels->forward *= part;
      wheels->turn *= part;
      wheels->d_forward *= part;
      wheels->d_turn *= part;
    }
  } else if (step == steps_.size() && !steps_.empty() && steps_.back().measured) {
    held_wheels = to_seconds(b - steps_.back().end);
    if (held_wheels <= options_.hold) {
      const double part = dt / steps_.back().seconds();
      wheels = planar_step(steps_.back(), wheels_);
      wheels->forward *= part;
      wheels->turn *= part;
      wheels->d_forward *= part;
      wheels->d_turn *= part;
    }
  }
  const Trust trust = this->trust(a, b);
  const bool trusted = wheels && trust == Trust::full;
  if (trusted) {
    const double distance = std::abs(wheels->forward), turn = std::abs(wheels->turn);
    const double rolled = distance + 0.5 * wheels_.track_width * turn;
    const double wheel = options_.wheel_noise * options_.wheel_noise * rolled;
    const double lateral = options_.lateral_noise * options_.lateral_noise * rolled;
    xi[0] = wheels->forward;
    noise(0, 0) = 0.5 * wheel;
    noise(1, 1) = noise(2, 2) = lateral;
    xi_wheels.row(0) = wheels->d_forward;
    if (!gyro.known) {
      xi[5] = wheels->turn;
      noise(5, 5) = 2 * wheel / (wheels_.track_width * wheels_.track_width);
      noise(3, 3) = noise(4, 4) = options_.tilt_noise * options_.tilt_noise * rolled;
      xi_wheels.row(5) = wheels->d_turn;
    }
    // The error of a held rate grows with its age: integrated from a to b.
    sum.unknown_distance += held_wheels > 0 ? options_.max_acceleration * dt * (held_wheels - 0.5 * dt) : 0.0;
    // Ticks tell how far over a hole, but not when.
    if (held_wheels == 0 && steps_[step].seconds() > options_.decoder.max_gap)
      sum.unknown_distance += 0.25 * distance;
  } else {
    // Slipping wheels turn faster than the robot moves, not slower.
    sum.unknown_distance +=
        wheels && trust == Trust::slipping ? std::abs(wheels->forward) : options_.unknown_speed * dt;
  }
  if (gyro.known) {
    const Mat3<double> R_base_body = T_body_base_.rotation().inverse().matrix();
    xi.tail<3>() = R_base_body * gyro.rate * dt;
    phi_bias = -R_base_body * dt;
    noise.bottomRightCorner<3, 3>().diagonal().setConstant(noise_.gyro_noise_density *
                                                           noise_.gyro_noise_density * dt);
    sum.unknown_angle += gyro.held > 0 ? options_.max_turn_acceleration * dt * (gyro.held - 0.5 * dt) : 0.0;
  } else if (!trusted) {
    sum.unknown_angle += options_.unknown_rate * dt;
  }
  sum.append(xi, noise, phi_bias, xi_wheels);
}

template <TwistIntegrator I>
OdometryMotion BasicOdometryIntegrator<I>::between(TimeNs from, TimeNs to) const {
  require(from <= to, "OdometryIntegrator::between to", "must not lie before from [ns]", to - from);
  OdometryMotion result;
  result.begin = from;
  result.end = to;
  const auto newer = std::upper_bound(gyro_.begin(), gyro_.end(), from,
                                      [](TimeNs time, const ImuSample& s) { return time < s.t; });
  std::size_t gyro = newer == gyro_.begin() ? 0 : static_cast<std::size_t>(newer - gyro_.begin()) - 1;
  auto step = static_cast<std::size_t>(
      std::partition_point(steps_.begin(), steps_.end(), [&](const WheelStep& s) { return s.end <= from; }) -
      steps_.begin());

  Accumulated sum;
  for (TimeNs t = from; t < to;) {
    const TimeNs next = next_break(t, to, gyro, step);
    const GyroRate rate = gyro_rate(gyro, t, next);
    const double dt = to_seconds(next - t);
    const bool wheels = step < steps_.size() && steps_[step].begin <= t && steps_[step].measured;
    if (!rate.known || rate.held > 0) result.without_gyro += dt;
    if (!wheels || trust(t, next) != Trust::full) result.without_wheels += dt;
    const SE3d before = sum.T;
    add_piece(sum, t, next, rate, step);
    const SE3d moved = before.inverse() * sum.T;
    result.rolled += moved.translation().norm();
    result.turned += 2 * std::asin(std::min(1.0, moved.rotation().quaternion().vec().norm()));
    t = next;
    while (gyro + 1 < gyro_.size() && gyro_[gyro + 1].t <= t) ++gyro;
    while (step < steps_.size() && steps_[step].end <= t) ++step;
  }

  // Half a tick is hidden at either end.
  const double hidden = steps_.empty() ? 0.0 : geometry_.metres_per_tick();
  const double distance = sum.unknown_distance;
  sum.P_pp.diagonal().array() += distance * distance + hidden * hidden / 12.0;
  sum.P_tt.diagonal().array() += sum.unknown_angle * sum.unknown_angle;

  // From the frame of the start to that of the end, from the base to the body.
  Mat6<double> P;
  P << sum.P_pp, sum.P_pt, sum.P_pt.transpose(), sum.P_tt;
  Eigen::Matrix<double, 6, 3> bias, wheels;
  bias << sum.p_bias, sum.t_bias;
  wheels << sum.p_wheels, sum.t_wheels;
  const Mat3<double> back = sum.T.rotation().inverse().matrix();
  Mat6<double> A = Mat6<double>::Zero();
  A.topLeftCorner<3, 3>() = back;
  A.bottomRightCorner<3, 3>() = back;
  A = T_body_base_.adjoint() * A;
  result.motion.T = T_body_base_ * sum.T * T_body_base_.inverse();
  result.motion.covariance = A * P * A.transpose();
  result.d_gyro_bias = A * bias;
  result.d_wheels = A * wheels;
  return result;
}

}  // namespace sweepkit
