// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <span>

#include "sweepkit/geometry/impl/p3p.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// Poses of a calibrated camera that sees three known points: the perspective-three-point problem.
///
/// The three distances are common points of two conics, as in Persson and Nordberg, Lambda Twist (ECCV 2018),
/// and Ding et al., Revisiting the P3P Problem (CVPR 2023): the one real root of a cubic that is farthest
/// from the others gives a pair of lines in their pencil, each of which meets a conic in at most two points.
/// The distances are then polished by Newton's method on the cosine law, written with |b_i - b_j|^2 in place
/// of the cosines, so that narrow views lose no digits.
/// @param p_world three points, not collinear [m]
/// @param bearings unit vectors to them in the camera
/// @param[out] T_camera_world the poses; every point lies in front, along its bearing
/// @return number of poses, 0 to 4; 0 for collinear or coinciding points and values that are not finite
inline int solve_p3p(std::span<const Vec3<double>, 3> p_world, std::span<const Vec3<double>, 3> bearings,
                     std::span<SE3<double>, 4> T_camera_world) {
  std::array<impl::P3pPose, 4> poses;
  const int count = impl::p3p_poses(p_world, bearings, poses);
  for (std::size_t i = 0; i < static_cast<std::size_t>(count); ++i)
    T_camera_world[i] = SE3<double>(SO3<double>(poses[i].R), poses[i].t);
  return count;
}

}  // namespace sweepkit
