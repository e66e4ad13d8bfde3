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
// What a wheel says is doubted back to here, once it is found wrong [ns].
constexpr TimeNs kDoubtBack = 300'000'000;
constexpr TimeNs kFoldAfter = kNsPerSecond;

}  // namespace

OdometryBridge::OdometryBridge(const MotionSensors& sensors, const OdometryBridgeOptions& options)
    : sensors_(sensors), options_(options), filter_(sensors, options.navigation) {
  const WheelGeometry geometry = sensors_.wheels ? sensors_.wheels->geometry : WheelGeometry();
  const SE3d T_body_base = sensors_.wheels ? sensors_.wheels->T_body_base : SE3d();
  if (usable())
    edges_.emplace(geometry, T_body_base, sensors_.imu ? sensors_.imu->noise : ImuNoise(), options_.edges);
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

void OdometryBridge::add(const ImuSample& sample) {
  if (!sensors_.imu) return;
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
  const bool cut = sample.gyro.cwiseAbs().maxCoeff() >= options_.gyro_range * kDegree ||
                   sample.accel.cwiseAbs().maxCoeff() >= options_.accel_range;
  if (cut && last_imu_) {
    const double dt = to_seconds(sample.t - *last_imu_);
    filter_.loosen(0, options_.gyro_range * kDegree * dt * 0.1, options_.accel_range * dt);
  }
  last_imu_ = sample.t;
  window_.push_back(sample);
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
  const WheelCheck check = filter_.add(sample, !slipping() && !lifted_, !lifted_);
  if (!check.usable) return;
  if (std::max(std::abs(check.left_speed), std::abs(check.right_speed)) > 1e-9) rolled_at_ = sample.t;
  judge_wheels(sample.t, check);
  judge_lift(sample.t, dt, check);
  if ((slipping() || lifted_) && edges_) edges_->distrust_wheels(before, sample.t);
}

void OdometryBridge::judge_wheels(TimeNs t, const WheelCheck& check) {
  if (!sensors_.imu) return;
  const double rolled = 0.5 * (check.left_speed + check.right_speed);
  const bool wrong = check.chi2_speed > options_.navigation.wheel_gate;
  if (wrong) {
    ++disagreements_;
    agreed_since_ = t;
  } else {
    disagreements_ = 0;
  }
  if (!slipping() && disagreements_ >= options_.disagreements &&
      std::max(std::abs(check.left_speed), std::abs(check.right_speed)) > kSlipSpeed) {
    slip_since_ = t;
    if (edges_) edges_->distrust_wheels(t - kDoubtBack, t);
    events_.push_back(Event(t, lifted_ ? "free_spin" : "slip")
                          .with("left_m_s", check.left_speed)
                          .with("right_m_s", check.right_speed)
                          .with("forward_m_s", check.forward_speed)
                          .with("rolled_m_s", rolled));
  } else if (slipping() && to_seconds(t - agreed_since_) > options_.agreement) {
    slip_since_.reset();
  }
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
    if (edges_) edges_->distrust_wheels(t - kDoubtBack, t);
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
  while (window_.size() > 1 && to_seconds(t - window_.front().t) > 0.25) window_.pop_front();
  const double seconds = to_seconds(t - window_.front().t);
  if (seconds < 0.2 || window_.size() < 10) return;
  Vec3<double> g = Vec3<double>::Zero(), a = g, gg = g, aa = g;
  for (const ImuSample& s : window_) {
    g += s.gyro;
    a += s.accel;
    gg += s.gyro.cwiseAbs2();
    aa += s.accel.cwiseAbs2();
  }
  const double n = static_cast<double>(window_.size());
  const bool still = std::sqrt((gg / n - (g / n).cwiseAbs2()).maxCoeff()) < 0.01 &&
                     std::sqrt((aa / n - (a / n).cwiseAbs2()).maxCoeff()) < 0.1 &&
                     (!sensors_.wheels || to_seconds(t - rolled_at_) > 0.25);
  if (still && !standing_) events_.push_back(Event(t, "standstill"));
  if (still && (!standing_ || to_seconds(t - stopped_at_) > 0.25)) {
    filter_.stand_still(g / n, seconds);
    stopped_at_ = t;
  }
  standing_ = still;
}

double OdometryBridge::tilt() const {
  const NavigationState& state = filter_.state();
  const Vec3<double> up_body = state.T_world_body.rotation().inverse() * state.up;
  const Vec3<double> base_up = sensors_.wheels->T_body_base.rotation() * Vec3<double>::UnitZ();
  return std::acos(std::clamp(up_body.dot(base_up), -1.0, 1.0));
}

void OdometryBridge::correct(const SE3d& T_world_body, const Mat6<double>& covariance) {
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
  using Place = NavigationState::Place;
  const Mat3<double> bias = state.covariance.block<3, 3>(Place::kGyroBias, Place::kGyroBias);
  const Mat3<double> scales = wheels.asDiagonal() * state.covariance.block<3, 3>(Place::kWheels, Place::kWheels) *
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

std::vector<Event> OdometryBridge::take_events() { return std::exchange(events_, {}); }

}  // namespace sweepkit
