// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/odometry_bridge.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace sweepkit {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
// Samples before the first image from which the vertical is taken: half a second at 200 Hz.
constexpr std::size_t kEarlySamples = 100;
// Wheels slip when they turn by so much more than the robot moves [m/s]; below it is noise and calibration.
constexpr double kSlipSpeed = 0.03;
constexpr double kUsualImuRate = 200;  // [Hz]
// A gyro's bias is known when it is to this [rad/s].
constexpr double kKnownBias = 0.002;
// A standstill is told to the filter in pieces of this length [ns].
constexpr TimeNs kStandPiece = 300'000'000;
// What a wheel says is doubted back to here, once it is found wrong [ns].
constexpr TimeNs kDoubtBack = 300'000'000;
// Local adjustment moves the robot by less than this [m, rad].
constexpr double kLocalShift = 0.02;
constexpr double kLocalTurn = 0.02;
constexpr TimeNs kFoldAfter = kNsPerSecond;

}  // namespace

OdometryBridge::OdometryBridge(const MotionSensors& sensors, const OdometryBridgeOptions& options)
    : sensors_(sensors), options_(options), filter_(sensors, options.navigation) {
  const WheelGeometry geometry = sensors_.wheels ? sensors_.wheels->geometry : WheelGeometry();
  const SE3d T_body_base = sensors_.wheels ? sensors_.wheels->T_body_base : SE3d();
  if (!usable()) return;
  const ImuNoise noise = sensors_.imu ? sensors_.imu->noise : ImuNoise();
  const double rate = sensors_.imu && sensors_.imu->rate_hz > 0 ? sensors_.imu->rate_hz : kUsualImuRate;
  edges_.emplace(geometry, T_body_base, noise, options_.edges);
  standstill_.emplace(noise, rate, geometry, options_.standstill);
  if (!sensors_.imu) slip_by_vision_.emplace(geometry, T_body_base, noise, options_.slip);
}

SE3d OdometryBridge::start(TimeNs t) {
  std::optional<Vec3<double>> force;
  SO3d R_world_body;
  if (!early_.empty()) {
    Vec3<double> sum = Vec3<double>::Zero();
    for (const ImuSample& sample : early_) sum += sample.accel;
    force = sum / static_cast<double>(early_.size());
    const Vec3<double> up = force->normalized();
    const Vec3<double> ahead = std::abs(up.x()) < 0.98 ? Vec3<double>::UnitX() : Vec3<double>::UnitY();
    Mat3<double> R;  // rows: the world's axes in the body's
    R.row(2) = up;
    R.row(0) = (ahead - up * up.dot(ahead)).normalized();
    R.row(1) = R.row(2).cross(R.row(0));
    R_world_body = SO3d(R);
  }
  const SE3d T_world_body(R_world_body, Vec3<double>::Zero());
  filter_.start(t, T_world_body, force);
  if (!early_.empty()) filter_.add(early_.back());
  early_.clear();
  moved_until_ = t;
  return T_world_body;
}

void OdometryBridge::add(const ImuSample& read) {
  if (!sensors_.imu) return;
  const double most_rate = options_.gyro_range * kDegree, most_force = options_.accel_range;
  ImuSample sample = read;
  sample.gyro = read.gyro.cwiseMax(-most_rate).cwiseMin(most_rate);
  sample.accel = read.accel.cwiseMax(-most_force).cwiseMin(most_force);
  if (edges_) edges_->add(sample);
  if (!filter_.started()) {
    early_.push_back(sample);
    if (early_.size() > kEarlySamples) early_.pop_front();
    return;
  }
  if (!filter_.add(sample))
    events_.push_back(Event(sample.t, "sensor_gap")
                          .with("sensor", "imu")
                          .with("seconds", to_seconds(sample.t - *last_imu_)));
  const bool cut =
      sample.gyro.cwiseAbs().maxCoeff() >= most_rate || sample.accel.cwiseAbs().maxCoeff() >= most_force;
  if (cut && last_imu_) {
    const double dt = to_seconds(sample.t - *last_imu_);
    filter_.loosen(0, most_rate * dt * 0.1, most_force * dt);
  }
  last_imu_ = sample.t;
  standstill_->add(sample);
  if (standing_) {
    gyro_sum_ += sample.gyro;
    ++gyro_count_;
  }
  judge_standstill(sample.t);
}

