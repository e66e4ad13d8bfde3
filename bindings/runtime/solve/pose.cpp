// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/solve/pose.hpp"

#include "sweepkit/solve/impl/pose.hpp"

namespace sweepkit {

PoseResult solve_pose(const RectifiedCamera& camera, const SE3d& T_camera_world,
                      std::span<const PoseObservation> observations, const PoseOptions& options,
                      std::vector<std::uint8_t>& inlier, const PosePrior* prior, PoseWorkspace* workspace) {
  PoseWorkspace own;
  PoseWorkspace& memory = workspace ? *workspace : own;
  const auto solve = [&]<class Loss>(Loss) {
    return solve_pose_with<Loss>(camera, T_camera_world, observations, options, inlier, prior, memory);
  };
  switch (options.loss) {
    case PoseLoss::quadratic:
      return solve(QuadraticLoss{});
    case PoseLoss::huber:
      return solve(HuberLoss{});
    case PoseLoss::cauchy:
      return solve(CauchyLoss{});
    case PoseLoss::geman_mcclure:
      return solve(GemanMcClureLoss{});
    case PoseLoss::tukey:
      return solve(TukeyLoss{});
  }
  throw Error(ErrorKind::option, "PoseOptions loss", "is none of its choices");
}

}  // namespace sweepkit
