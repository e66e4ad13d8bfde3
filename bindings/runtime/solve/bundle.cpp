// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/solve/bundle.hpp"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "bundle_solver.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/solve/motion_error.hpp"
#include "sweepkit/solve/reprojection.hpp"

namespace sweepkit {
namespace {

void check(const RectifiedCamera& camera, const BundleProblem& problem) {
  require(camera.focal > 0.0 && std::isfinite(camera.focal + camera.cx + camera.cy + camera.baseline),
          "solve_bundle camera", "must be finite with a positive focal length", camera.focal);
  const std::size_t poses = problem.T_camera_world.size();
  require(problem.fixed.size() == poses, "solve_bundle fixed", "must have an entry for each pose",
          problem.fixed.size());
  for (std::size_t i = 0; i < poses; ++i)
    require(problem.T_camera_world[i].matrix().allFinite(), "solve_bundle T_camera_world", "must be finite",
            i);
  for (std::size_t i = 0; i < problem.points.size(); ++i)
    require(problem.points[i].allFinite(), "solve_bundle points", "must be finite", i);
  const auto is_pose = [&](int i) { return i >= 0 && static_cast<std::size_t>(i) < poses; };
  for (const BundleObservation& o : problem.observations) {
    require(is_pose(o.pose), "solve_bundle observation pose", "must be one of the poses", o.pose);
    require(o.point >= 0 && static_cast<std::size_t>(o.point) < problem.points.size(),
            "solve_bundle observation point", "must be one of the points", o.point);
    require(std::isfinite(o.u + o.v + o.u_right), "solve_bundle observation", "must be finite",
            &o - problem.observations.data());
    require(o.sigma > 0.0F && std::isfinite(o.sigma), "solve_bundle sigma", "must be positive", o.sigma);
    require(o.u_right < 0.0F || (o.sigma_disparity > 0.0F && std::isfinite(o.sigma_disparity)),
            "solve_bundle sigma_disparity", "must be positive", o.sigma_disparity);
  }
  require(std::isfinite(problem.disparity_bias) && std::isfinite(problem.disparity_bias_sigma) &&
              problem.disparity_bias_sigma >= 0.0,
          "solve_bundle disparity_bias", "must be finite with a sigma that is not negative",
          problem.disparity_bias_sigma);
  for (const RelativePose& r : problem.relative_poses) {
    require(is_pose(r.a) && is_pose(r.b) && r.a != r.b, "solve_bundle relative pose",
            "must tie two different poses", r.a);
    require(r.T_a_b.matrix().allFinite() && r.information.allFinite(), "solve_bundle relative pose",
            "must be finite", r.a);
  }
  require(poses == 0 || std::any_of(problem.fixed.begin(), problem.fixed.end(), [](auto f) { return f; }),
          "solve_bundle fixed", "must hold at least one pose: only differences are observed", 0);
}

bool beyond_gate(const RectifiedCamera& camera, const Mat3<double>& R, const Vec3<double>& t,
                 const Vec3<double>& p_world, const BundleObservation& o, double disparity_bias,
                 double gate) {
  const bool stereo = !(o.u_right < 0.0F);
  Vec3<double> e;
  const double disparity = static_cast<double>(o.u) - o.u_right - disparity_bias;
  if (!reprojection_error(camera, R, t, p_world, o.u, o.v, disparity, e)) return true;
  const double inv = 1.0 / o.sigma, inv_d = stereo ? 1.0 / o.sigma_disparity : 0.0;
  e = e.cwiseProduct(Vec3<double>(inv, inv, inv_d));
  return !(e.squaredNorm() <= gate * (stereo ? kGateStereo : kGateMono));
}

}  // namespace

BundleResult solve_bundle(const RectifiedCamera& camera, BundleProblem& problem, const BundleOptions& options,
                          const std::atomic<bool>* stop) {
  check(camera, problem);
  BundleState state{problem.T_camera_world, {}, problem.points, problem.disparity_bias};
  for (const SE3d& T : state.T_camera_world) state.R.push_back(T.rotation().matrix());

  // A point is determined by a disparity or by two poses.
  std::vector<int> seen_from(problem.points.size(), -1);
  std::vector<std::uint8_t> determined(problem.points.size(), 0);
  for (const BundleObservation& o : problem.observations) {
    auto& from = seen_from[static_cast<std::size_t>(o.point)];
    if (!(o.u_right < 0.0F) || (from >= 0 && from != o.pose))
      determined[static_cast<std::size_t>(o.point)] = 1;
    from = o.pose;
  }

  BundleResult result;
  for (const BundleObservation& o : problem.observations)
    result.unused += !determined[static_cast<std::size_t>(o.point)];
  BundleSolver solver(camera, problem, options, determined);
  std::vector<std::uint8_t> relative_outlier(problem.relative_poses.size(), 0);
  const auto mark = [&] {
    result.outlier.assign(problem.observations.size(), 0);
    result.outliers = 0;
    for (std::size_t i = 0; i < problem.observations.size(); ++i) {
      const BundleObservation& o = problem.observations[i];
      const auto pose = static_cast<std::size_t>(o.pose);
      result.outlier[i] =
          beyond_gate(camera, state.R[pose], state.T_camera_world[pose].translation(),
                      state.points[static_cast<std::size_t>(o.point)], o, state.bias, options.gate);
      result.outliers += result.outlier[i];
    }
    result.relative_outliers = 0;
    for (std::size_t i = 0; i < problem.relative_poses.size(); ++i) {
      const RelativePose& r = problem.relative_poses[i];
      const Vec6<double> e =
          relative_pose_error(state.T_camera_world[static_cast<std::size_t>(r.a)],
                              state.T_camera_world[static_cast<std::size_t>(r.b)], r.T_a_b);
      relative_outlier[i] = !(e.dot(r.information * e) <= options.gate * kGateRelative);
      result.relative_outliers += relative_outlier[i];
    }
  };
  const auto stop_asked = [&] { return stop && stop->load(std::memory_order_relaxed); };

  result.usable = true;
  if (solver.empty()) result.converged = true;
  for (int round = 0; !solver.empty() && round < 2; ++round) {
    if (stop_asked()) break;
    const BundleSolver::Outcome outcome =
        solver.minimise(state, round == 0 ? options.robust_iterations : options.iterations, stop);
    if (round == 0) result.initial_cost = outcome.initial_cost;
    result.final_cost = outcome.final_cost;
    result.iterations += outcome.iterations;
    result.converged = outcome.converged;
    if (!outcome.usable) {
      result.usable = false;
      return result;
    }
    if (round == 1) break;
    mark();
    if ((result.outliers == 0 && result.relative_outliers == 0) || options.iterations == 0) break;
    for (std::size_t i = 0; i < relative_outlier.size(); ++i)
      if (relative_outlier[i]) solver.switch_off_relative(i);
    for (std::size_t i = 0; i < result.outlier.size(); ++i)
      if (result.outlier[i] && determined[static_cast<std::size_t>(problem.observations[i].point)])
        solver.switch_observation(i, false);
  }
  result.stopped = stop_asked();
  mark();
  if (solver.estimates_bias()) {
    for (std::size_t i = 0; i < result.outlier.size(); ++i)
      if (determined[static_cast<std::size_t>(problem.observations[i].point)])
        solver.switch_observation(i, !result.outlier[i]);
    result.disparity_bias_information = solver.bias_information(state);
  }
  problem.T_camera_world = std::move(state.T_camera_world);
  problem.points = std::move(state.points);
  problem.disparity_bias = state.bias;
  return result;
}

}  // namespace sweepkit
