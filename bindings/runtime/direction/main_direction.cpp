// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/direction/main_direction.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "sweepkit/core/random.hpp"

namespace sweepkit {

namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kQuarter = std::numbers::pi / 2;
constexpr double kSteepest = 0.17;  // sine of the least angle between the viewing axis and the vertical
constexpr double kWellKnown = 0.3 * kDegree;  // of a drift [rad/s]
constexpr std::size_t kMostPairs = 2000;      // of directions that are tried

}  // namespace

double wrap_quarter_turn(double angle) {
  const double wrapped = std::remainder(angle, kQuarter);
  return wrapped <= -kQuarter / 2 ? wrapped + kQuarter : wrapped;
}

FrameDirectionFinder::FrameDirectionFinder(const StereoRig& rig, const MainDirectionOptions& options)
    : rig_(rig), options_(options), estimator_(options.manhattan) {
  check_options(options_);
}

FrameDirection FrameDirectionFinder::find(TimeNs t, std::span<const LineSegment> left,
                                          std::span<const LineSegment> right, const SO3d& R_world_body,
                                          const YawDrift& drift) {
  const SO3d R_body_left = rig_.T_body_raw(Side::left).rotation();
  const SO3d R_world_left = R_world_body * R_body_left;
  const Vec3<double> forward = R_world_left * Vec3<double>::UnitZ();
  FrameDirection result;
  result.t = t;
  result.drift = drift;
  labels_[0].assign(left.size(), -1);
  labels_[1].assign(right.size(), -1);
  result.yaw = std::atan2(forward.y(), forward.x());
  if (!(std::hypot(forward.x(), forward.y()) > kSteepest)) return result;
  const Vec3<double> up = R_world_left.inverse() * Vec3<double>::UnitZ();

  for (const Side side : {Side::left, Side::right}) {
    const SO3d R_left_camera = R_body_left.inverse() * rig_.T_body_raw(side).rotation();
    interpretation_planes(rig_.camera(side), side == Side::left ? left : right, options_.manhattan.segments,
                          planes_, R_left_camera);
    const auto frame = estimator_.estimate(planes_, up);
    for (std::size_t i = 0; i < planes_.size(); ++i)
      labels_[static_cast<int>(side)][planes_[i].segment] = estimator_.labels()[i];
    if (!frame) continue;
    const Vec3<double> axis = R_world_left * (frame->R_camera_manhattan * Vec3<double>::UnitZ());
    CameraDirection& camera = side == Side::left ? result.left : result.right;
    camera.found = true;
    camera.angle = wrap_quarter_turn(std::atan2(axis.y(), axis.x()) - result.yaw);
    camera.sigma = std::sqrt(frame->covariance.trace());
    camera.confidence = frame->confidence;
    camera.support = frame->support[0] + frame->support[2];
  }
  return result;
}

std::optional<double> agreed_direction(const FrameDirection& frame, const MainDirectionOptions& options) {
  const CameraDirection &l = frame.left, &r = frame.right;
  if (!l.found || !r.found) return std::nullopt;
  if (l.confidence < options.min_frame_confidence || r.confidence < options.min_frame_confidence)
    return std::nullopt;
  const double apart = wrap_quarter_turn(r.angle - l.angle);
  if (std::abs(apart) > options.stereo_tolerance * kDegree) return std::nullopt;
  const double l2 = l.sigma * l.sigma, r2 = r.sigma * r.sigma;
  return wrap_quarter_turn(l.angle + (l2 + r2 > 0 ? l2 / (l2 + r2) : 0.5) * apart);
}

MainDirectionWindow::MainDirectionWindow(const MainDirectionOptions& options) : options_(options) {
  check_options(options_);
}

std::optional<MainDirection> MainDirectionWindow::add(const FrameDirection& frame) {
  if (!run_first_) run_first_ = frame;
  if (frames_ == 0) {
    first_ = frame;
    collected_.clear();
  }
  last_ = frame;
  ++frames_;
  if (const auto angle = agreed_direction(frame, options_))
    collected_.push_back({to_seconds(frame.t - first_.t), *angle + frame.yaw - first_.yaw});
  return frames_ < options_.window ? std::nullopt : close();
}

double MainDirectionWindow::residual(const Collected& c, const Line& line) const {
  return wrap_quarter_turn(c.angle - line.angle - line.drift * c.seconds);
}

