// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/motion/slip.hpp"

#include <algorithm>
#include <cmath>

namespace sweepkit {

SlipDetector::SlipDetector(const WheelGeometry& geometry, const SE3d& T_body_base, const ImuNoise& noise,
                           const SlipOptions& options)
    : geometry_(geometry),
      T_body_base_(T_body_base),
      options_(options),
      track_(geometry, T_body_base, noise, options.decoder),
      wheels_(WheelParameters::nominal(geometry)) {
  check_options(options);
}

bool SlipDetector::add(const ImuSample& sample) {
  const bool taken = track_.add(sample);
  if (taken) compare();
  return taken;
}

bool SlipDetector::add(const WheelSample& sample) {
  const bool taken = track_.add(sample);
  if (taken) compare();
  return taken;
}

void SlipDetector::add_motion(TimeNs begin, TimeNs end, const UncertainMotion<double>& T_begin_end) {
  if (end <= begin || !T_begin_end.T.matrix().allFinite() || !T_begin_end.covariance.allFinite()) return;
  waiting_.push_back({begin, end, T_begin_end});
  if (waiting_.size() > 100) waiting_.pop_front();
  compare();
}

void SlipDetector::close(TimeNs end) {
  open_->end = std::max(open_->begin, end);
  if (open_->moved < options_.spin_share * open_->rolled && seen_) open_->kind = SlipEpisode::Kind::free_spin;
  episodes_.push_back(*open_);
  open_.reset();
}

void SlipDetector::compare() {
  const auto wheel = track_.newest_wheel();
  if (!wheel) return;
  const TimeNs length = from_seconds(options_.interval);
  // Vision first: what it has to say is older.
  while (!waiting_.empty() && waiting_.front().end <= *wheel) {
    compare_with_vision(waiting_.front());
    waiting_.pop_front();
  }
  if (const auto gyro = track_.newest_gyro()) {
    const TimeNs until = std::min(*wheel, *gyro);
    if (!compared_) compared_ = until;
    if (until - *compared_ > 50 * length) compared_ = until - length;
    for (; *compared_ + length <= until; *compared_ += length)
      compare_with_gyro(*compared_, *compared_ + length);
  }
}

void SlipDetector::compare_with_gyro(TimeNs begin, TimeNs end) {
  const auto roll = track_.roll(begin, end);
  const auto turn = track_.turn(begin, end, gyro_bias_);
  if (!roll || !turn) return;
  constexpr double kDegree = 0.017453292519943295;
  const double b = wheels_.track_width;
  const double wheels = (wheels_.scale_right * roll->right - wheels_.scale_left * roll->left) / b;
  const double share = options_.turn_share * std::max(std::abs(wheels), 0.1 * roll->path / b);
  const double variance = share * share + std::pow(options_.turn_noise * kDegree, 2) + turn->variance;
  const bool rolls = roll->path > 4 * geometry_.metres_per_tick();
  if (open_) open_->rolled += 0.5 * std::abs(roll->left + roll->right);
  // Wheels at rest cannot slip; a robot that is carried is another matter.
  judge(Test::gyro, begin, end, rolls ? std::pow(wheels - turn->angle, 2) / variance : 0.0, rolls);
}

void SlipDetector::compare_with_vision(const Motion& motion) {
  const auto roll = track_.roll(motion.begin, motion.end);
  if (!roll) return;
  const SE3d T_base_body = T_body_base_.inverse();
  const Vec6<double> xi = (T_base_body * motion.T.T * T_body_base_).log();
  const Mat6<double> Ad = T_base_body.adjoint();
  const Mat6<double> P = Ad * motion.T.covariance * Ad.transpose();
  const double forward = 0.5 * (wheels_.scale_left * roll->left + wheels_.scale_right * roll->right);
  const double share = options_.forward_share * 0.5 * roll->path;
  const double variance = share * share + options_.forward_noise * options_.forward_noise + P(0, 0);
  const bool rolls = roll->path > 4 * geometry_.metres_per_tick();
  if (open_) {
    seen_ = true;
    open_->moved += std::abs(xi[0]);
    if (!track_.newest_gyro()) open_->rolled += std::abs(forward);
  }
  judge(Test::vision, motion.begin, motion.end, rolls ? std::pow(forward - xi[0], 2) / variance : 0.0, rolls);
}

void SlipDetector::judge(Test test, TimeNs begin, TimeNs end, double error, bool rolls) {
  if (!open_) {
    if (error < options_.enter) return;
    open_ = SlipEpisode{.begin = begin, .end = end};
    opened_by_ = test;
    seen_ = false;
    loud_ = rolls_ = end;
  }
  if (error >= options_.leave) {
    // Vision knows both wheels slipping alike, which the gyro does not see.
    if (test == Test::vision && error >= options_.enter) opened_by_ = test;
    if (test == opened_by_) loud_ = std::max(loud_, end);
    open_->worst = std::max(open_->worst, error);
  }
  if (rolls) rolls_ = std::max(rolls_, end);
  open_->end = std::max(open_->end, end);
  const TimeNs calm = from_seconds(options_.calm);
  if (test == opened_by_ && error < options_.leave && end - loud_ >= calm)
    close(loud_);
  else if (end - rolls_ >= calm)
    close(rolls_);
}

}  // namespace sweepkit
