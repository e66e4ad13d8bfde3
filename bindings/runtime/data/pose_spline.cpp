// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/pose_spline.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "sweepkit/core/error.hpp"

namespace sweepkit {
namespace {

constexpr int kOrder = PoseSpline::kOrder;
using Weights = std::array<double, kOrder>;

// The uniform B-spline of degree five between two knots: weights of the six controls as polynomials in u,
// times 120.
constexpr std::array<std::array<double, kOrder>, kOrder> kBasis = {{{1, -5, 10, -10, 5, -1},
                                                                    {26, -50, 20, 20, -20, 5},
                                                                    {66, 0, -60, 0, 30, -10},
                                                                    {26, 50, 20, -20, -20, 10},
                                                                    {1, 5, 10, 10, 5, -5},
                                                                    {0, 0, 0, 0, 0, 1}}};

// Weights and their first two derivatives by time.
struct Basis {
  Weights value, first, second;

  Basis(double u, double step) {
    const double scale = 1.0 / 120.0, d1 = 1.0 / step, d2 = d1 * d1;
    for (int i = 0; i < kOrder; ++i) {
      const auto& c = kBasis[i];
      value[i] = scale * (c[0] + u * (c[1] + u * (c[2] + u * (c[3] + u * (c[4] + u * c[5])))));
      first[i] = scale * d1 * (c[1] + u * (2 * c[2] + u * (3 * c[3] + u * (4 * c[4] + u * 5 * c[5]))));
      second[i] = scale * d2 * (2 * c[2] + u * (6 * c[3] + u * (12 * c[4] + u * 20 * c[5])));
    }
  }
};

// Sums from i to the end: what a cumulative spline weighs its steps with.
Weights cumulative(Weights w) {
  for (int i = kOrder - 2; i >= 0; --i) w[i] += w[i + 1];
  return w;
}

}  // namespace

MotionState MotionState::of(const SE3d& T_body_sensor) const {
  const SO3d& R = T_world_body.rotation();
  const Vec3<double>& lever = T_body_sensor.translation();
  const SO3d R_sensor_body = T_body_sensor.rotation().inverse();
  const Vec3<double> swing = angular_rate.cross(lever);
  MotionState s;
  s.T_world_body = T_world_body * T_body_sensor;
  s.velocity = velocity + R * swing;
  s.acceleration =
      acceleration + R * Vec3<double>(angular_acceleration.cross(lever) + angular_rate.cross(swing));
  s.angular_rate = R_sensor_body * angular_rate;
  s.angular_acceleration = R_sensor_body * angular_acceleration;
  return s;
}

PoseSpline::PoseSpline(std::vector<SE3d> poses, double step) : step_(step), controls_(std::move(poses)) {
  require(!controls_.empty(), "PoseSpline poses", "must not be empty", controls_.size());
  require(std::isfinite(step) && step > 0.0, "PoseSpline step", "must be positive", step);
  const SE3d first = controls_.front(), last = controls_.back();
  controls_.insert(controls_.begin(), 2, first);
  controls_.insert(controls_.end(), 3, last);
  prepare();
  duration_ = step_ * static_cast<double>(controls_.size() - kOrder);
}

void PoseSpline::prepare() {
  turns_.resize(controls_.size() - 1);
  for (std::size_t i = 0; i + 1 < controls_.size(); ++i)
    turns_[i] = (controls_[i].rotation().inverse() * controls_[i + 1].rotation()).log();
}

PoseSpline PoseSpline::through(std::span<const StampedPose> poses) {
  require(poses.size() >= 4, "PoseSpline::through poses", "must be at least 4", poses.size());
  std::vector<double> gaps;
  for (std::size_t i = 1; i < poses.size(); ++i) {
    require(poses[i].t > poses[i - 1].t, "PoseSpline::through stamps", "must rise", poses[i].t);
    gaps.push_back(to_seconds(poses[i].t - poses[i - 1].t));
  }
  const double length = to_seconds(poses.back().t - poses.front().t);
  std::nth_element(gaps.begin(), gaps.begin() + static_cast<std::ptrdiff_t>(gaps.size() / 2), gaps.end());
  const double median = gaps[gaps.size() / 2];
  require(length / median < 1e8, "PoseSpline::through stamps", "lie too far apart for their median", length);
  const auto steps = static_cast<std::size_t>(std::max(3.0, std::round(length / median)));

  std::vector<SE3d> targets(steps + 1);
  std::size_t from = 0;
  for (std::size_t i = 0; i <= steps; ++i) {
    const TimeNs t =
        poses.front().t + from_seconds(length * static_cast<double>(i) / static_cast<double>(steps));
    while (from + 2 < poses.size() && poses[from + 1].t <= t) ++from;
    const StampedPose &a = poses[from], &b = poses[from + 1];
    // Stamps that are a little off the grid (rounded to microseconds, say) are taken to be on it.
    const double share = static_cast<double>(t - a.t) / static_cast<double>(b.t - a.t);
    constexpr double kOnGrid = 1e-3;
    targets[i] = share < kOnGrid ? a.T_world_body
                 : share > 1.0 - kOnGrid
                     ? b.T_world_body
                     : SE3d(interpolate(a.T_world_body.rotation(), b.T_world_body.rotation(), share),
                            a.T_world_body.translation() +
                                share * (b.T_world_body.translation() - a.T_world_body.translation()));
  }

  PoseSpline spline;
  spline.step_ = length / static_cast<double>(steps);
  spline.duration_ = length;
  // Controls beyond the ends go on as the ends do.
  const auto extend = [&] {
    auto& c = spline.controls_;
    const std::size_t last = c.size() - 4;
    for (std::size_t i = 2; i-- > 0;) c[i] = c[i + 1] * (c[i + 2].inverse() * c[i + 1]);
    for (std::size_t i = last + 1; i < c.size(); ++i) c[i] = c[i - 1] * (c[i - 2].inverse() * c[i - 1]);
  };
  spline.controls_.resize(steps + 1 + 5);
  std::copy(targets.begin(), targets.end(), spline.controls_.begin() + 2);
  extend();
  spline.prepare();
  // What the spline misses a pose by is put on its control: the weight of a control on its own pose is above
  // one half, and what changes slowly is met at once.
  constexpr int kRounds = 200;
  constexpr double kMet = 1e-12;
  std::vector<SE3d> missed(steps + 1);
  for (int round = 0; round < kRounds; ++round) {
    double worst = 0.0;
    for (std::size_t i = 0; i <= steps; ++i) {
      const SE3d pose = spline.pose(spline.step_ * static_cast<double>(i));
      missed[i] = SE3d(pose.rotation().inverse() * targets[i].rotation(),
                       targets[i].translation() - pose.translation());
      worst = std::max({worst, missed[i].rotation().angle(), missed[i].translation().norm()});
    }
    if (worst < kMet) break;
    for (std::size_t i = 0; i <= steps; ++i) {
      SE3d& c = spline.controls_[i + 2];
      c = SE3d(c.rotation() * missed[i].rotation(), c.translation() + missed[i].translation());
    }
    extend();
    spline.prepare();
  }
  return spline;
}

MotionState PoseSpline::at(double t) const {
  t = std::clamp(t, 0.0, duration_);
  const double place = t / step_;
  const auto segment = std::min(static_cast<std::size_t>(place), controls_.size() - kOrder);
  const Basis basis(place - static_cast<double>(segment), step_);
  const SE3d* c = &controls_[segment];
  const Vec3<double>* d = &turns_[segment];

  MotionState s;
  // Positions from the first control on: no digits are lost far from the origin.
  Vec3<double> p = Vec3<double>::Zero();
  for (int i = 1; i < kOrder; ++i) {
    const Vec3<double> offset = c[i].translation() - c[0].translation();
    p += basis.value[i] * offset;
    s.velocity += basis.first[i] * offset;
    s.acceleration += basis.second[i] * offset;
  }
  const Weights w = cumulative(basis.value), w1 = cumulative(basis.first), w2 = cumulative(basis.second);
  SO3d R = c[0].rotation();
  Vec3<double>&rate = s.angular_rate, &change = s.angular_acceleration;
  for (int j = 1; j < kOrder; ++j) {
    const Vec3<double>& turn = d[j - 1];
    const SO3d A = SO3d::exp(w[j] * turn);
    const SO3d A_inverse = A.inverse();
    R = R * A;
    rate = A_inverse * rate + w1[j] * turn;
    change = A_inverse * change + w1[j] * rate.cross(turn) + w2[j] * turn;
  }
  s.T_world_body = SE3d(R, c[0].translation() + p);
  return s;
}

SE3d PoseSpline::pose(double t) const { return at(t).T_world_body; }

}  // namespace sweepkit
