// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>

#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// The inverse of SE(3)'s left Jacobian, translation first: Log(Exp(d) T) = Log(T) + J^-1 d to first order,
/// xi = Log(T). Barfoot, State Estimation for Robotics (2017), eq. 7.85 and 7.86.
inline Mat6<double> motion_left_jacobian_inverse(const Vec6<double>& xi) {
  const Vec3<double> phi = xi.tail<3>();
  const Mat3<double> P = SO3d::hat(phi), R = SO3d::hat(Vec3<double>(xi.head<3>()));
  const double theta2 = phi.squaredNorm();
  double a, b, c;
  if (theta2 < 1e-3) {
    a = 1.0 / 6.0 - theta2 / 120.0;
    b = 1.0 / 24.0 - theta2 / 720.0;
    c = 1.0 / 120.0 - theta2 / 2520.0;
  } else {
    const double theta = std::sqrt(theta2), sine = std::sin(theta), cosine = std::cos(theta);
    a = (theta - sine) / (theta2 * theta);
    b = (theta2 + 2.0 * cosine - 2.0) / (2.0 * theta2 * theta2);
    c = (2.0 * theta - 3.0 * sine + theta * cosine) / (2.0 * theta2 * theta2 * theta);
  }
  const Mat3<double> PR = P * R, RP = R * P, PRP = PR * P;
  const Mat3<double> Q =
      0.5 * R + a * (PR + RP + PRP) + b * (P * PR + RP * P - 3.0 * PRP) + c * (PRP * P + P * PRP);
  const Mat3<double> J_inverse = SO3d::left_jacobian_inverse(phi);
  Mat6<double> J = Mat6<double>::Zero();
  J.topLeftCorner<3, 3>() = J_inverse;
  J.bottomRightCorner<3, 3>() = J_inverse;
  J.topRightCorner<3, 3>() = -J_inverse * Q * J_inverse;
  return J;
}

/// How far a pose lies from the one expected: e = Log(T T_expected^-1), so that T = Exp(e) T_expected.
/// @param J if not null, d e / d xi for T <- Exp(xi) T
inline Vec6<double> pose_error(const SE3d& T, const SE3d& T_expected, Mat6<double>* J = nullptr) {
  const Vec6<double> e = (T * T_expected.inverse()).log();
  if (J) *J = motion_left_jacobian_inverse(e);
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
    // Exp(xa) T Exp(-xb) = T Exp(Ad(T^-1) xa) Exp(-xb), and the right Jacobian at e is the left one at -e.
    const Mat6<double> J = motion_left_jacobian_inverse(-e);
    if (J_a) *J_a = J * T_b_a.adjoint();
    if (J_b) *J_b = -J;
  }
  return e;
}

}  // namespace sweepkit
