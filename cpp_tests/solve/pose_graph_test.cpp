// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/solve/pose_graph.hpp"

#include <ceres/ceres.h>

#include <atomic>
#include <catch2/catch.hpp>
#include <limits>
#include <numbers>
#include <numeric>

#include "geometry/jacobian_check.hpp"
#include "solve/random_graph.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/core/simd.hpp"
#include "sweepkit/solve/pose_graph_error.hpp"

using namespace sweepkit;
using sweepkit::test::draw;
using sweepkit::test::make_rounds;
using sweepkit::test::Rounds;
using sweepkit::test::RoundsOptions;

namespace {

template <class Pose>
double worst(const std::vector<Pose>& a, const std::vector<Pose>& b) {
  double largest = 0.0;
  for (std::size_t k = 0; k < a.size(); ++k)
    largest = std::max(largest, (a[k].matrix() - b[k].matrix()).cwiseAbs().maxCoeff());
  return largest;
}

PoseGraphOptions tight() {
  PoseGraphOptions options;
  options.function_tolerance = 0.0;
  options.step_tolerance = 1e-11;
  return options;
}

// The same edges with automatic derivatives, as one would write them: quaternion x y z w, translation.
struct RelativeMotion {
  SE3d T_j_i;  // measured
  Mat6<double> root;

  template <class T>
  bool operator()(const T* i, const T* j, T* residual) const {
    using Q = Eigen::Quaternion<T>;
    const SE3<T> T_w_i(SO3<T>(Q(Eigen::Map<const Q>(i))), Eigen::Map<const Vec3<T>>(i + 4));
    const SE3<T> T_w_j(SO3<T>(Q(Eigen::Map<const Q>(j))), Eigen::Map<const Vec3<T>>(j + 4));
    Eigen::Map<Vec6<T>> r(residual);
    r = root.cast<T>() * (T_j_i.cast<T>() * T_w_i.inverse() * T_w_j).log();
    return true;
  }
};

std::vector<SE3d> solve_with_ceres(const PoseGraph& graph, double& cost) {
  std::vector<std::array<double, 7>> blocks;
  for (const auto& node : graph.nodes) {
    const Eigen::Quaterniond& q = node.T_world_node.rotation().quaternion();
    const Vec3<double>& t = node.T_world_node.translation();
    blocks.push_back({q.x(), q.y(), q.z(), q.w(), t.x(), t.y(), t.z()});
  }
  ceres::Problem problem;
  for (const auto& e : graph.edges)
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<RelativeMotion, 6, 7, 7>(new RelativeMotion{
                                 e.T_i_j.inverse(), Mat6<double>(e.information.llt().matrixU())}),
                             nullptr, blocks[static_cast<std::size_t>(e.i)].data(),
                             blocks[static_cast<std::size_t>(e.j)].data());
  using Manifold = ceres::ProductManifold<ceres::EigenQuaternionManifold, ceres::EuclideanManifold<3>>;
  for (std::size_t k = 0; k < blocks.size(); ++k) {
    problem.SetManifold(blocks[k].data(), new Manifold);
    if (graph.nodes[k].fixed) problem.SetParameterBlockConstant(blocks[k].data());
  }
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.function_tolerance = 1e-16;
  options.gradient_tolerance = 1e-14;
  options.parameter_tolerance = 1e-14;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  cost = summary.final_cost;
  std::vector<SE3d> poses;
  for (const auto& x : blocks)
    poses.emplace_back(SO3d(Eigen::Quaterniond(x[3], x[0], x[1], x[2])), Vec3<double>(x[4], x[5], x[6]));
  return poses;
}

}  // namespace

