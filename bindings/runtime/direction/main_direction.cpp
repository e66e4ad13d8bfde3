// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/direction/main_direction.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace sweepkit {

namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kQuarter = std::numbers::pi / 2;
constexpr double kSteepest = 0.17;  // sine of the least angle between the viewing axis and the vertical

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
                                          std::span<const LineSegment> right, const SO3d& R_world_body) {
  const SO3d R_body_left = rig_.T_body_raw(Side::left).rotation();
  const SO3d R_world_left = R_world_body * R_body_left;
  const Vec3<double> forward = R_world_left * Vec3<double>::UnitZ();
  FrameDirection result;
  result.t = t;
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
    collected_.push_back(*angle + frame.yaw - first_.yaw);
  return frames_ < options_.window ? std::nullopt : close();
}

std::optional<MainDirection> MainDirectionWindow::close() {
  MainDirection result;
  result.frames = frames_;
  result.collected = static_cast<int>(collected_.size());
  frames_ = 0;
  const double tolerance = options_.inlier_tolerance * kDegree;
  // Hypothesis: each direction. Score: truncated squares.
  double best = 0, center = 0;
  for (const double hypothesis : collected_) {
    double score = 0;
    for (const double angle : collected_) {
      const double off = wrap_quarter_turn(angle - hypothesis) / tolerance;
      score += std::max(0.0, 1 - off * off);
    }
    if (score > best) {
      best = score;
      center = hypothesis;
    }
  }
  double squares = 0;
  for (int round = 0; round < 3; ++round) {
    double sum = 0;
    squares = 0;
    result.inliers = 0;
    for (const double angle : collected_) {
      const double off = wrap_quarter_turn(angle - center);
      if (std::abs(off) > tolerance) continue;
      sum += off;
      squares += off * off;
      ++result.inliers;
    }
    if (result.inliers == 0) break;
    center += sum / result.inliers;
  }
  const bool enough =
      result.collected > 0 && result.collected >= options_.min_collected_share * result.frames;
  result.confidence = result.collected > 0 ? static_cast<double>(result.inliers) / result.collected : 0.0;
  last_confidence_ = enough ? result.confidence : 0.0;
  if (!enough || result.confidence < options_.threshold) {
    ++restarts_;
    return std::nullopt;
  }
  result.window_begin = first_.t;
  result.window_end = last_.t;
  result.angle = wrap_quarter_turn(center);
  result.run_begin = run_first_->t;
  result.run_angle = wrap_quarter_turn(center + first_.yaw - run_first_->yaw);
  result.sigma = std::sqrt(squares) / result.inliers;
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
