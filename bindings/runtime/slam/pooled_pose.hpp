// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <optional>
#include <span>

#include "sweepkit/geometry/pnp.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// A point of the map and where one of several images shows it.
struct PooledMatch {
  std::size_t view = 0;           ///< which of the images
  Vec3<double> p_world;           ///< [m]
  Vec2<double> ray;               ///< x/z, y/z in the image's camera
  std::optional<double> right_x;  ///< x/z in its right camera; with it the match has a depth
  double sigma = 1;               ///< of the ray [px]
  double sigma_disparity = 1;     ///< of ray less right_x [px]
};

/// The images' cameras against that of the first, and what is known of the way down.
struct PooledViews {
  std::span<const SE3d> T_view_first;
  Vec3<double> gravity_first = Vec3<double>::UnitY();   ///< unit, in the first camera
  Vec3<double> gravity_world = -Vec3<double>::UnitZ();  ///< unit
  double focal = 1;                                     ///< [px]
  double baseline = 0;                                  ///< [m]
};

struct PooledPose {
  SE3d T_first_world;
  int inliers = 0;
};

/// How several images taken along a known way stand in the map, from matches too few in each of them. Two
/// matches with depth, of any two images, fix the turn about gravity and the translation; pairs whose
/// distance or height differs between the map and the images are no sample, which most wrong ones are.
/// Reprojection errors in all images score and refine, in six degrees of freedom. Deterministic. Nothing
/// below options.min_inliers.
std::optional<PooledPose> solve_pooled_pose(std::span<const PooledMatch> matches, const PooledViews& views,
                                            const PnpOptions& options);

/// Least squares with Huber's weights over all matches from a pose near the right one; that pose if it fails.
SE3d refine_pooled_pose(std::span<const PooledMatch> matches, const PooledViews& views,
                        const SE3d& T_first_world, const PnpOptions& options);

}  // namespace sweepkit
