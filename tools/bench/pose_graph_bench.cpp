// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// A pose graph beside Ceres with automatic derivatives as one would write it: rounds through a flat, each
// keyframe measured from the four before it, 50 loops, started from the chain. Both run until the cost falls
// by less than 1e-6 of itself. Counters: iterations; cost, where they ended; rms_mm from the truth; bound_ms,
// what the least work takes at 16 double operations a cycle of 3 GHz, two AVX units with fused multiplication
// and addition: for each linearisation, 2 x 2 x 6^3 multiplications and additions for the products of each
// edge (its own and the mixed block; the rest follows from these), and a factorisation's multiplications and
// additions.
#include <benchmark/benchmark.h>
#include <ceres/ceres.h>

#include <algorithm>
#include <numbers>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/solve/pose_graph.hpp"

namespace sweepkit {
namespace {

struct Case {
  std::vector<SE3d> truth;
  PoseGraph graph;
};

Vec6<double> draw(Random& random) {
  Vec6<double> xi;
  for (int i = 0; i < 6; ++i) xi[i] = random.normal(0.0, i < 3 ? 0.005 : 0.002);
  return xi;
}

Case make_case(int nodes, int wrong) {
  constexpr int kLoops = 50, kBand = 4;
  Random random(1);
  Case c;
  const int round = nodes / 4;
  for (int k = 0; k < nodes; ++k) {
    const double a = 2.0 * std::numbers::pi * k / round, radius = 3.0 + 0.5 * std::sin(3.0 * a);
    c.truth.emplace_back(SO3d::exp(Vec3<double>(0, 0, a)),
                         Vec3<double>(radius * std::cos(a), radius * std::sin(a), 0));
  }
  Mat6<double> information = Mat6<double>::Zero();
  for (int i = 0; i < 6; ++i) information(i, i) = 1.0 / (i < 3 ? 0.005 * 0.005 : 0.002 * 0.002);
  const auto edge = [&](int i, int j, bool robust) {
    return PoseGraphEdge<SE3d>{i, j,
                               c.truth[static_cast<std::size_t>(i)].inverse() *
                                   c.truth[static_cast<std::size_t>(j)] * SE3d::exp(draw(random)),
                               information, robust};
  };
  c.graph.add_node(c.truth[0], true);
  for (int k = 1; k < nodes; ++k)
    for (int d = 1; d <= std::min(k, kBand); ++d) {
      const auto e = edge(k - d, k, false);
      if (d == 1) c.graph.add_node(c.graph.nodes.back().T_world_node * e.T_i_j);
      c.graph.add_edge(e);
    }
  for (int l = 0; l < kLoops; ++l) {
    const int i = static_cast<int>(random.index(static_cast<std::uint64_t>(nodes - round)));
    c.graph.add_edge(edge(i, i + round - static_cast<int>(random.index(10)), true));
  }
  for (int l = 0; l < wrong; ++l) {
    auto e = edge(static_cast<int>(random.index(static_cast<std::uint64_t>(nodes / 2))), nodes - 1 - l, true);
    e.T_i_j = SE3d::exp(100.0 * draw(random));
    c.graph.add_edge(e);
  }
  return c;
}

void report(benchmark::State& state, const Case& c, const std::vector<SE3d>& poses, int iterations,
            double cost) {
  double sum = 0.0;
  for (std::size_t k = 0; k < poses.size(); ++k)
    sum += (poses[k].translation() - c.truth[k].translation()).squaredNorm();
  state.counters["iterations"] = iterations;
  state.counters["cost"] = cost;
  state.counters["rms_mm"] = 1e3 * std::sqrt(sum / static_cast<double>(poses.size()));
}

void sweepkit_solve(benchmark::State& state, PoseGraphLoss loss, PoseGraphFreedom freedom, int wrong) {
  const Case c = make_case(static_cast<int>(state.range(0)), wrong);
  PoseGraphOptions options;
  options.loss = loss;
  options.freedom = freedom;
  options.function_tolerance = 1e-6;
  PoseGraphResult<SE3d> result;
  for (auto _ : state) result = solve_pose_graph(c.graph, options);
  report(state, c, result.T_world_node, result.iterations, result.final_cost);
  state.counters["rejected"] = static_cast<double>(result.rejected.size());
  if (freedom == PoseGraphFreedom::full) {
    const double operations =
        2.0 * (static_cast<double>(c.graph.edges.size()) * 2.0 * 216.0 + result.products);
    state.counters["bound_ms"] = 1e3 * result.iterations * operations / (16.0 * 3e9);
  }
}
BENCHMARK_CAPTURE(sweepkit_solve, believed, PoseGraphLoss::quadratic, PoseGraphFreedom::full, 0)
    ->Name("solve/pose_graph/sweepkit")
    ->Arg(1000)
    ->Unit(benchmark::kMillisecond);
// Beyond that: each loop tested against all else.
BENCHMARK_CAPTURE(sweepkit_solve, tested, PoseGraphLoss::truncated, PoseGraphFreedom::full, 0)
    ->Name("solve/pose_graph/sweepkit_tested_loops")
    ->Arg(1000)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(sweepkit_solve, wrong, PoseGraphLoss::truncated, PoseGraphFreedom::full, 3)
    ->Name("solve/pose_graph/sweepkit_3_wrong_loops")
    ->Arg(1000)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(sweepkit_solve, yaw, PoseGraphLoss::quadratic, PoseGraphFreedom::yaw, 0)
    ->Name("solve/pose_graph/sweepkit_yaw")
    ->Arg(1000)
    ->Unit(benchmark::kMillisecond);

struct RelativeMotion {
  Eigen::Quaterniond q_j_i;  // measured
  Vec3<double> t_j_i;
  Mat6<double> root;

