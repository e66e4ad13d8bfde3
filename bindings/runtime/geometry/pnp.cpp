// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/pnp.hpp"

#include <utility>

#include "sweepkit/geometry/impl/pnp.hpp"

namespace sweepkit {

std::optional<PnpRefinement> refine_pnp(const PnpMatches& matches, std::span<const int> chosen,
                                        const SE3<double>& T_world_camera, const PnpOptions& options) {
  impl::check_matches(matches);
  impl::PnpPose pose = impl::PnpPose::from(T_world_camera);
  const impl::PnpFit fit =
      impl::fit_pnp(matches, chosen, 1, options.huber_width, options.refine_iterations, pose);
  PnpRefinement result;
  if (!impl::pnp_covariance(fit.H, result.covariance)) return std::nullopt;
  result.T_world_camera = pose.T_world_camera();
  result.rmse = fit.rmse;
  result.iterations = fit.iterations;
  return result;
}

std::optional<PnpResult> solve_pnp(const PnpMatches& matches, const PnpOptions& options,
                                   const std::optional<SE3<double>>& guess) {
  impl::check_matches(matches);
  if (static_cast<int>(matches.points.size()) < options.min_inliers) return std::nullopt;
  const impl::PnpEstimator estimator(matches, options.threshold, options.huber_width);
  impl::PnpPose start;
  if (guess) start = impl::PnpPose::from(*guess);
  const std::span<const impl::PnpPose> guesses(&start, guess ? 1 : 0);
  auto found = ransac(estimator, options.ransac, guesses);
  if (!found || static_cast<int>(found->inliers.size()) < options.min_inliers) return std::nullopt;

  PnpResult result;
  result.inliers = std::move(found->inliers);
  result.iterations = found->iterations;
  impl::PnpPose pose = found->model;
  impl::PnpFit fit;
  for (int round = 0; round < 2; ++round) {
    fit = impl::fit_pnp(matches, result.inliers, 1, options.huber_width, options.refine_iterations, pose);
    if (round == 1 || !estimator.select(pose, result.inliers)) break;
    if (static_cast<int>(result.inliers.size()) < options.min_inliers) return std::nullopt;
  }
  if (!impl::pnp_covariance(fit.H, result.covariance)) return std::nullopt;
  result.T_world_camera = pose.T_world_camera();
  result.rmse = fit.rmse;
  return result;
}

}  // namespace sweepkit
