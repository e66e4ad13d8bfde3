// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/motion/navigation_filter.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "sweepkit/core/error.hpp"

namespace sweepkit {
namespace {

using State = NavigationState;
using Error20 = Eigen::Matrix<double, State::kSize, 1>;
constexpr double kDegree = std::numbers::pi / 180;
// Standard deviation of what rounding to whole ticks does to a difference of two counts: 1 / sqrt(6).
constexpr double kTickSigma = 0.408;
// After a silence nothing is known of the motion but that robots are slow [m/s, rad/s].
constexpr double kUnseenSpeed = 0.3;
constexpr double kUnseenRate = 1.0;
// How long the last sample of a sensor holds when no other follows [s].
constexpr double kHeld = 0.1;
// Wheels are never as far from their nominal measures.
constexpr double kMostSigmas = 5;

double square(double x) { return x * x; }

/// Two unit vectors across a unit vector.
Eigen::Matrix<double, 3, 2> across(const Vec3<double>& axis) {
  const int smallest = std::abs(axis.x()) < std::abs(axis.y())
                           ? (std::abs(axis.x()) < std::abs(axis.z()) ? 0 : 2)
                           : (std::abs(axis.y()) < std::abs(axis.z()) ? 1 : 2);
  Eigen::Matrix<double, 3, 2> basis;
  basis.col(0) = axis.cross(Vec3<double>::Unit(smallest)).normalized();
  basis.col(1) = axis.cross(basis.col(0));
  return basis;
}

}  // namespace

NavigationFilter::NavigationFilter(const MotionSensors& sensors, const NavigationOptions& options)
    : sensors_(sensors), options_(options) {
  check_options(options_);
  if (!sensors_.wheels) return;
  const WheelGeometry& geometry = sensors_.wheels->geometry;
  require(geometry.track_width > 0, "NavigationFilter track_width", "must be positive", geometry.track_width);
  decoder_.emplace(geometry, options_.decoder);
}

void NavigationFilter::start(TimeNs t, const SE3d& T_world_body,
                             const std::optional<Vec3<double>>& specific_force) {
  state_ = State();
  state_.t = t;
  state_.T_world_body = T_world_body;
  auto& P = state_.covariance;
  P.diagonal().segment<6>(State::kRho).setConstant(1e-12);
  P.diagonal().segment<3>(State::kNu).setConstant(square(options_.start_speed_sigma));
  P.diagonal().segment<3>(State::kGyroBias).setConstant(square(options_.gyro_bias_sigma * kDegree));
  P.diagonal().segment<3>(State::kAccelBias).setConstant(square(options_.accel_bias_sigma));
  P.diagonal().segment<2>(State::kUp).setConstant(square(30 * kDegree));
  P.diagonal().segment<2>(State::kWheels).setConstant(square(options_.radius_sigma));
  P(State::kWheels + 2, State::kWheels + 2) = square(options_.track_sigma);
  if (specific_force && specific_force->norm() > 0.5 * options_.gravity) {
    // up = R (f - bias) / gravity but for what the robot accelerates: its error goes with the bias's.
    const Mat3<double> R = T_world_body.rotation().matrix();
    state_.up = (R * *specific_force).normalized();
    const Eigen::Matrix<double, 2, 3> J = -across(state_.up).transpose() * R / options_.gravity;
    const Mat3<double> bias = P.block<3, 3>(State::kAccelBias, State::kAccelBias);
    const Eigen::Matrix<double, 2, 3> cross = J * bias;
    P.block<2, 2>(State::kUp, State::kUp) =
        cross * J.transpose() +
        square(options_.start_accel_sigma / options_.gravity) * Eigen::Matrix2d::Identity();
    P.block<2, 3>(State::kUp, State::kAccelBias) = cross;
    P.block<3, 2>(State::kAccelBias, State::kUp) = cross.transpose();
  }
  imu_.reset();
  if (sensors_.wheels) decoder_.emplace(sensors_.wheels->geometry, options_.decoder);
  rolled_.reset();
  twist_.setZero();
  held_ = 0;
  velocity_lag_.setZero();
  turned_.setZero();
  since_wheels_ = 0;
  started_ = true;
}

bool NavigationFilter::add(const ImuSample& sample) {
  const double dt = to_seconds(sample.t - state_.t);
  const bool gap = imu_ && to_seconds(sample.t - imu_->t) > options_.max_gap;
  if (!imu_ || gap) {
    // Nothing is known of the way here but its length in time.
    if (gap) {
      advance(sample.t);
      loosen(0, 0, kUnseenSpeed);
    }
    state_.t = std::max(state_.t, sample.t);
  } else if (dt > 0) {
    step_inertial(0.5 * (imu_->gyro + sample.gyro), 0.5 * (imu_->accel + sample.accel), dt);
    state_.t = sample.t;
  }
  imu_ = sample;
  return !gap;
}

bool NavigationFilter::imu_holds(TimeNs t) const { return imu_ && to_seconds(t - imu_->t) < kHeld; }

void NavigationFilter::advance(TimeNs t) {
  const TimeNs held = from_seconds(kHeld);
  if (state_.t < t && imu_holds(state_.t)) {
    const TimeNs to = std::min(t, imu_->t + held);
    step_inertial(imu_->gyro, imu_->accel, to_seconds(to - state_.t));
    state_.t = to;
  }
  if (state_.t < t && rolled_ && state_.t < *rolled_ + held) {
    const TimeNs to = std::min(t, *rolled_ + held);
    const double dt = to_seconds(to - state_.t);
    const Mat6<double> noise = square(options_.wheel_noise) * dt * Mat6<double>::Identity();
    step_twist(twist_, noise, dt, Eigen::Matrix<double, 6, 3>::Zero());
    held_ += dt;
    state_.t = to;
  }
  if (state_.t >= t) return;
  // Nobody speaks: the pose stays, and what is not known of it grows with the silence, in however many steps.
  TimeNs heard = state_.t;
  if (imu_) heard = std::min(heard, imu_->t + held);
  if (rolled_) heard = imu_ ? std::max(heard, std::min(state_.t, *rolled_ + held)) : *rolled_ + held;
  const double share = std::sqrt(square(to_seconds(t - heard)) - square(to_seconds(state_.t - heard)));
  loosen(kUnseenSpeed * share, kUnseenRate * share, kUnseenSpeed * share);
  state_.t = t;
}

// With R' = R dR, v' = v + g dt + R dv, p' = p + v dt + g dt^2 / 2 + R dp for constant rate and force over
// the interval, and errors in the body's axes before and after.
void NavigationFilter::step_inertial(const Vec3<double>& gyro, const Vec3<double>& accel, double dt) {
  const Vec3<double> rate = gyro - state_.gyro_bias, force = accel - state_.accel_bias;
  const Vec3<double> turn = rate * dt;
  const Mat3<double> dR = SO3d::exp(turn).matrix();
  const Vec3<double> dv = SO3d::left_jacobian(turn) * force * dt;
  const Vec3<double> dp = 0.5 * dt * dt * (force + turn.cross(force) / 3.0);
  const Mat3<double> R = state_.T_world_body.rotation().matrix();
  const Vec3<double> g = -options_.gravity * state_.up;
  const Vec3<double> u_before = R.transpose() * state_.velocity;

  const SO3d R_after = state_.T_world_body.rotation() * SO3d::exp(turn);
  state_.T_world_body =
      SE3d(R_after, state_.T_world_body.translation() + state_.velocity * dt + 0.5 * dt * dt * g + R * dp);
  state_.velocity += g * dt + R * dv;

  const Mat3<double> back = dR.transpose();
  const Eigen::Matrix<double, 3, 2> C = -options_.gravity * R_after.matrix().transpose() * across(state_.up);
  Eigen::Matrix<double, 9, State::kSize> F = Eigen::Matrix<double, 9, State::kSize>::Zero();
  F.block<3, 3>(State::kRho, State::kRho) = back;
  F.block<3, 3>(State::kRho, State::kPhi) = -back * SO3d::hat(dp);
  F.block<3, 3>(State::kRho, State::kNu) = back * dt;
  F.block<3, 3>(State::kRho, State::kAccelBias).diagonal().setConstant(-0.5 * dt * dt);
  F.block<3, 2>(State::kRho, State::kUp) = 0.5 * dt * dt * C;
  F.block<3, 3>(State::kPhi, State::kPhi) = back;
  F.block<3, 3>(State::kPhi, State::kGyroBias) = -dt * SO3d::right_jacobian(turn);
  F.block<3, 3>(State::kNu, State::kPhi) = -back * SO3d::hat(dv);
  F.block<3, 3>(State::kNu, State::kNu) = back;
  F.block<3, 3>(State::kNu, State::kAccelBias).diagonal().setConstant(-dt);
  F.block<3, 2>(State::kNu, State::kUp) = dt * C;

  auto& P = state_.covariance;
  const Eigen::Matrix<double, 9, State::kSize> FP = F * P;
  P.topLeftCorner<9, 9>() = FP * F.transpose();
  P.topRightCorner<9, State::kSize - 9>() = FP.rightCols<State::kSize - 9>();
  P.bottomLeftCorner<State::kSize - 9, 9>() = P.topRightCorner<9, State::kSize - 9>().transpose();
  const ImuNoise noise = sensors_.imu ? sensors_.imu->noise : ImuNoise();
  const double factor = square(options_.imu_noise_factor) * dt;
  const double accel_variance = square(noise.accel_noise_density) * factor;
  P.diagonal().segment<3>(State::kRho).array() += accel_variance * dt * dt / 3;
  P.diagonal().segment<3>(State::kPhi).array() += square(noise.gyro_noise_density) * factor;
  P.diagonal().segment<3>(State::kNu).array() += accel_variance;
  P.diagonal().segment<3>(State::kGyroBias).array() += square(noise.gyro_random_walk) * factor;
  P.diagonal().segment<3>(State::kAccelBias).array() += square(noise.accel_random_walk) * factor;
  P.diagonal().segment<2>(State::kUp).array() += square(options_.up_walk * kDegree) * dt;

  const Vec3<double> u_after = R_after.inverse() * state_.velocity;
  velocity_lag_ += (u_before - u_after) * (since_wheels_ + 0.5 * dt);
  turned_ += turn;
  since_wheels_ += dt;
}

void NavigationFilter::step_twist(const Vec6<double>& twist, const Mat6<double>& noise, double dt,
                                  const Eigen::Matrix<double, 6, 3>& J_wheels) {
  const SE3d motion = SE3d::exp(twist * dt);
  state_.T_world_body = state_.T_world_body * motion;
  Eigen::Matrix<double, 6, State::kSize> F = Eigen::Matrix<double, 6, State::kSize>::Zero();
  F.leftCols<6>() = motion.inverse().adjoint();
  F.middleCols<3>(State::kWheels) = J_wheels;
  auto& P = state_.covariance;
  const Eigen::Matrix<double, 6, State::kSize> FP = F * P;
  P.topLeftCorner<6, 6>() = FP * F.transpose() + noise;
  P.topRightCorner<6, State::kSize - 6>() = FP.rightCols<State::kSize - 6>();
  P.bottomLeftCorner<State::kSize - 6, 6>() = P.topRightCorner<6, State::kSize - 6>().transpose();
}

WheelCheck NavigationFilter::add(const WheelSample& sample, bool believe_speeds, bool on_floor) {
  WheelCheck check;
  if (!sensors_.wheels) return check;
  const std::optional<WheelStep> step = decoder_->push(sample);
  const double lag_time = std::exchange(since_wheels_, 0.0);
  const Vec3<double> lag = std::exchange(velocity_lag_, Vec3<double>::Zero());
  const Vec3<double> turned = std::exchange(turned_, Vec3<double>::Zero());
  if (!step) return check;
  rolled_ = sample.t;
  const double dt = step->seconds();
  if (!step->measured || dt > options_.max_gap) {
    advance(sample.t);
    if (!imu_holds(sample.t)) loosen(kUnseenSpeed * dt, kUnseenRate * dt, kUnseenSpeed);
    return check;
  }
  const WheelGeometry& geometry = sensors_.wheels->geometry;
  check.usable = true;
  const double left = check.left_speed = std::exp(state_.wheel_scales[0]) * step->left / dt;
  const double right = check.right_speed = std::exp(state_.wheel_scales[1]) * step->right / dt;
  const double track = std::exp(state_.wheel_scales[2]) * geometry.track_width;
  const double quantum =
      sample.reading == WheelReading::ticks ? kTickSigma * geometry.metres_per_tick() / dt : 0.0;
  const auto variance_of = [&](double speed) {
    return square(options_.wheel_noise) + square(options_.wheel_noise_share * speed) + square(quantum);
  };
  auto& P = state_.covariance;
  if (sensors_.imu && imu_)
    P.diagonal().segment<3>(State::kWheels).array() += square(options_.radius_walk) * dt;

  const SE3d T_base_body = sensors_.wheels->T_body_base.inverse();
  const Mat3<double> R_base_body = T_base_body.rotation().matrix();
  const Vec3<double> p_body_base = sensors_.wheels->T_body_base.translation();

  if (!imu_holds(sample.t)) {
    // The wheels are all there is, or the IMU is silent: they carry the pose on, over the floor as the base
    // sees it.
    const double forward = 0.5 * (left + right), rate = (right - left) / track;
    const Mat6<double> Ad = sensors_.wheels->T_body_base.adjoint();
    Vec6<double> base_twist = Vec6<double>::Zero();
    base_twist[0] = forward;
    base_twist[5] = rate;
    const double held = std::exchange(held_, 0.0);
    if (held > 0) step_twist(-twist_, Mat6<double>::Zero(), held, Eigen::Matrix<double, 6, 3>::Zero());
    twist_ = Ad * base_twist;
    // What the scales do to the motion, and the noise of each speed, counted as independent from sample to
    // sample; tilting stays small.
    Eigen::Matrix<double, 6, 3> J = Eigen::Matrix<double, 6, 3>::Zero();
    J(0, 0) = 0.5 * left;
    J(0, 1) = 0.5 * right;
    J(5, 0) = -left / track;
    J(5, 1) = right / track;
    J(5, 2) = -rate;
    Mat6<double> noise = Mat6<double>::Zero();
    const double vl = variance_of(left), vr = variance_of(right);
    noise(0, 0) = 0.25 * (vl + vr);
    noise(5, 5) = (vl + vr) / square(track);
    noise(0, 5) = noise(5, 0) = 0.5 * (vr - vl) / track;
    noise(1, 1) = square(options_.lateral_noise);
    noise(2, 2) = square(options_.vertical_noise);
    noise(3, 3) = noise(4, 4) = square(options_.vertical_noise / track);
    // What was held since the sample before is replaced by what this one says of that time.
    const double since = to_seconds(sample.t - state_.t) + held;
    if (since <= 0) return check;
    if (!believe_speeds) {
      advance(sample.t);
      loosen(kUnseenSpeed * since, kUnseenRate * since, kUnseenSpeed);
      return check;
    }
    step_twist(twist_, Ad * noise * Ad.transpose() * since * dt, since, Ad * J * since);
    state_.velocity = state_.T_world_body.rotation() * twist_.head<3>();
    if (sensors_.imu) {
      // What the velocity had to do with the rest is over; an IMU that speaks again begins from this one.
      P.middleRows<3>(State::kNu).setZero();
      P.middleCols<3>(State::kNu).setZero();
      P.diagonal().segment<3>(State::kNu).setConstant(square(kUnseenSpeed));
    }
    state_.t = sample.t;
    check.used = true;
    check.forward_speed = forward;
    return check;
  }
  advance(sample.t);
  if (lag_time < 0.5 * dt) {
    check.usable = false;
    return check;
  }

  // Mean velocity and rate over the interval, in the body's axes, as the IMU tells them.
  const Vec3<double> u = state_.T_world_body.rotation().inverse() * state_.velocity + lag / lag_time;
  const Vec3<double> rate = turned / lag_time;
  const Vec3<double> v_base = R_base_body * (u + rate.cross(p_body_base));
  const Vec3<double> yaw_row = R_base_body.row(2);
  const double yaw_rate = yaw_row.dot(rate);
  check.forward_speed = v_base.x();
  check.vertical_speed = v_base.z();

  Eigen::Matrix<double, 3, State::kSize> H_v = Eigen::Matrix<double, 3, State::kSize>::Zero();
  H_v.block<3, 3>(0, State::kNu) = R_base_body;
  H_v.block<3, 3>(0, State::kPhi) = R_base_body * SO3d::hat(u);
  H_v.block<3, 3>(0, State::kGyroBias) = R_base_body * SO3d::hat(p_body_base);
  const auto row_of = [&](double side) {  // of a wheel's predicted minus measured speed; -1 left, 1 right
    Eigen::Matrix<double, 1, State::kSize> row = H_v.row(0);
    row.segment<3>(State::kGyroBias) -= side * 0.5 * track * yaw_row.transpose();
    row[State::kWheels + 2] += side * 0.5 * track * yaw_rate;
    return row;
  };
  Eigen::Matrix<double, 4, State::kSize> H;
  H.row(0) = row_of(-1.0);
  H.row(1) = row_of(1.0);
  // By the speeds as predicted: those measured share their noise with the residual, which would bias the
  // scales.
  const double left_predicted = v_base.x() - 0.5 * track * yaw_rate;
  const double right_predicted = v_base.x() + 0.5 * track * yaw_rate;
  H(0, State::kWheels) -= left_predicted;
  H(1, State::kWheels + 1) -= right_predicted;
  H.row(2) = H_v.row(1);
  H.row(3) = H_v.row(2);
  Eigen::Vector4d residual(left - left_predicted, right - right_predicted, -v_base.y(), -v_base.z());
  // While the base rocks, over a sill say, a wheel's contact runs around its rim, and the base turns about
  // whatever it stands on.
  const double rocking = Vec2<double>((R_base_body * rate).head<2>()).norm();
  const double rim = square(geometry.wheel_radius * rocking),
               lever = square(0.5 * geometry.track_width * rocking);
  const Eigen::Vector4d variance(variance_of(left) + rim, variance_of(right) + rim,
                                 square(options_.lateral_noise) + lever,
                                 square(options_.vertical_noise) + lever);
  Eigen::Matrix4d S = H * P * H.transpose();
  S += variance.asDiagonal();
  check.chi2_speed = residual.head<2>().dot(S.topLeftCorner<2, 2>().ldlt().solve(residual.head<2>()));
  check.chi2_sideways = square(residual[2]) / S(2, 2);
  check.chi2_vertical = square(residual[3]) / S(3, 3);

  check.used = believe_speeds && check.chi2_speed <= options_.wheel_gate;
  // What is not used is given no weight.
  Eigen::Vector4d weighted = variance;
  constexpr double kIgnored = 1e12;
  if (!check.used) weighted.head<2>().setConstant(kIgnored);
  if (!on_floor || check.chi2_sideways > options_.wheel_gate) weighted[2] = kIgnored;
  if (!on_floor || check.chi2_vertical > options_.wheel_gate) weighted[3] = kIgnored;
  if ((weighted.array() < kIgnored).any()) update<4>(H, residual, weighted);
  return check;
}

void NavigationFilter::stand_still(const Vec3<double>& mean_gyro, double seconds) {
  Eigen::Matrix<double, 6, State::kSize> H = Eigen::Matrix<double, 6, State::kSize>::Zero();
  const Vec3<double> u = state_.T_world_body.rotation().inverse() * state_.velocity;
  H.block<3, 3>(0, State::kNu).setIdentity();
  H.block<3, 3>(0, State::kPhi) = SO3d::hat(u);
  H.block<3, 3>(3, State::kGyroBias).setIdentity();
  Vec6<double> residual, variance;
  residual << -u, mean_gyro - state_.gyro_bias;
  const ImuNoise noise = sensors_.imu ? sensors_.imu->noise : ImuNoise();
  variance.head<3>().setConstant(square(options_.stop_noise));
  variance.tail<3>().setConstant(square(options_.imu_noise_factor * noise.gyro_noise_density) /
                                 std::max(seconds, 1e-3));
  if (!sensors_.imu) variance.tail<3>().setConstant(1e12);
  update<6>(H, residual, variance);
  if (!sensors_.imu) twist_.setZero();
}

void NavigationFilter::correct(const SE3d& T_world_body, const Mat6<double>& covariance) {
  constexpr int kRest = State::kSize - 6;
  const Vec6<double> moved = (state_.T_world_body.inverse() * T_world_body).log();
  auto& P = state_.covariance;
  const Mat6<double> prior = P.topLeftCorner<6, 6>();
  // K = P_rest,pose P_pose^-1
  const Eigen::Matrix<double, kRest, 6> K = prior.ldlt().solve(P.topRightCorner<6, kRest>()).transpose();
  Error20 error;
  error << moved, K * moved;
  const Eigen::Matrix<double, 6, kRest> cross = covariance * K.transpose();
  P.bottomRightCorner<kRest, kRest>() += K * (covariance - prior) * K.transpose();
  P.topLeftCorner<6, 6>() = covariance;
  P.topRightCorner<6, kRest>() = cross;
  P.bottomLeftCorner<kRest, 6>() = cross.transpose();
  inject(error);
  state_.T_world_body = T_world_body;
  held_ = 0;
}

void NavigationFilter::move_world(const SE3d& T_new_old) {
  state_.T_world_body = T_new_old * state_.T_world_body;
  state_.velocity = T_new_old.rotation() * state_.velocity;
  set_up(T_new_old.rotation() * state_.up, T_new_old.rotation().matrix());
}

void NavigationFilter::set_up(const Vec3<double>& up, const Mat3<double>& R_new_old) {
  const Eigen::Matrix2d turn = across(up).transpose() * R_new_old * across(state_.up);
  state_.up = up;
  auto& P = state_.covariance;
  P.middleRows<2>(State::kUp) = (turn * P.middleRows<2>(State::kUp)).eval();
  P.middleCols<2>(State::kUp) = (P.middleCols<2>(State::kUp) * turn.transpose()).eval();
}

void NavigationFilter::loosen(double position_sigma, double angle_sigma, double speed_sigma) {
  auto& P = state_.covariance;
  P.diagonal().segment<3>(State::kRho).array() += square(position_sigma);
  P.diagonal().segment<3>(State::kPhi).array() += square(angle_sigma);
  P.diagonal().segment<3>(State::kNu).array() += square(speed_sigma);
}

Vec6<double> NavigationFilter::body_twist() const {
  Vec6<double> twist = twist_;
  if (sensors_.imu) {
    twist.head<3>() = state_.T_world_body.rotation().inverse() * state_.velocity;
    twist.tail<3>().setZero();
    if (imu_) twist.tail<3>() = imu_->gyro - state_.gyro_bias;
  }
  return twist;
}

Vec3<double> NavigationFilter::wheel_measures() const {
  if (!sensors_.wheels) return Vec3<double>::Zero();
  const WheelGeometry& g = sensors_.wheels->geometry;
  return state_.wheel_scales.array().exp() * Eigen::Array3d(g.wheel_radius, g.wheel_radius, g.track_width);
}

template <int Rows>
void NavigationFilter::update(const Eigen::Matrix<double, Rows, State::kSize>& H,
                              const Eigen::Matrix<double, Rows, 1>& residual,
                              const Eigen::Matrix<double, Rows, 1>& variance) {
  auto& P = state_.covariance;
  const Eigen::Matrix<double, State::kSize, Rows> PHt = P * H.transpose();
  Eigen::Matrix<double, Rows, Rows> S = H * PHt;
  S += variance.asDiagonal();
  const Eigen::Matrix<double, State::kSize, Rows> K = S.ldlt().solve(PHt.transpose()).transpose();
  P -= K * PHt.transpose();
  P = (0.5 * (P + P.transpose())).eval();
  inject(K * residual);
}

void NavigationFilter::inject(const Error20& error) {
  state_.velocity += state_.T_world_body.rotation() * error.segment<3>(State::kNu).eval();
  state_.T_world_body = state_.T_world_body * SE3d::exp(error.head<6>());
  state_.gyro_bias += error.segment<3>(State::kGyroBias);
  state_.accel_bias += error.segment<3>(State::kAccelBias);
  const Vec3<double> tilt = across(state_.up) * error.segment<2>(State::kUp);
  const Vec3<double> axis = state_.up.cross(tilt);
  const Mat3<double> R = SO3d::exp(axis).matrix();
  // The axes across the new vertical may be others: see across().
  set_up((R * state_.up).normalized(), R);
  const Vec3<double> most =
      kMostSigmas * Vec3<double>(options_.radius_sigma, options_.radius_sigma, options_.track_sigma);
  state_.wheel_scales =
      (state_.wheel_scales + error.segment<3>(State::kWheels)).cwiseMax(-most).cwiseMin(most);
}

}  // namespace sweepkit
