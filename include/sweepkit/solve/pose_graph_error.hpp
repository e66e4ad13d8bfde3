// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/geometry/sim3.hpp"

namespace sweepkit {

/// How far two nodes of a pose graph are from their measured motion: e = Log(T_i_j^-1 T_w_i^-1 T_w_j), so
/// that T_w_i^-1 T_w_j = T_i_j Exp(e). `Pose` is SE3d or Sim3d.
/// @param J_i, J_j if not null, d e / d xi for T_w_i <- T_w_i Exp(xi), and the like for j. Exact: with T_i_j
/// Exp(e) for the motion, Exp(-xi_i) T_i_j Exp(e) Exp(xi_j) = T_i_j Exp(e) Exp(-Ad(T_j_i) xi_i) Exp(xi_j), so
/// J_j = J_r^-1(e) and J_i = -J_r^-1(e) Ad(T_j_i); Barfoot, State Estimation for Robotics (2017), eq. 7.95
/// and Sola, Deray and Atchuthan, A micro Lie theory (2018), eq. 82.
template <class Pose, class Jacobian = Eigen::Matrix<double, Pose::Tangent::RowsAtCompileTime,
                                                     Pose::Tangent::RowsAtCompileTime>>
typename Pose::Tangent pose_graph_error(const Pose& T_w_i, const Pose& T_w_j, const Pose& T_i_j,
                                        Jacobian* J_i = nullptr, Jacobian* J_j = nullptr) {
  const Pose T_j_i = T_w_j.inverse() * T_w_i;
  const typename Pose::Tangent e = (T_j_i * T_i_j).inverse().log();
  if (J_i || J_j) {
    const Jacobian J = Pose::right_jacobian_inverse(e);
    if (J_i) *J_i = -J * T_j_i.adjoint();
    if (J_j) *J_j = J;
  }
  return e;
}

/// A motion that keeps the tilt: x = (d, psi) moves a pose by d in world axes [m] and turns it by psi about
/// the unit vector `up_world` through its own origin [rad].
inline SE3d move_level(const SE3d& T_world_node, const Eigen::Vector4d& x, const Vec3<double>& up_world) {
  return {SO3d::exp(x[3] * up_world) * T_world_node.rotation(), T_world_node.translation() + x.head<3>()};
}

/// d xi / d x at 0, for T_world_node Exp(xi) = move_level(T_world_node, x): [R' 0; 0 R' up].
inline Eigen::Matrix<double, 6, 4> level_motion_basis(const SE3d& T_world_node,
                                                      const Vec3<double>& up_world) {
  const Mat3<double> R_node_world = T_world_node.rotation().matrix().transpose();
  Eigen::Matrix<double, 6, 4> B = Eigen::Matrix<double, 6, 4>::Zero();
  B.topLeftCorner<3, 3>() = R_node_world;
  B.bottomRightCorner<3, 1>() = R_node_world * up_world;
  return B;
}

}  // namespace sweepkit