  template <class T>
  bool operator()(const T* i, const T* j, T* residual) const {
    using Q = Eigen::Quaternion<T>;
    const SE3<T> T_w_i(SO3<T>(Q(Eigen::Map<const Q>(i))), Eigen::Map<const Vec3<T>>(i + 4));
    const SE3<T> T_w_j(SO3<T>(Q(Eigen::Map<const Q>(j))), Eigen::Map<const Vec3<T>>(j + 4));
    const SE3<T> T_j_i(SO3<T>(q_j_i.cast<T>()), t_j_i.cast<T>());
    Eigen::Map<Vec6<T>> r(residual);
    r = root.cast<T>() * (T_j_i * T_w_i.inverse() * T_w_j).log();
    return true;
  }
};

void ceres_solve(benchmark::State& state) {
  const Case c = make_case(static_cast<int>(state.range(0)), 0);
  ceres::Solver::Summary summary;
  std::vector<SE3d> poses;
  for (auto _ : state) {
    std::vector<std::array<double, 7>> blocks;
    for (const auto& node : c.graph.nodes) {
      const Eigen::Quaterniond& q = node.T_world_node.rotation().quaternion();
      const Vec3<double>& t = node.T_world_node.translation();
      blocks.push_back({q.x(), q.y(), q.z(), q.w(), t.x(), t.y(), t.z()});
    }
    ceres::Problem problem;
    using Cost = ceres::AutoDiffCostFunction<RelativeMotion, 6, 7, 7>;
    for (const auto& e : c.graph.edges) {
      const SE3d T_j_i = e.T_i_j.inverse();
      problem.AddResidualBlock(new Cost(new RelativeMotion{T_j_i.rotation().quaternion(), T_j_i.translation(),
                                                           Mat6<double>(e.information.cwiseSqrt())}),
                               nullptr, blocks[static_cast<std::size_t>(e.i)].data(),
                               blocks[static_cast<std::size_t>(e.j)].data());
    }
    using Manifold = ceres::ProductManifold<ceres::EigenQuaternionManifold, ceres::EuclideanManifold<3>>;
    for (auto& block : blocks) problem.SetManifold(block.data(), new Manifold);
    problem.SetParameterBlockConstant(blocks[0].data());
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
    options.function_tolerance = 1e-6;
    options.logging_type = ceres::SILENT;
    ceres::Solve(options, &problem, &summary);
    poses.clear();
    for (const auto& x : blocks)
      poses.emplace_back(SO3d(Eigen::Quaterniond(x[3], x[0], x[1], x[2])), Vec3<double>(x[4], x[5], x[6]));
  }
  report(state, c, poses, static_cast<int>(summary.iterations.size()) - 1, summary.final_cost);
}
BENCHMARK(ceres_solve)->Name("solve/pose_graph/ceres")->Arg(1000)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace sweepkit
