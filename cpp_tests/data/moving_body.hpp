// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <vector>

#include "sweepkit/data/pose_spline.hpp"

namespace sweepkit::test {

/// A robot on a flat floor that drives in curves for `seconds`, stops now and then and turns on the spot; two
/// seconds of rest at both ends. Speeds are smooth; the path has no sideways motion.
inline PoseSpline flat_drive(double seconds) {
  constexpr double kStep = 0.01, kFine = 0.001;
  std::vector<SE3d> poses;
  double x = 0.3, y = -0.2, yaw = 0.4;
  const int fine = static_cast<int>(std::round(seconds / kFine));
  const double pi = std::acos(-1.0);
  for (int i = 0; i <= fine; ++i) {
    if (i % 10 == 0) poses.emplace_back(SO3d::exp({0, 0, yaw}), Vec3<double>(x, y, 0));
    const double t = (i + 0.5) * kFine;
    const double ends = std::min({1.0, std::max(0.0, t - 2.0), std::max(0.0, seconds - 2.0 - t)});
    const double active = ends * ends * (3.0 - 2.0 * ends);
    const double v = active * std::max(0.0, 0.3 * std::sin(pi * t / 7.0)) * (1.0 + 0.2 * std::sin(t));
    const double w = active * (0.6 * std::sin(pi * t / 3.1) + 0.3);
    x += kFine * v * std::cos(yaw + 0.5 * kFine * w);
    y += kFine * v * std::sin(yaw + 0.5 * kFine * w);
    yaw += kFine * w;
  }
  return PoseSpline(poses, kStep);
}

/// A body that tumbles through space: all six degrees of freedom move.
inline PoseSpline tumble(double seconds) {
  std::vector<SE3d> poses;
  for (int i = 0; i <= static_cast<int>(seconds / 0.02); ++i) {
    const double t = 0.02 * i;
    const Vec3<double> turn(0.8 * std::sin(1.1 * t), 0.5 * std::cos(0.7 * t), 0.9 * t);
    poses.emplace_back(SO3d::exp({0, 0, turn.z()}) * SO3d::exp({turn.x(), turn.y(), 0}),
                       Vec3<double>(std::sin(t), 0.7 * std::cos(1.3 * t), 0.3 * std::sin(2.0 * t)));
  }
  return PoseSpline(poses, 0.02);
}

}  // namespace sweepkit::test