MainDirectionWindow::Line MainDirectionWindow::consensus(const YawDrift& drift) const {
  const double tolerance = options_.inlier_tolerance * kDegree;
  Line best;
  double best_score = -1;
  const auto try_line = [&](const Line& line) {
    double score = 0;
    for (const Collected& c : collected_) {
      const double off = residual(c, line) / tolerance;
      score += std::max(0.0, 1 - off * off);
    }
    if (score > best_score) {
      best_score = score;
      best = line;
    }
  };
  for (const Collected& c : collected_) try_line({c.angle - drift.rate * c.seconds, drift.rate});
  // What is only guessed at is no limit.
  const double most = options_.max_drift * kDegree;
  const double reach = drift.sigma < kWellKnown ? std::min(3 * drift.sigma, most) : most;
  const double span = collected_.empty() ? 0 : collected_.back().seconds;
  if (reach * span < 0.5 * tolerance) return best;

  const auto try_pair = [&](const Collected& a, const Collected& b) {
    const double seconds = b.seconds - a.seconds;
    if (seconds < 0.3 * span) return;
    // Of the drifts alike modulo a quarter turn the one nearest to what is known.
    const double off = wrap_quarter_turn(b.angle - a.angle - drift.rate * seconds) / seconds;
    if (std::abs(off) > reach) return;
    const double rate = drift.rate + off;
    try_line({a.angle - rate * a.seconds, rate});
  };
  const std::size_t size = collected_.size();
  if (size * (size - 1) / 2 <= kMostPairs) {
    for (std::size_t i = 0; i < size; ++i)
      for (std::size_t j = i + 1; j < size; ++j) try_pair(collected_[i], collected_[j]);
  } else {
    Random random(static_cast<std::uint64_t>(options_.manhattan.seed));
    for (std::size_t k = 0; k < kMostPairs; ++k) {
      const std::size_t i = random.index(size), j = random.index(size);
      try_pair(collected_[std::min(i, j)], collected_[std::max(i, j)]);
    }
  }
  return best;
}

void MainDirectionWindow::fit(Line& line, const YawDrift& drift, MainDirection& result) const {
  const double tolerance = options_.inlier_tolerance * kDegree;
  // What is known of the drift counts as one more measurement, against directions of this standard deviation:
  // more than they scatter, since those of one view are wrong together.
  constexpr double kDirectionSigma = 0.6 * kDegree;
  for (int round = 0; round < 3; ++round) {
    Eigen::Matrix2d H = Eigen::Matrix2d::Zero();
    Eigen::Vector2d g = Eigen::Vector2d::Zero();
    double squares = 0;
    result.inliers = 0;
    for (const Collected& c : collected_) {
      const double off = residual(c, line);
      if (std::abs(off) > tolerance) continue;
      const Eigen::Vector2d row(1, c.seconds);
      H += row * row.transpose();
      g += row * off;
      squares += off * off;
      ++result.inliers;
    }
    if (result.inliers == 0) return;
    const double sigma = std::max(drift.sigma, 1e-6);
    const double trust = kDirectionSigma * kDirectionSigma / (sigma * sigma);
    H(1, 1) += trust;
    g(1) += trust * (drift.rate - line.drift);
    const Eigen::Matrix2d covariance = H.inverse();
    const Eigen::Vector2d step = covariance * g;
    line.angle += step(0);
    line.drift += step(1);
    result.sigma =
        std::sqrt(covariance(0, 0) * std::max(squares / result.inliers, kDirectionSigma * kDirectionSigma));
  }
}

std::optional<MainDirection> MainDirectionWindow::close() {
  MainDirection result;
  result.frames = frames_;
  result.collected = static_cast<int>(collected_.size());
  frames_ = 0;
  // At its end the window knows its drift best.
  const YawDrift& drift = last_.drift;
  Line line = consensus(drift);
  fit(line, drift, result);
  const bool enough = result.collected > 0 &&
                      result.collected >= options_.min_collected_share * result.frames &&
                      result.sigma <= options_.max_sigma * kDegree;
  result.confidence = result.collected > 0 ? static_cast<double>(result.inliers) / result.collected : 0.0;
  last_confidence_ = enough ? result.confidence : 0.0;
  if (!enough || result.confidence < options_.threshold) {
    ++restarts_;
    return std::nullopt;
  }
  result.window_begin = first_.t;
  result.window_end = last_.t;
  result.angle = wrap_quarter_turn(line.angle);
  result.drift = line.drift;
  result.run_begin = run_first_->t;
  const double turned = first_.yaw - run_first_->yaw - line.drift * to_seconds(first_.t - run_first_->t);
  result.run_angle = wrap_quarter_turn(line.angle + turned);
  return result;
}

std::optional<MainDirection> first_main_direction(std::span<const FrameDirection> frames,
                                                  const MainDirectionOptions& options) {
  MainDirectionWindow window(options);
  for (const FrameDirection& frame : frames)
    if (const auto answer = window.add(frame)) return answer;
  return std::nullopt;
}

}  // namespace sweepkit