void OdometryBridge::add(const WheelSample& sample) {
  if (!sensors_.wheels) return;
  if (edges_) edges_->add(sample);
  if (!filter_.started()) return;
  const double dt = last_wheels_ ? to_seconds(sample.t - *last_wheels_) : 0;
  if (dt > options_.navigation.max_gap)
    events_.push_back(Event(sample.t, "sensor_gap").with("sensor", "wheels").with("seconds", dt));
  const TimeNs before = std::exchange(last_wheels_, sample.t).value_or(sample.t);
  standstill_->add(sample);
  if (slip_by_vision_) slip_by_vision_->add(sample);
  if (!sensors_.imu) judge_standstill(sample.t);
  const WheelCheck check = filter_.add(sample, !slipping() && !lifted_, !lifted_);
  if (!check.usable) return;
  judge_wheels(sample.t, check);
  judge_lift(sample.t, dt, check);
  if ((slipping() || lifted_) && edges_) edges_->distrust_wheels(before, sample.t, lifted_);
}

void OdometryBridge::judge_wheels(TimeNs t, const WheelCheck& check) {
  const bool turning = std::max(std::abs(check.left_speed), std::abs(check.right_speed)) > kSlipSpeed;
  if (!sensors_.imu) {
    const bool slips = slip_by_vision_->slipping();
    if (slips && !slipping()) tell_slip(t, check, false);
    slip_since_ = slips ? std::optional(slip_since_.value_or(t)) : std::nullopt;
    return;
  }
  if (check.chi2_speed > options_.navigation.wheel_gate) {
    ++disagreements_;
    agreed_since_ = t;
  } else {
    disagreements_ = 0;
  }
  if (!slipping() && disagreements_ >= options_.disagreements && turning) {
    slip_since_ = t;
    if (edges_) edges_->distrust_wheels(t - kDoubtBack, t);
    tell_slip(t, check, lifted_);
  } else if (slipping() && to_seconds(t - agreed_since_) > options_.agreement) {
    slip_since_.reset();
  }
}

void OdometryBridge::tell_slip(TimeNs t, const WheelCheck& check, bool free) {
  events_.push_back(Event(t, free ? "free_spin" : "slip")
                        .with("left_m_s", check.left_speed)
                        .with("right_m_s", check.right_speed)
                        .with("forward_m_s", check.forward_speed));
}

void OdometryBridge::judge_lift(TimeNs t, double dt, const WheelCheck& check) {
  if (!sensors_.imu) return;
  // How far it went along its own vertical while that cannot be noise; what the floor does to it comes back.
  const bool vertical = check.chi2_vertical > options_.navigation.wheel_gate;
  risen_ = vertical || lifted_ ? risen_ + check.vertical_speed * dt : risen_ * std::exp(-dt / 0.3);
  if (!lifted_) {
    if (risen_ < options_.lift_height && tilt() < options_.lift_tilt * kDegree) return;
    lifted_ = true;
    calm_since_ = t;
    if (edges_) edges_->distrust_wheels(t - kDoubtBack, t, true);
    if (slipping()) tell_slip(t, check, true);
    events_.push_back(Event(t, "lifted").with("risen_m", risen_).with("tilt_deg", tilt() / kDegree));
    return;
  }
  const bool rolls_as_told = check.chi2_speed < options_.navigation.wheel_gate &&
                             check.chi2_vertical < options_.navigation.wheel_gate &&
                             check.chi2_sideways < options_.navigation.wheel_gate &&
                             std::abs(check.left_speed) + std::abs(check.right_speed) > kSlipSpeed;
  const bool upright = tilt() < 0.5 * options_.lift_tilt * kDegree;
  if (!upright || !(standing_ || rolls_as_told)) calm_since_ = t;
  if (to_seconds(t - calm_since_) < options_.put_down_after) return;
  lifted_ = false;
  risen_ = 0;
  events_.push_back(Event(t, "put_down"));
}

