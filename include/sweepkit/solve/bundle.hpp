// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// A point of a bundle seen from one of its poses. As in PoseObservation the errors of u, v and of the
/// disparity u - u_right count as independent.
struct BundleObservation {
  int pose = 0, point = 0;       ///< places in BundleProblem
  float u = 0.0F, v = 0.0F;      ///< [px]
  float u_right = -1.0F;         ///< [px]; negative if only the left camera sees it
  float sigma = 1.0F;            ///< standard deviation of u and of v [px]
  float sigma_disparity = 1.0F;  ///< of u - u_right [px]
};

/// A measured motion between two poses, as odometry gives it:
/// T_camera_a_world T_camera_b_world^-1 = T_a_b Exp(e) with e ~ N(0, information^-1), (rho, phi) in b's axes.
struct RelativePose {
  int a = 0, b = 0;  ///< places in BundleProblem::T_camera_world
  SE3d T_a_b;
  Mat6<double> information = Mat6<double>::Zero();  ///< symmetric, not negative [1/m^2, 1/rad^2]
};

/// Poses and points with what ties them together: plain data, filled by whoever owns the map.
struct BundleProblem {
  std::vector<SE3d> T_camera_world;
  std::vector<std::uint8_t> fixed;   ///< for each pose: 1 if it must not move
  std::vector<Vec3<double>> points;  ///< in world [m]
  std::vector<BundleObservation> observations;
  std::vector<RelativePose> relative_poses;
  /// What all disparities are too large by, because a rig is never quite as calibrated: a yaw of one camera
  /// against the other shifts them all alike. Only motion past near and far points tells it from depth [px].
  double disparity_bias = 0.0;
  /// How far from the value given it may lie, as a standard deviation; 0: it is known and stays [px].
  double disparity_bias_sigma = 0.0;
};

struct BundleOptions {
  int robust_iterations = 3;
  int iterations = 5;
  double gate = 1.0;
  double function_tolerance = 1e-4;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(robust_iterations, "robust_iterations", "", range(1, 1000), "iterations before outliers are marked");
    v(iterations, "iterations", "", range(0, 1000), "iterations on the rest, if there were outliers");
    v(gate, "gate", "", range(0.01, 100), "multiplies the 95 % gates of chi-square: 5.99 mono, 7.81 stereo");
    v(function_tolerance, "function_tolerance", "", range(0, 1),
      "stop when the cost falls by less than this part of it");
  }
};

struct BundleResult {
  bool usable = false;        ///< false: no solution was found and the problem is as it was
  bool converged = false;     ///< the tolerance was met in the last round
  bool stopped = false;       ///< asked to stop; the best state so far was written
  int iterations = 0;         ///< all rounds
  double initial_cost = 0.0;  ///< half the robust sum of squared errors, in standard deviations
  double final_cost = 0.0;    ///< of the last round, without the outliers of the first
  std::vector<std::uint8_t>
      outlier;  ///< for each observation: 1 beyond the gate or behind the camera at the end
  int outliers = 0;
  /// What the observations and relative poses say of disparity_bias, its prior left out and all poses and
  /// points unknown [1/px^2]; 0 where it is not estimated.
  double disparity_bias_information = 0.0;
  int relative_outliers = 0;  ///< relative poses beyond the 95 % gate at the end
  int unused =
      0;  ///< observations of points that they do not determine: seen by one pose only, without disparity
};

/// Moves free poses and points to where the observations and relative poses fit best (Huber's loss, scale at
/// the 95 % gate): Levenberg and Marquardt, points eliminated (Schur complement), the poses that are left
/// solved by sparse blocks, perturbation Exp(xi) T_camera_world. Triggs, McLauchlan, Hartley and Fitzgibbon,
/// Bundle adjustment - a modern synthesis (1999). After a first round what lies beyond the gate is left out
/// and a second round follows. Fixed poses stay as they are to the last bit; free ones without any tie too.
/// @param stop when it becomes true the solver ends after the iteration under way; may be null
/// Throws Error(argument) at numbers that are not finite, sigmas that are not positive, indices out of range
/// and where poses are free but none is fixed.
BundleResult solve_bundle(const RectifiedCamera& camera, BundleProblem& problem, const BundleOptions& options,
                          const std::atomic<bool>* stop = nullptr);

}  // namespace sweepkit
