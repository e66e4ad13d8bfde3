// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/solve/robust_loss.hpp"

namespace sweepkit {

/// A known point and where the rectified left camera sees it. The errors of u, v and of the disparity
/// u - u_right count as independent: the disparity comes from matching the patch around (u, v), wherever the
/// detector put it.
struct PoseObservation {
  Vec3<double> p_world = Vec3<double>::Zero();  ///< [m]
  float u = 0.0F, v = 0.0F;                     ///< [px]
  float u_right = -1.0F;                        ///< [px]; negative if only the left camera sees it
  float sigma = 1.0F;                           ///< standard deviation of u and of v [px]
  float sigma_disparity = 1.0F;                 ///< of u - u_right [px]
  /// One standard deviation of the point along its most uncertain direction, in world axes [m]; a stereo
  /// point's is nearly all along the ray on which it was triangulated. Zero: the point counts as exact.
  Vec3<float> p_world_spread = Vec3<float>::Zero();
};

/// What is known of the pose beforehand: T_camera_world = Exp(e) * prior with e ~ N(0, information^-1).
struct PosePrior {
  SE3d T_camera_world;
  Mat6<double> information = Mat6<double>::Zero();  ///< of (rho, phi) in the camera's axes [1/m^2, 1/rad^2]
};

enum class PoseLoss { quadratic, huber, cauchy, geman_mcclure, tukey };

struct PoseOptions {
  PoseLoss loss = PoseLoss::geman_mcclure;
  double loss_scale = 1.0;
  double gate = 1.0;
  int max_iterations = 10;
  double tolerance = 0.01;
  int min_inliers = 5;
  bool point_uncertainty = true;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v.choice(loss, "loss",
             {{PoseLoss::quadratic, "quadratic"},
              {PoseLoss::huber, "huber"},
              {PoseLoss::cauchy, "cauchy"},
              {PoseLoss::geman_mcclure, "geman_mcclure"},
              {PoseLoss::tukey, "tukey"}},
             "robust loss of the first stage; those that redescend start wide and narrow down");
    v(loss_scale, "loss_scale", "", range(0.01, 100),
      "scale of the loss, as a multiple of the gate (a root of chi-square)");
    v(gate, "gate", "", range(0.01, 100), "multiplies the 95 % gates of chi-square: 5.99 mono, 7.81 stereo");
    v(max_iterations, "max_iterations", "", range(1, 100), "iterations of a stage of the descent");
    v(tolerance, "tolerance", "", range(1e-9, 1),
      "end when a step is smaller than this many standard deviations");
    v(min_inliers, "min_inliers", "", range(3, 1000), "with fewer, and without a prior, there is no pose");
    v(point_uncertainty, "point_uncertainty", "", any_value(),
      "count the uncertainty of points, as seen from the first pose");
  }
};

enum class PoseStatus {
  converged,
  not_converged,  ///< iterations used up: pose and covariance are those of the last one
  too_few,        ///< fewer than min_inliers in front of the camera or within the gate, and no prior
  degenerate,     ///< the observations do not determine a pose
};

/// The outcome of solve_pose. Unless usable(), T_camera_world is the pose that it started from.
struct PoseResult {
  SE3d T_camera_world;
  /// Of xi with T_true = Exp(xi) T_camera_world, (rho, phi) in the camera's axes [m^2, rad^2]: the same as of
  /// a right perturbation of T_world_camera. 1e12 on the diagonal if not usable().
  Mat6<double> covariance = Mat6<double>::Identity() * 1e12;
  PoseStatus status = PoseStatus::too_few;
  int inliers = 0;         ///< observations within the gate, stereo or not
  int stereo_inliers = 0;  ///< those with u_right
  double chi2 = 0.0;       ///< of the inliers and the prior
  int iterations = 0;      ///< linear systems solved

  bool converged() const { return status == PoseStatus::converged; }
  bool usable() const { return status == PoseStatus::converged || status == PoseStatus::not_converged; }
};

/// Four observations side by side, prepared for the sums.
struct alignas(32) PoseBlock {
  Eigen::Array4d x, y, z;         ///< p_world
  Eigen::Array4d u, v, d;         ///< measured, with the principal point taken off
  Eigen::Array4d wu, wv, wd;      ///< inverse variances; wd is 0 without u_right, all are 0 in empty lanes
  Eigen::Array4d gate, inv_gate;  ///< of chi2
  Eigen::Array4d use;             ///< 0 in empty lanes, else 1
  Eigen::Array4d chi2;            ///< at the last linearization; huge behind the camera
};

/// Memory of solve_pose, to be kept from call to call so that none is allocated. Its content means nothing.
struct PoseWorkspace {
  std::vector<PoseBlock> blocks;
  std::vector<double> sorted;
};

/// The pose that explains where known points are seen: first with a robust loss over all, then by least
/// squares on those within the gate, until these stay the same. Levenberg and Marquardt's method on SE(3)
/// with the perturbation T_camera_world <- Exp(xi) T_camera_world and analytic Jacobians; sums in a fixed
/// order. A loss that redescends starts so wide that most observations pull, and narrows down (graduated
/// non-convexity, Blake and Zisserman 1987), so that a poor start does no harm. The covariance allows for
/// what the gate takes from good observations.
/// @param T_camera_world where to start
/// @param inlier resized to the observations: 1 within the gate at the result, else 0; all 0 if not usable()
/// @param prior counts at full weight throughout; may be null
/// @param workspace may be null
/// Throws Error(argument) at a number that is not finite or a sigma that is not positive.
PoseResult solve_pose(const RectifiedCamera& camera, const SE3d& T_camera_world,
                      std::span<const PoseObservation> observations, const PoseOptions& options,
                      std::vector<std::uint8_t>& inlier, const PosePrior* prior = nullptr,
                      PoseWorkspace* workspace = nullptr);

/// The same with a loss of one's own; options.loss is not looked at. Include sweepkit/solve/impl/pose.hpp.
template <RobustLoss Loss>
PoseResult solve_pose_with(const RectifiedCamera& camera, const SE3d& T_camera_world,
                           std::span<const PoseObservation> observations, const PoseOptions& options,
                           std::vector<std::uint8_t>& inlier, const PosePrior* prior,
                           PoseWorkspace& workspace);

}  // namespace sweepkit