TEMPLATE_TEST_CASE("errors of edges are what was put there and have exact Jacobians", "[solve]", SE3d,
                   Sim3d) {
  using Tangent = typename TestType::Tangent;
  using Jacobian = Eigen::Matrix<double, Tangent::RowsAtCompileTime, Tangent::RowsAtCompileTime>;
  Random random(5);
  for (int k = 0; k < 20; ++k) {
    const TestType T_w_i = TestType::exp(draw<TestType>(random, 5.0, 0.6));
    const TestType T_w_j = TestType::exp(draw<TestType>(random, 5.0, 0.6));
    const Tangent e = draw<TestType>(random, 0.5, 0.4);
    const TestType T_i_j = T_w_i.inverse() * T_w_j * TestType::exp(-e);
    Jacobian J_i, J_j;
    REQUIRE((pose_graph_error(T_w_i, T_w_j, T_i_j, &J_i, &J_j) - e).norm() < 1e-11);
    const Tangent zero = Tangent::Zero();
    test::check_jacobian(
        [&](const Tangent& d) { return pose_graph_error(T_w_i * TestType::exp(d), T_w_j, T_i_j); }, zero, J_i,
        1e-8);
    test::check_jacobian(
        [&](const Tangent& d) { return pose_graph_error(T_w_i, T_w_j * TestType::exp(d), T_i_j); }, zero, J_j,
        1e-8);
  }
}

TEST_CASE("level motions keep the tilt and have exact directions", "[solve]") {
  Random random(6);
  for (int k = 0; k < 20; ++k) {
    const SE3d T = SE3d::exp(draw<SE3d>(random, 3.0, 1.0));
    const Vec3<double> up = draw<SE3d>(random, 1.0, 1.0).head<3>().normalized();
    const auto along = [&](const Eigen::Vector4d& x) -> Vec6<double> {
      return (T.inverse() * move_level(T, x, up)).log();
    };
    test::check_jacobian(along, Eigen::Vector4d(Eigen::Vector4d::Zero()), level_motion_basis(T, up), 1e-8);
    const SE3d moved = move_level(T, {0.3, -0.2, 0.5, 2.0}, up);
    REQUIRE((moved.rotation().inverse() * up - T.rotation().inverse() * up).norm() < 1e-14);
  }
}

TEMPLATE_TEST_CASE("exact measurements give back the truth from a start far off", "[solve]", SE3d, Sim3d) {
  RoundsOptions o;
  o.noise = 0.0;
  Rounds<TestType> rounds = make_rounds<TestType>(o);
  Random random(2);
  for (auto& node : rounds.graph.nodes)
    if (!node.fixed) node.T_world_node = node.T_world_node * TestType::exp(draw<TestType>(random, 0.3, 0.2));
  const auto result = solve_pose_graph(rounds.graph, tight());
  REQUIRE(result.usable);
  REQUIRE(result.converged);
  CHECK(result.initial_cost > 1e3);
  CHECK(result.final_cost < 1e-15);
  CHECK(worst(result.T_world_node, rounds.truth) < 1e-9);
  CHECK(result.rejected.empty());
  CHECK(result.components == 1);
  CHECK(result.held.empty());
}

TEMPLATE_TEST_CASE("moving everything by a motion moves the result by it", "[solve]", SE3d, Sim3d) {
  const Rounds<TestType> rounds = make_rounds<TestType>({});
  Random random(3);
  TestType T_map_world = TestType::exp(draw<TestType>(random, 4.0, 0.5));
  auto moved = rounds.graph;
  for (auto& node : moved.nodes) node.T_world_node = T_map_world * node.T_world_node;
  const auto a = solve_pose_graph(rounds.graph, tight()), b = solve_pose_graph(moved, tight());
  CHECK(a.final_cost == Approx(b.final_cost).epsilon(1e-9));
  std::vector<TestType> expected;
  for (const auto& T : a.T_world_node) expected.push_back(T_map_world * T);
  CHECK(worst(b.T_world_node, expected) < 1e-8);
}

