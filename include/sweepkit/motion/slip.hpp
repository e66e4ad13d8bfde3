// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <deque>
#include <optional>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/motion/wheel_odometry.hpp"
#include "sweepkit/motion/wheel_track.hpp"

namespace sweepkit {

struct SlipOptions {
  double interval = 0.2;
  double enter = 25.0;
  double leave = 6.6;
  double calm = 0.4;
  double turn_share = 0.05;
  double turn_noise = 0.4;
  double forward_share = 0.04;
  double forward_noise = 0.003;
  double spin_share = 0.3;
  WheelDecoderOptions decoder;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(interval, "interval", "s", range(0.02, 5.0), "length of the turns compared with the gyro's");
    v(enter, "enter", "", range(1.0, 1e6), "squared error over its variance at which slip begins");
    v(leave, "leave", "", range(0.1, 1e6), "below which it is calm");
    v(calm, "calm", "s", range(0.0, 10.0), "how long it must be calm for slip to end");
    v(turn_share, "turn_share", "", range(0.0, 1.0), "error of a turn by the wheels, as a share");
    v(turn_noise, "turn_noise", "deg", range(1e-3, 90.0), "and whatever its size");
    v(forward_share, "forward_share", "", range(0.0, 1.0), "error of a distance by the wheels, as a share");
    v(forward_noise, "forward_noise", "m", range(1e-5, 1.0), "and whatever its size");
    v(spin_share, "spin_share", "", range(0.0, 1.0),
      "slip in which the robot moves less than that share of what the wheels roll is free spin");
    v.group(decoder, "decoder", "from wheel samples to distances");
  }
};

/// A time in which the wheels did not do what the robot did.
struct SlipEpisode {
  enum class Kind {
    slip,       ///< wheels and floor disagree
    free_spin,  ///< the wheels turn and the robot hardly moves, or hangs in the air
  };
  TimeNs begin = 0;
  TimeNs end = 0;
  Kind kind = Kind::slip;
  double rolled = 0.0;  ///< distance of the base by the wheels [m]
  double moved = 0.0;   ///< by vision, as far as it saw [m]
  double worst = 0.0;   ///< largest squared error over its variance
};

/// Notices slip from the wheels' turn against the gyro's, and their distance and turn against vision, each by
/// a chi-square test of one interval, with hysteresis: it begins with one error above `enter` and ends when
/// the test that began it has been below `leave` for `calm`, or the wheels rest that long. The wheels' own
/// error is taken as a share, which radii and track that are not calibrated explain. Not thread-safe.
class SlipDetector {
 public:
  SlipDetector(const WheelGeometry& geometry, const SE3d& T_body_base, const ImuNoise& noise = {},
               const SlipOptions& options = {})
      : geometry_(geometry),
        T_body_base_(T_body_base),
        options_(options),
        track_(geometry, T_body_base, noise, options.decoder),
        wheels_(WheelParameters::nominal(geometry)) {
    check_options(options);
  }

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
  /// The motion of the body by vision, between images some 0.1 to 1 s apart.
  void add_motion(TimeNs begin, TimeNs end, const UncertainMotion<double>& T_begin_end) {
    if (end <= begin || !T_begin_end.T.matrix().allFinite() || !T_begin_end.covariance.allFinite()) return;
    waiting_.push_back({begin, end, T_begin_end});
    if (waiting_.size() > 100) waiting_.pop_front();
    compare();
  }
  void set_gyro_bias(const Vec3<double>& bias) { gyro_bias_ = bias; }
  void set_wheels(const WheelParameters& wheels) { wheels_ = wheels; }

  bool slipping() const { return open_.has_value(); }
  /// The one that lasts; nothing while there is none.
  const std::optional<SlipEpisode>& current() const { return open_; }
  /// Those that are over, in order of time.
  const std::vector<SlipEpisode>& episodes() const { return episodes_; }

 private:
  struct Motion {
    TimeNs begin, end;
    UncertainMotion<double> T;
  };
  enum class Test { gyro, vision };

  void compare();
  void compare_with_gyro(TimeNs begin, TimeNs end);
  void compare_with_vision(const Motion& motion);
  void judge(Test test, TimeNs begin, TimeNs end, double error, bool rolls);
  void close(TimeNs end) {
    open_->end = std::max(open_->begin, end);
    if (open_->moved < options_.spin_share * open_->rolled && seen_)
      open_->kind = SlipEpisode::Kind::free_spin;
    episodes_.push_back(*open_);
    open_.reset();
  }

  WheelGeometry geometry_;
  SE3d T_body_base_;
  SlipOptions options_;
  WheelTrack track_;
  WheelParameters wheels_;
  Vec3<double> gyro_bias_ = Vec3<double>::Zero();
  std::deque<Motion> waiting_;
  std::optional<TimeNs> compared_;
  std::optional<SlipEpisode> open_;
  std::vector<SlipEpisode> episodes_;
  Test opened_by_ = Test::gyro;
  bool seen_ = false;            // vision has looked during the open episode
  TimeNs loud_ = 0, rolls_ = 0;  // when the test that opened it last failed, when wheels last rolled
};

inline void SlipDetector::compare() {
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

inline void SlipDetector::compare_with_gyro(TimeNs begin, TimeNs end) {
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

inline void SlipDetector::compare_with_vision(const Motion& motion) {
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

inline void SlipDetector::judge(Test test, TimeNs begin, TimeNs end, double error, bool rolls) {
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
