// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// How far a pose lies from the one expected: e = Log(T T_expected^-1), so that T = Exp(e) T_expected.
/// @param J if not null, d e / d xi for T <- Exp(xi) T
inline Vec6<double> pose_error(const SE3d& T, const SE3d& T_expected, Mat6<double>* J = nullptr) {
  const Vec6<double> e = (T * T_expected.inverse()).log();
  if (J) *J = SE3d::left_jacobian_inverse(e);
  return e;
}

/// How far two poses are from their measured relation: e = Log(T_a_b^-1 T_a_w T_b_w^-1), an error of the
/// measured motion in the frame of b: T_a_w T_b_w^-1 = T_a_b Exp(e).
/// @param J_a, J_b if not null, d e / d xi for T_a_w <- Exp(xi) T_a_w, and the like for b
inline Vec6<double> relative_pose_error(const SE3d& T_a_w, const SE3d& T_b_w, const SE3d& T_a_b,
                                        Mat6<double>* J_a = nullptr, Mat6<double>* J_b = nullptr) {
  const SE3d T_b_a = T_b_w * T_a_w.inverse();
  const Vec6<double> e = (T_a_b.inverse() * T_b_a.inverse()).log();
  if (J_a || J_b) {
    // Exp(xa) T Exp(-xb) = T Exp(Ad(T^-1) xa) Exp(-xb).
    const Mat6<double> J = SE3d::right_jacobian_inverse(e);
    if (J_a) *J_a = J * T_b_a.adjoint();
    if (J_b) *J_b = -J;
  }
  return e;
}

}  // namespace sweepkit