TEST_CASE("the result is that of Ceres with automatic derivatives", "[solve]") {
  RoundsOptions o;
  o.nodes = 120;
  const Rounds<SE3d> rounds = make_rounds<SE3d>(o);
  double cost = 0.0;
  const std::vector<SE3d> reference = solve_with_ceres(rounds.graph, cost);
  PoseGraphOptions options = tight();
  options.loss = PoseGraphLoss::quadratic;
  const auto result = solve_pose_graph(rounds.graph, options);
  CHECK(result.final_cost == Approx(cost).epsilon(1e-9));
  CHECK(worst(result.T_world_node, reference) < 1e-6);
  // No edge is wrong, so the truncated loss says the same; the default tolerances come close.
  CHECK(worst(solve_pose_graph(rounds.graph).T_world_node, reference) < 1e-6);
  const double half_sum = 0.5 * std::accumulate(result.chi2.begin(), result.chi2.end(), 0.0);
  CHECK(half_sum == Approx(result.final_cost).epsilon(1e-12));
}

TEST_CASE("with yaw alone free the tilt stays and the cost is the least of its kind", "[solve]") {
  RoundsOptions o;
  o.sigma_phi = 0.02;
  Rounds<SE3d> rounds = make_rounds<SE3d>(o);
  rounds.graph.up_world = Vec3<double>(0.1, -0.2, 0.97).normalized();
  const Vec3<double> up = rounds.graph.up_world;
  PoseGraphOptions options = tight();
  options.freedom = PoseGraphFreedom::yaw;
  options.loss = PoseGraphLoss::quadratic;
  options.tilt_sigma = 0.0;
  const auto result = solve_pose_graph(rounds.graph, options);
  REQUIRE(result.converged);
  CHECK(result.final_cost < 0.9 * result.initial_cost);
  for (std::size_t k = 0; k < rounds.graph.nodes.size(); ++k) {
    const SO3d& before = rounds.graph.nodes[k].T_world_node.rotation();
    const SO3d& after = result.T_world_node[k].rotation();
    REQUIRE((before.inverse() * up - after.inverse() * up).norm() < 1e-12);
  }
  const auto cost = [&](const std::vector<SE3d>& x) {
    double sum = 0.0;
    for (const auto& e : rounds.graph.edges) {
      const Vec6<double> r =
          pose_graph_error(x[static_cast<std::size_t>(e.i)], x[static_cast<std::size_t>(e.j)], e.T_i_j);
      sum += 0.5 * r.dot(e.information * r);
    }
    return sum;
  };
  CHECK(cost(result.T_world_node) == Approx(result.final_cost).epsilon(1e-12));
  // No level motion of a node brings the cost down.
  for (const std::size_t k : {1U, 20U, 79U})
    for (int d = 0; d < 4; ++d)
      for (const double step : {-1e-5, 1e-5}) {
        auto x = result.T_world_node;
        x[k] = move_level(x[k], step * Eigen::Vector4d::Unit(d), up);
        CHECK(cost(x) > result.final_cost);
      }
  // Where the tilt is right, it finds the truth.
  o.noise = 0.0;
  Rounds<SE3d> exact = make_rounds<SE3d>(o);
  for (std::size_t k = 1; k < exact.graph.nodes.size(); ++k)
    exact.graph.nodes[k].T_world_node =
        move_level(exact.graph.nodes[k].T_world_node, {0.2, -0.1, 0.1, 0.01 * static_cast<double>(k)},
                   exact.graph.up_world);
  CHECK(worst(solve_pose_graph(exact.graph, options).T_world_node, exact.truth) < 1e-9);
}

TEST_CASE("with yaw alone free, tilts that are a little wrong contradict no loop", "[solve]") {
  PoseGraphOptions options = tight();
  options.freedom = PoseGraphFreedom::yaw;
  int rejected_exact = 0;
  double error = 0.0, error_before = 0.0;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    RoundsOptions o;
    o.seed = seed;
    o.sigma_phi = 0.002;
    Rounds<SE3d> rounds = make_rounds<SE3d>(o);
    Random random(seed);
    for (std::size_t k = 1; k < rounds.truth.size(); ++k) {
      SE3d& T = rounds.graph.nodes[k].T_world_node;
      error_before += (T.translation() - rounds.truth[k].translation()).norm();
      const Vec3<double> tilt =
          0.3 * std::numbers::pi / 180.0 * Vec3<double>(random.normal(), random.normal(), 0);
      T = SE3d(SO3d::exp(tilt) * rounds.truth[k].rotation(), T.translation());
    }
    options.tilt_sigma = 0.3;
    const auto result = solve_pose_graph(rounds.graph, options);
    CHECK(result.rejected.empty());
    for (std::size_t k = 1; k < rounds.truth.size(); ++k)
      error += (result.T_world_node[k].translation() - rounds.truth[k].translation()).norm();
    options.tilt_sigma = 0.0;
    rejected_exact += static_cast<int>(solve_pose_graph(rounds.graph, options).rejected.size());
  }
  CHECK(error < 0.7 * error_before);
  CHECK(rejected_exact > 0);
}

