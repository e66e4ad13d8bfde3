// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// A body in motion at an instant.
struct MotionState {
  SE3d T_world_body;
  Vec3<double> velocity = Vec3<double>::Zero();              ///< of the origin, in the world [m/s]
  Vec3<double> acceleration = Vec3<double>::Zero();          ///< of the origin, in the world [m/s^2]
  Vec3<double> angular_rate = Vec3<double>::Zero();          ///< in the body [rad/s]
  Vec3<double> angular_acceleration = Vec3<double>::Zero();  ///< in the body [rad/s^2]

  /// The motion of a frame fixed to this body (a sensor), its rates in its own axes.
  MotionState of(const SE3d& T_body_sensor) const;
};

/// A motion through space, four times continuously differentiable, with exact derivatives: a uniform B-spline
/// of degree five over poses, cumulative in the rotations (Sommer, Usenko, Schubert, Demmel, Cremers,
/// Efficient derivative computation for cumulative B-splines on Lie groups, CVPR 2020). Simulated sensors
/// read it, so that it is the truth itself and not a fit to it. Times are seconds from its start. Immutable;
/// any number of threads may use one.
class PoseSpline {
 public:
  static constexpr int kOrder = 6;

  /// A spline that is drawn towards poses one step apart, the i-th at i steps, and passes near them: it is
  /// their mean over about 0.7 steps to either side (standard deviation). Where six poses are equal it is at
  /// rest. At least one pose, step > 0 [s], else Error(argument).
  PoseSpline(std::vector<SE3d> poses, double step);

  /// A spline through given poses. Stamps must rise. Knots are the stamps where these are evenly apart, else
  /// as far apart as the stamps are in the median, and the poses between are taken along the geodesic.
  /// Content near the Nyquist frequency of the stamps is smoothed. At least four poses, else Error(argument).
  static PoseSpline through(std::span<const StampedPose> poses);

  /// Length [s]; the motion is defined at 0 .. duration and stands still outside.
  double duration() const { return duration_; }
  double step() const { return step_; }
  MotionState at(double t) const;
  SE3d pose(double t) const;

 private:
  PoseSpline() = default;
  /// Sets what is derived from the control poses.
  void prepare();

  double step_ = 0.0;
  double duration_ = 0.0;
  std::vector<SE3d> controls_;       // two before the first pose, three after the last
  std::vector<Vec3<double>> turns_;  // from each control to the next, as rotation vector
};

}  // namespace sweepkit
