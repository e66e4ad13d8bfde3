// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/geometry/ransac.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// Points of the world and where a camera sees them: item i of each list belongs together. Rays are those of
/// a camera without distortion in normalised coordinates (x/z, y/z), (u - cx) / focal for a pinhole; so any
/// calibrated camera that looks less than 90 degrees aside fits. Lists are the caller's and must outlive it.
/// An item with a value that is not finite is an outlier.
struct PnpMatches {
  std::span<const Vec3<double>> points;  ///< p_world [m]
  std::span<const Vec2<double>> rays;    ///< x/z, y/z in the camera
  std::span<const double> right_x;  ///< x/z in the right camera of a rectified pair; empty: no such camera;
                                    ///< not-a-number: this point was not seen there
  std::span<const double> sigmas;   ///< standard deviation of each coordinate [px]; empty: 1 for all
  double focal = 1.0;               ///< how many pixels a unit of x/z is [px]
  double baseline = 0.0;            ///< of the rectified pair [m]
};

struct PnpOptions {
  double threshold = 2.5;
  double huber_width = 1.5;
  int min_inliers = 10;
  int refine_iterations = 10;
  RansacOptions ransac;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(threshold, "threshold", "px", range(0.01, 1000.0),
      "largest reprojection error of an inlier, times its sigma; a third coordinate widens it by 1.14");
    v(huber_width, "huber_width", "", range(0.1, 1000.0),
      "errors above so many sigmas count linearly in the refinement");
    v(min_inliers, "min_inliers", "", range(4, 1000000), "fewer inliers are no pose");
    v(refine_iterations, "refine_iterations", "", range(1, 100), "steps of the last refinement at most");
    v.group(ransac, "ransac", "search for the inliers");
  }
};

struct PnpResult {
  SE3<double> T_world_camera;
  Mat6<double> covariance;   ///< of xi in T_world_camera * Exp(xi), for the given sigmas [m^2, rad^2]
  std::vector<int> inliers;  ///< ascending
  double rmse = 0.0;         ///< of the inliers' coordinates [sigmas]: near 1 if the sigmas are right
  int iterations = 0;        ///< samples that RANSAC drew
};

/// A pose after refine_pnp().
struct PnpRefinement {
  SE3<double> T_world_camera;
  Mat6<double> covariance;
  double rmse = 0.0;   ///< [sigmas]
  int iterations = 0;  ///< steps tried
};

/// Least-squares pose of the chosen matches from a start near it: Levenberg and Marquardt on SE(3) with
/// analytic Jacobians and Huber's loss on each match. Points behind the camera count for nothing.
/// @param chosen numbers of the matches to use
/// @return nothing if they do not fix all six degrees of freedom
/// @throws Error(argument) if the lists differ in length
std::optional<PnpRefinement> refine_pnp(const PnpMatches& matches, std::span<const int> chosen,
                                        const SE3<double>& T_world_camera, const PnpOptions& options = {});

/// Pose of a camera from matches of which many are wrong: P3P on samples of three in LO-RANSAC, then
/// refine_pnp() on the inliers, chosen anew once more with the refined pose. Right-image coordinates, where
/// given, take part in scores and refinement. Deterministic by options.ransac.seed; the search scores in
/// float about the points' mean, everything that ends up in the result is in double.
/// @param guess a pose to try before any sample
/// @return nothing for fewer than options.min_inliers inliers, or inliers that do not fix the pose
/// @throws Error(argument) if the lists differ in length
std::optional<PnpResult> solve_pnp(const PnpMatches& matches, const PnpOptions& options = {},
                                   const std::optional<SE3<double>>& guess = std::nullopt);

}  // namespace sweepkit