TEST_CASE("wrong loops are found out, and what is left is as if they had not been", "[solve]") {
  for (const int band : {1, 2})
    for (std::uint64_t seed = 1; seed <= 4; ++seed) {
      RoundsOptions o;
      o.band = band;
      o.seed = seed;
      Rounds<SE3d> rounds = make_rounds<SE3d>(o);
      for (const PoseGraphFreedom freedom : {PoseGraphFreedom::full, PoseGraphFreedom::yaw}) {
        PoseGraphOptions options = tight();
        options.freedom = freedom;
        // Nodes of the truth's tilt, which freedom yaw takes as known.
        PoseGraph graph = rounds.graph;
        for (std::size_t k = 0; k < graph.nodes.size(); ++k)
          graph.nodes[k].T_world_node =
              SE3d(rounds.truth[k].rotation(), graph.nodes[k].T_world_node.translation());
        const auto clean = solve_pose_graph(graph, options);
        REQUIRE(clean.rejected.empty());
        Random random(seed + 100);
        std::vector<int> wrong;
        for (const auto& [i, j] : {std::pair(3, 35), std::pair(20, 61), std::pair(75, 12)})
          wrong.push_back(graph.add_edge(
              {i, j, SE3d::exp(draw<SE3d>(random, 0.3, 0.3)), rounds.graph.edges.back().information, true}));
        const auto result = solve_pose_graph(graph, options);
        REQUIRE(result.usable);
        CHECK(result.rejected == wrong);
        CHECK(worst(result.T_world_node, clean.T_world_node) < 1e-7);
        for (const int l : wrong) {
          CHECK(result.weight[static_cast<std::size_t>(l)] == 0.0);
          CHECK(result.contradiction[static_cast<std::size_t>(l)] > 100.0);
        }
      }
    }
}

TEST_CASE("a single wrong loop on a chain is seen, though hardly any error is left in it", "[solve]") {
  RoundsOptions o;
  o.band = 1;
  o.loops = 0;
  Rounds<SE3d> rounds = make_rounds<SE3d>(o);
  const int loop = rounds.graph.add_edge(
      {0, 79, SE3d(SO3d(), Vec3<double>(2.0, 0.0, 0.0)), rounds.graph.edges.back().information, true});
  PoseGraphOptions believed;
  believed.loss = PoseGraphLoss::quadratic;
  const auto bent = solve_pose_graph(rounds.graph, believed);
  const auto result = solve_pose_graph(rounds.graph);
  CHECK(bent.chi2[static_cast<std::size_t>(loop)] <
        0.2 * result.contradiction[static_cast<std::size_t>(loop)]);
  CHECK(result.rejected == std::vector<int>{loop});
  CHECK(result.final_cost == Approx(0.5 * 22.4577).epsilon(1e-4));
  // And the contradiction is the innovation of that edge against the chain.
  PoseGraph chain = rounds.graph;
  chain.edges.pop_back();
  PoseGraphOptions options = tight();
  options.covariances = true;
  const auto free_end = solve_pose_graph(chain, options);
  Mat6<double> J_i, J_j;
  const auto& edge = rounds.graph.edges.back();
  const Vec6<double> e =
      pose_graph_error(free_end.T_world_node[0], free_end.T_world_node[79], edge.T_i_j, &J_i, &J_j);
  const Mat6<double> S =
      J_j * free_end.covariance[79] * J_j.transpose() + Mat6<double>(edge.information.inverse());
  CHECK(result.contradiction[static_cast<std::size_t>(loop)] == Approx(e.dot(S.inverse() * e)).epsilon(1e-6));
}