void OdometryBridge::judge_standstill(TimeNs t) {
  using Place = NavigationState;
  const auto bias = filter_.state().covariance.diagonal().segment<3>(Place::kGyroBias);
  if (sensors_.imu && bias.maxCoeff() < kKnownBias * kKnownBias)
    standstill_->set_gyro_bias(filter_.state().gyro_bias);
  const bool standing = standstill_->standing();
  if (standing && !standing_) {
    events_.push_back(Event(t, "standstill"));
    stopped_at_ = t;
    gyro_sum_.setZero();
    gyro_count_ = 0;
  }
  standing_ = standing;
  if (!standing || t - stopped_at_ < kStandPiece) return;
  const Vec3<double> mean = gyro_count_ > 0 ? Vec3<double>(gyro_sum_ / gyro_count_) : gyro_sum_;
  filter_.stand_still(mean, to_seconds(t - stopped_at_));
  stopped_at_ = t;
  gyro_sum_.setZero();
  gyro_count_ = 0;
}

double OdometryBridge::tilt() const {
  const NavigationState& state = filter_.state();
  const Vec3<double> up_body = state.T_world_body.rotation().inverse() * state.up;
  const Vec3<double> base_up = sensors_.wheels->T_body_base.rotation() * Vec3<double>::UnitZ();
  return std::acos(std::clamp(up_body.dot(base_up), -1.0, 1.0));
}

void OdometryBridge::correct(const SE3d& T_world_body, const Mat6<double>& covariance) {
  const TimeNs t = filter_.state().t;
  if (slip_by_vision_ && seen_ && seen_->first < t)
    slip_by_vision_->add_motion(seen_->first, t, {seen_->second.inverse() * T_world_body, 2 * covariance});
  seen_ = {t, T_world_body};
  filter_.correct(T_world_body, covariance);
}

void OdometryBridge::advance(TimeNs t) {
  filter_.advance(t);
  // Standing for hours makes no keyframe: samples must not pile up. The newest wait, as wheels are found
  // wrong only after a while.
  if (edges_ && t - moved_until_ > 2 * kFoldAfter) fold_motion(t - kFoldAfter);
}

void OdometryBridge::fold_motion(TimeNs t) {
  if (!edges_ || t <= moved_until_) return;
  const NavigationState& state = filter_.state();
  const double track = sensors_.wheels ? sensors_.wheels->geometry.track_width : 1.0;
  Vec3<double> wheels = state.wheel_scales.array().exp();
  wheels[2] *= track;
  edges_->set_gyro_bias(state.gyro_bias);
  edges_->set_wheels({wheels[0], wheels[1], wheels[2]});
  const OdometryMotion moved = edges_->between(moved_until_, t);
  using Place = NavigationState;
  const Mat3<double> bias = state.covariance.block<3, 3>(Place::kGyroBias, Place::kGyroBias);
  const Mat3<double> scales = wheels.asDiagonal() *
                              state.covariance.block<3, 3>(Place::kWheels, Place::kWheels) *
                              wheels.asDiagonal();
  motion_ = motion_ * UncertainMotion<double>{moved.motion.T, moved.covariance_with(bias, scales)};
  edges_->forget_before(t);
  moved_until_ = t;
}

UncertainMotion<double> OdometryBridge::take_motion() {
  fold_motion(filter_.state().t);
  UncertainMotion<double> motion = std::exchange(motion_, {});
  // A motion without any error would be a tie that nothing can move.
  motion.covariance.diagonal().array() += 1e-9;
  return motion;
}

void OdometryBridge::follow_map(const SE3d& T_new_old) {
  if (seen_) seen_->second = T_new_old * seen_->second;
  const SE3d& T_world_body = filter_.state().T_world_body;
  const SE3d T_corrected = T_new_old * T_world_body;
  const Vec6<double> moved = (T_world_body.inverse() * T_corrected).log();
  const Mat6<double> covariance = filter_.state().pose_covariance();
  if (!lifted_ && moved.head<3>().norm() < kLocalShift && moved.tail<3>().norm() < kLocalTurn)
    filter_.correct(T_corrected, covariance);
  else
    filter_.move_world(T_new_old);
}

void OdometryBridge::move_map(const SE3d& T_new_old) {
  if (seen_) seen_->second = T_new_old * seen_->second;
  filter_.move_world(T_new_old);
}

std::vector<Event> OdometryBridge::take_events() { return std::exchange(events_, {}); }

}  // namespace sweepkit
