// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// Errors of a point seen at (u, v) with a disparity u - u_right: predicted minus measured, in pixels, in
/// this order. False, and nothing written, if the point is behind the camera.
/// @param R, t of T_camera_world
/// @param J_pose if not null, d errors / d xi for T_camera_world <- Exp(xi) T_camera_world, (rho, phi)
/// @param J_point if not null, d errors / d p_world
inline bool reprojection_error(const RectifiedCamera& camera, const Mat3<double>& R, const Vec3<double>& t,
                               const Vec3<double>& p_world, double u, double v, double disparity,
                               Vec3<double>& errors, Eigen::Matrix<double, 3, 6>* J_pose = nullptr,
                               Mat3<double>* J_point = nullptr) {
  const Vec3<double> p = R * p_world + t;
  if (!(p.z() > RectifiedCamera::kMinDepth)) return false;
  const double iz = 1.0 / p.z(), f = camera.focal, fz = f * iz;
  const double a = p.x() * iz, b = p.y() * iz, d = camera.baseline * fz;
  errors << camera.cx + f * a - u, camera.cy + f * b - v, d - disparity;
  if (J_pose) {
    *J_pose << fz, 0.0, -fz * a, -f * a * b, f * (1.0 + a * a), -f * b,  //
        0.0, fz, -fz * b, -f * (1.0 + b * b), f * a * b, f * a,          //
        0.0, 0.0, -d * iz, -d * b, d * a, 0.0;
  }
  if (J_point) {
    J_point->row(0) = fz * (R.row(0) - a * R.row(2));
    J_point->row(1) = fz * (R.row(1) - b * R.row(2));
    J_point->row(2) = (-d * iz) * R.row(2);
  }
  return true;
}

}  // namespace sweepkit