TEST_CASE("wrong loops that agree with each other are found out by the right ones", "[solve]") {
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    RoundsOptions o;
    o.band = 1;
    o.seed = seed;
    Rounds<SE3d> rounds = make_rounds<SE3d>(o);
    const auto clean = solve_pose_graph(rounds.graph, tight());
    REQUIRE(clean.rejected.empty());
    // Places 10 and 30 look alike, and so do those after them.
    std::vector<int> wrong;
    for (int k = 0; k < 5; ++k) {
      const auto at = [&](int n) { return rounds.truth[static_cast<std::size_t>(n)]; };
      const SE3d T_i_j = at(10 + k).inverse() * at(10) * at(30).inverse() * at(30 + k);
      wrong.push_back(
          rounds.graph.add_edge({10 + k, 30 + k, T_i_j, rounds.graph.edges.back().information, true}));
    }
    const auto result = solve_pose_graph(rounds.graph, tight());
    CHECK(result.rejected == wrong);
    CHECK(worst(result.T_world_node, clean.T_world_node) < 1e-7);
  }
}

TEST_CASE("contradictions of right loops are distributed as chi-square", "[solve]") {
  double sum = 0.0;
  int count = 0;
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    RoundsOptions o;
    o.seed = seed;
    o.nodes = 60;
    const Rounds<SE3d> rounds = make_rounds<SE3d>(o);
    const auto result = solve_pose_graph(rounds.graph);
    for (std::size_t l = static_cast<std::size_t>(rounds.first_loop); l < result.contradiction.size(); ++l) {
      sum += result.contradiction[l];
      ++count;
    }
    for (int l = 0; l < rounds.first_loop; ++l)
      REQUIRE(result.contradiction[static_cast<std::size_t>(l)] == 0.0);
  }
  CHECK(sum / count == Approx(6.0).margin(1.0));
}

TEST_CASE("other losses weigh wrong loops down", "[solve]") {
  Rounds<SE3d> rounds = make_rounds<SE3d>({});
  const SE3d true_end = rounds.truth[30];
  const int wrong = rounds.graph.add_edge(
      {1, 30, rounds.truth[1].inverse() * true_end * SE3d(SO3d(), Vec3<double>(0.5, 0.5, 0)),
       rounds.graph.edges.back().information, true});
  double error_quadratic = 0.0;
  for (const PoseGraphLoss loss : {PoseGraphLoss::quadratic, PoseGraphLoss::huber, PoseGraphLoss::cauchy,
                                   PoseGraphLoss::geman_mcclure, PoseGraphLoss::truncated}) {
    PoseGraphOptions options;
    options.loss = loss;
    const auto result = solve_pose_graph(rounds.graph, options);
    REQUIRE(result.converged);
    const double error = (result.T_world_node[30].translation() - true_end.translation()).norm();
    const double weight = result.weight[static_cast<std::size_t>(wrong)];
    if (loss == PoseGraphLoss::quadratic) {
      error_quadratic = error;
      CHECK(weight == 1.0);
      CHECK(result.rejected.empty());
    } else {
      CHECK(error < 0.7 * error_quadratic);
      CHECK(weight < 0.5);
      CHECK(result.rejected == std::vector<int>{wrong});
    }
    CHECK(result.final_cost < result.initial_cost);
  }
}

