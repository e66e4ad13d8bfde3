// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// Pose of one image and bundle adjustment of a window, beside Ceres with automatic derivatives as one would
// write it. Counters: iterations, and error_mm, how far the (worst) camera is from the truth.
#include <benchmark/benchmark.h>
#include <ceres/ceres.h>

#include <algorithm>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/solve/bundle.hpp"
#include "sweepkit/solve/pose.hpp"

namespace sweepkit {
namespace {

const RectifiedCamera kCamera{450.0, 320.5, 199.5, 0.11};

Vec6<double> draw(Random& random, double rho, double phi) {
  Vec6<double> xi;
  for (int i = 0; i < 6; ++i) xi[i] = random.normal(0.0, i < 3 ? rho : phi);
  return xi;
}

double error_mm(const SE3d& T_camera_world, const SE3d& truth) {
  return 1e3 * (T_camera_world.inverse().translation() - truth.inverse().translation()).norm();
}

// A pose as quaternion x y z w and translation; errors of u, v and, for three rows, of the disparity.
template <int kRows>
struct Reprojection {
  double u, v, disparity, sigma, sigma_disparity;

  template <class T>
  bool operator()(const T* pose, const T* point, T* residual) const {
    const Vec3<T> p = Eigen::Map<const Eigen::Quaternion<T>>(pose) * Eigen::Map<const Vec3<T>>(point) +
                      Eigen::Map<const Vec3<T>>(pose + 4);
    residual[0] = (kCamera.focal * p.x() / p.z() + kCamera.cx - u) / sigma;
    residual[1] = (kCamera.focal * p.y() / p.z() + kCamera.cy - v) / sigma;
    if constexpr (kRows == 3)
      residual[2] = (kCamera.focal * kCamera.baseline / p.z() - disparity) / sigma_disparity;
    return true;
  }
};

template <class Observation>
void add_to(ceres::Problem& problem, const Observation& o, double* pose, double* point) {
  const double d = static_cast<double>(o.u) - o.u_right;
  if (o.u_right < 0.0F)
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Reprojection<2>, 2, 7, 3>(
                                 new Reprojection<2>{o.u, o.v, d, o.sigma, o.sigma_disparity}),
                             new ceres::HuberLoss(2.4477), pose, point);
  else
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Reprojection<3>, 3, 7, 3>(
                                 new Reprojection<3>{o.u, o.v, d, o.sigma, o.sigma_disparity}),
                             new ceres::HuberLoss(2.7955), pose, point);
}

using PoseManifold = ceres::ProductManifold<ceres::EigenQuaternionManifold, ceres::EuclideanManifold<3>>;

std::array<double, 7> to_block(const SE3d& T) {
  const auto& q = T.rotation().quaternion();
  return {q.x(), q.y(), q.z(), q.w(), T.translation().x(), T.translation().y(), T.translation().z()};
}
SE3d to_motion(const std::array<double, 7>& x) {
  return {SO3d(Eigen::Quaterniond(x[3], x[0], x[1], x[2])), Vec3<double>(x[4], x[5], x[6])};
}

// 10 % outliers, 70 % with disparity; the start is off by 2 cm and 0.5 degrees a coordinate.
struct PoseCase {
  SE3d truth, start;
  std::vector<PoseObservation> observations;
};

PoseCase make_pose_case(std::int64_t count) {
  Random random(1);
  PoseCase c;
  c.truth = SE3d::exp(draw(random, 5.0, 1.0));
  c.start = SE3d::exp(draw(random, 0.02, 0.01)) * c.truth;
  for (std::int64_t i = 0; i < count; ++i) {
    const double z = random.uniform(1, 10), u = random.uniform(0, 640), v = random.uniform(0, 400);
    PoseObservation o;
    o.p_world = c.truth.inverse() *
                Vec3<double>((u - kCamera.cx) / kCamera.focal * z, (v - kCamera.cy) / kCamera.focal * z, z);
    o.sigma_disparity = 0.3F;
    const bool outlier = random.uniform() < 0.1;
    o.u = static_cast<float>(outlier ? random.uniform(0, 640) : random.normal(u, 1.0));
    o.v = static_cast<float>(outlier ? random.uniform(0, 400) : random.normal(v, 1.0));
    if (random.uniform() < 0.7)
      o.u_right = std::max(0.0F, static_cast<float>(o.u - kCamera.disparity(z) + 0.3 * random.normal()));
    c.observations.push_back(o);
  }
  return c;
}

void pose_sweepkit(benchmark::State& state) {
  const PoseCase c = make_pose_case(state.range(0));
  std::vector<std::uint8_t> inlier;
  PoseWorkspace workspace;
  PoseResult result;
  for (auto _ : state) {
    result = solve_pose(kCamera, c.start, c.observations, PoseOptions{}, inlier, nullptr, &workspace);
    benchmark::DoNotOptimize(result);
  }
  state.counters["iterations"] = result.iterations;
  state.counters["error_mm"] = error_mm(result.T_camera_world, c.truth);
}
BENCHMARK(pose_sweepkit)->Name("solve/pose/sweepkit")->Arg(300)->Unit(benchmark::kMicrosecond);

