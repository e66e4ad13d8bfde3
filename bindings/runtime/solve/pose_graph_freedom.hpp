// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <utility>

#include "small_matrix.hpp"
#include "sweepkit/solve/pose_graph.hpp"
#include "sweepkit/solve/pose_graph_error.hpp"

namespace sweepkit {

// What may move of a pose: how many numbers, how they move it, and their directions in its tangent space.
template <class PoseType>
struct FullFreedom {
  using Pose = PoseType;
  static constexpr int kSize = Pose::Tangent::RowsAtCompileTime;
  using Step = typename Pose::Tangent;

  Pose moved(const Pose& T_world_node, const Step& step) const { return T_world_node * Pose::exp(step); }
  template <class Jacobian>
  Jacobian along(const Pose&, const Jacobian& J) const {
    return J;
  }
  template <class Information>
  void blur(const Pose&, const Pose&, const Pose&, Information&) const {}
};

struct YawFreedom {
  using Pose = SE3d;
  static constexpr int kSize = 4;
  using Step = Eigen::Vector4d;

  Vec3<double> up_world;
  double tilt_sigma;  // [rad]

  SE3d moved(const SE3d& T_world_node, const Step& step) const {
    return move_level(T_world_node, step, up_world);
  }
  Eigen::Matrix<double, 6, 4> along(const SE3d& T_world_node, const Mat6<double>& J) const {
    return small::product<6, 6, 4>(J, level_motion_basis(T_world_node, up_world));
  }
  // Takes what the tilts of both ends may be wrong by into the edge's covariance.
  void blur(const SE3d& T_w_i, const SE3d& T_w_j, const SE3d& T_i_j, Mat6<double>& information) const {
    if (tilt_sigma == 0.0) return;
    Mat6<double> J_i, J_j;
    pose_graph_error(T_w_i, T_w_j, T_i_j, &J_i, &J_j);
    Mat6<double> covariance = small::inverse<6>(information);
    for (const auto& [J, T] : {std::pair(&J_i, &T_w_i), std::pair(&J_j, &T_w_j)}) {
      const Mat3<double> R_node_world = T->rotation().matrix().transpose();
      const Mat3<double> across = R_node_world * (Mat3<double>::Identity() - up_world * up_world.transpose());
      const Eigen::Matrix<double, 6, 3> tilted =
          small::product<6, 3, 3>(tilt_sigma * J->rightCols<3>(), across);
      covariance += small::product<6, 3, 6>(tilted, small::transposed<6, 3>(tilted));
    }
    information = small::inverse<6>(covariance);
  }
};

}  // namespace sweepkit