TEST_CASE("parts without a fixed node hold their first, and fixed nodes stay to the last bit", "[solve]") {
  Rounds<SE3d> rounds = make_rounds<SE3d>({});
  PoseGraph graph = rounds.graph;
  const int offset = static_cast<int>(graph.nodes.size());
  for (const auto& node : rounds.graph.nodes) graph.add_node(node.T_world_node);
  for (auto edge : rounds.graph.edges) {
    edge.i += offset;
    edge.j += offset;
    graph.add_edge(edge);
  }
  const int lone = graph.add_node(SE3d::exp((Vec6<double>() << 1, 2, 3, 0.1, 0.2, 0.3).finished()));
  graph.nodes[17].fixed = true;
  const auto result = solve_pose_graph(graph);
  REQUIRE(result.usable);
  CHECK(result.components == 3);
  CHECK((result.held == std::vector<int>{offset, lone}));
  for (const int k : {0, 17, offset, lone})
    CHECK(result.T_world_node[static_cast<std::size_t>(k)].matrix() ==
          graph.nodes[static_cast<std::size_t>(k)].T_world_node.matrix());
  const auto again = solve_pose_graph(graph);
  CHECK(worst(result.T_world_node, again.T_world_node) == 0.0);

  CHECK(solve_pose_graph(PoseGraph{}).usable);
  PoseGraph single;
  single.add_node(SE3d());
  CHECK(solve_pose_graph(single).T_world_node.size() == 1);
}

TEST_CASE("two maps joined by one loop stay joined, and by two that contradict each other by one",
          "[solve]") {
  RoundsOptions o;
  o.nodes = 40;
  o.loops = 0;
  const Rounds<SE3d> rounds = make_rounds<SE3d>(o);
  PoseGraph graph = rounds.graph;
  for (const auto& node : rounds.graph.nodes)
    graph.add_node(SE3d(SO3d(), Vec3<double>(9, 0, 0)) * node.T_world_node);
  for (auto edge : rounds.graph.edges) {
    edge.i += 40;
    edge.j += 40;
    graph.add_edge(edge);
  }
  const Mat6<double> information = rounds.graph.edges[0].information;
  const int join = graph.add_edge({10, 50, SE3d(), information, true});
  auto result = solve_pose_graph(graph);
  CHECK(result.components == 1);
  CHECK(result.rejected.empty());
  CHECK(result.contradiction[static_cast<std::size_t>(join)] < 1e-6);
  CHECK((result.T_world_node[10].matrix() - result.T_world_node[50].matrix()).norm() < 1e-6);

  graph.add_edge({20, 60, SE3d(SO3d(), Vec3<double>(1, 0, 0)), information, true});
  result = solve_pose_graph(graph);
  REQUIRE(result.usable);
  CHECK(result.rejected.size() == 1);
}

TEST_CASE("covariances are those of the dense inverse", "[solve]") {
  RoundsOptions o;
  o.nodes = 25;
  o.nodes_a_round = 12;
  const Rounds<SE3d> rounds = make_rounds<SE3d>(o);
  PoseGraphOptions options = tight();
  options.covariances = true;
  options.loss = PoseGraphLoss::quadratic;
  options.tilt_sigma = 0.0;
  for (const PoseGraphFreedom freedom : {PoseGraphFreedom::full, PoseGraphFreedom::yaw}) {
    options.freedom = freedom;
    const auto result = solve_pose_graph(rounds.graph, options);
    const int d = freedom == PoseGraphFreedom::full ? 6 : 4;
    Eigen::MatrixXd J = Eigen::MatrixXd::Zero(6 * static_cast<int>(rounds.graph.edges.size()), 25 * d);
    const auto basis = [&](int k) -> Eigen::MatrixXd {
      if (d == 6) return Mat6<double>::Identity();
      return level_motion_basis(result.T_world_node[static_cast<std::size_t>(k)], Vec3<double>::UnitZ());
    };
    for (std::size_t l = 0; l < rounds.graph.edges.size(); ++l) {
      const auto& e = rounds.graph.edges[l];
      Mat6<double> J_i, J_j;
      pose_graph_error(result.T_world_node[static_cast<std::size_t>(e.i)],
                       result.T_world_node[static_cast<std::size_t>(e.j)], e.T_i_j, &J_i, &J_j);
      const Mat6<double> U = e.information.llt().matrixU();
      const int row = 6 * static_cast<int>(l);
      J.block(row, d * e.i, 6, d) = U * J_i * basis(e.i);
      J.block(row, d * e.j, 6, d) = U * J_j * basis(e.j);
    }
    const Eigen::MatrixXd free = J.rightCols(24 * d);
    const Eigen::MatrixXd inverse = (free.transpose() * free).inverse();
    CHECK(result.covariance[0].norm() == 0.0);
    for (int k = 1; k < 25; ++k) {
      const Eigen::MatrixXd expected =
          basis(k) * inverse.block((k - 1) * d, (k - 1) * d, d, d) * basis(k).transpose();
      REQUIRE((result.covariance[static_cast<std::size_t>(k)] - expected).norm() < 1e-8 * expected.norm());
    }
  }
}