void pose_ceres(benchmark::State& state) {
  PoseCase c = make_pose_case(state.range(0));
  ceres::Solver::Summary summary;
  std::array<double, 7> pose{};
  for (auto _ : state) {
    pose = to_block(c.start);
    ceres::Problem problem;
    for (PoseObservation& o : c.observations) {
      add_to(problem, o, pose.data(), o.p_world.data());
      problem.SetParameterBlockConstant(o.p_world.data());
    }
    problem.SetManifold(pose.data(), new PoseManifold);
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
    options.logging_type = ceres::SILENT;
    options.max_num_iterations = 10;
    ceres::Solve(options, &problem, &summary);
  }
  state.counters["iterations"] = static_cast<double>(summary.iterations.size()) - 1.0;
  state.counters["error_mm"] = error_mm(to_motion(pose), c.truth);
}
BENCHMARK(pose_ceres)->Name("solve/pose/ceres")->Arg(300)->Unit(benchmark::kMicrosecond);

// A window of key frames, two of them fixed, 200 points and 1000 observations for each; the start is off by
// 1 cm and 0.3 degrees a coordinate, points by 5 cm.
struct BundleCase {
  BundleProblem truth, start;
};

BundleCase make_bundle_case(std::int64_t poses) {
  Random random(1);
  BundleCase c;
  for (std::int64_t k = 0; k < poses; ++k) {
    Vec6<double> xi = draw(random, 0.02, 0.02);
    xi[2] += 0.1 * static_cast<double>(k);
    c.truth.T_camera_world.push_back(SE3d::exp(xi).inverse());
    c.truth.fixed.push_back(k < 2);
  }
  for (int i = 0; i < 200 * poses; ++i) {
    const double z = 0.1 * static_cast<double>(poses) + random.uniform(1, 8);
    c.truth.points.emplace_back(random.uniform(-0.6, 0.6) * z, random.uniform(-0.4, 0.4) * z, z);
    for (int j = 0; j < 5; ++j) {
      BundleObservation o{static_cast<int>((i + j) % poses), i};
      const auto m = kCamera.project_stereo(c.truth.T_camera_world[static_cast<std::size_t>(o.pose)] *
                                            c.truth.points.back());
      if (!m) continue;
      o.sigma_disparity = 0.3F;
      o.u = static_cast<float>(random.normal((*m)[0], 1.0));
      o.v = static_cast<float>(random.normal((*m)[1], 1.0));
      if (random.uniform() < 0.6)
        o.u_right = std::max(0.0F, static_cast<float>(o.u - random.normal((*m)[0] - (*m)[2], 0.3)));
      c.truth.observations.push_back(o);
    }
  }
  c.start = c.truth;
  for (std::size_t k = 2; k < c.start.fixed.size(); ++k)
    c.start.T_camera_world[k] = SE3d::exp(draw(random, 0.01, 0.005)) * c.start.T_camera_world[k];
  for (auto& p : c.start.points) p += draw(random, 0.05, 0.0).head<3>();
  return c;
}

void report(benchmark::State& state, const BundleCase& c, const std::vector<SE3d>& poses, int iterations) {
  double worst = 0.0;
  for (std::size_t k = 0; k < poses.size(); ++k)
    worst = std::max(worst, error_mm(poses[k], c.truth.T_camera_world[k]));
  state.counters["error_mm"] = worst;
  state.counters["iterations"] = iterations;
  state.counters["observations"] = static_cast<double>(c.truth.observations.size());
}

void bundle_sweepkit(benchmark::State& state) {
  const BundleCase c = make_bundle_case(state.range(0));
  BundleProblem problem;
  BundleResult result;
  for (auto _ : state) {
    problem = c.start;
    result = solve_bundle(kCamera, problem, BundleOptions{});
  }
  report(state, c, problem.T_camera_world, result.iterations);
}
BENCHMARK(bundle_sweepkit)->Name("solve/bundle/sweepkit")->Arg(10)->Unit(benchmark::kMillisecond);

// One round with Huber's loss, to Ceres' own tolerances.
void bundle_ceres(benchmark::State& state) {
  const BundleCase c = make_bundle_case(state.range(0));
  ceres::Solver::Summary summary;
  std::vector<SE3d> poses;
  for (auto _ : state) {
    std::vector<std::array<double, 7>> blocks;
    for (const SE3d& T : c.start.T_camera_world) blocks.push_back(to_block(T));
    std::vector<Vec3<double>> points = c.start.points;
    ceres::Problem problem;
    for (const BundleObservation& o : c.start.observations)
      add_to(problem, o, blocks[static_cast<std::size_t>(o.pose)].data(),
             points[static_cast<std::size_t>(o.point)].data());
    for (std::size_t k = 0; k < blocks.size(); ++k) {
      problem.SetManifold(blocks[k].data(), new PoseManifold);
      if (c.start.fixed[k]) problem.SetParameterBlockConstant(blocks[k].data());
    }
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_SCHUR;
    options.logging_type = ceres::SILENT;
    ceres::Solve(options, &problem, &summary);
    poses.clear();
    for (const auto& block : blocks) poses.push_back(to_motion(block));
  }
  report(state, c, poses, static_cast<int>(summary.iterations.size()) - 1);
}
BENCHMARK(bundle_ceres)->Name("solve/bundle/ceres_autodiff")->Arg(10)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace sweepkit