TEST_CASE("portable and wide kernels give identical bits", "[solve]") {
  const auto check = [](const auto& graph, PoseGraphOptions options) {
    options.covariances = true;
    const auto wide = solve_pose_graph(graph, options);
    const ScopedSimdLevel level(SimdLevel::portable);
    const auto portable = solve_pose_graph(graph, options);
    CHECK(worst(wide.T_world_node, portable.T_world_node) == 0.0);
    CHECK(wide.contradiction == portable.contradiction);
    CHECK(wide.covariance.back() == portable.covariance.back());
  };
  PoseGraphOptions options;
  check(make_rounds<SE3d>({}).graph, options);
  check(make_rounds<Sim3d>({}).graph, options);
  options.freedom = PoseGraphFreedom::yaw;
  check(make_rounds<SE3d>({}).graph, options);
}

TEST_CASE("a pose graph that cannot be is refused by name", "[solve]") {
  const Rounds<SE3d> rounds = make_rounds<SE3d>({});
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto message = [](const PoseGraph& graph, const PoseGraphOptions& options = {}) -> std::string {
    try {
      solve_pose_graph(graph, options);
    } catch (const Error& error) {
      return error.what();
    }
    return "nothing thrown";
  };
  using Catch::Contains;
  PoseGraph graph = rounds.graph;
  graph.edges[7].information = -graph.edges[7].information;
  CHECK_THAT(message(graph), Contains("edge 7") && Contains("positive definite"));
  graph.edges[7].information.setZero();
  CHECK_THAT(message(graph), Contains("edge 7") && Contains("positive definite"));
  graph.edges[7].information = Mat6<double>::Identity();
  graph.edges[7].information(0, 1) = 0.5;
  CHECK_THAT(message(graph), Contains("edge 7") && Contains("symmetric"));
  graph.edges[7].information(0, 1) = nan;
  CHECK_THAT(message(graph), Contains("edge 7") && Contains("finite"));
  graph = rounds.graph;
  graph.edges[9].T_i_j = SE3d(SO3d(), Vec3<double>(0, nan, 0));
  CHECK_THAT(message(graph), Contains("edge 9") && Contains("finite"));
  graph = rounds.graph;
  graph.nodes[3].T_world_node = SE3d(SO3d(Eigen::Quaterniond(nan, 0, 0, 0)), Vec3<double>::Zero());
  CHECK_THAT(message(graph), Contains("node 3") && Contains("finite"));
  graph = rounds.graph;
  graph.edges[2].j = 80;
  CHECK_THAT(message(graph), Contains("edge 2") && Contains("80"));
  graph.edges[2].j = graph.edges[2].i;
  CHECK_THAT(message(graph), Contains("edge 2") && Contains("itself"));
  graph = rounds.graph;
  graph.up_world = Vec3<double>::Zero();
  PoseGraphOptions options;
  options.freedom = PoseGraphFreedom::yaw;
  CHECK_THAT(message(graph, options), Contains("up_world"));
  CHECK_THROWS_AS(solve_pose_graph(make_rounds<Sim3d>({}).graph, options), Error);
  options.iterations = 0;
  CHECK_THROWS_AS(solve_pose_graph(rounds.graph, options), Error);
}

TEST_CASE("a solver asked to stop gives what it has", "[solve]") {
  const Rounds<SE3d> rounds = make_rounds<SE3d>({});
  const std::atomic<bool> stop{true};
  const auto result = solve_pose_graph(rounds.graph, {}, &stop);
  CHECK(result.stopped);
  CHECK(result.usable);
  CHECK(result.iterations == 0);
  CHECK(result.T_world_node.size() == rounds.graph.nodes.size());
}
