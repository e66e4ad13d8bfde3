// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// Prints what the pose graph makes of graphs whose truth is known, with right and wrong loops: a sphere in
// rounds (all six numbers of a pose turn), a garage of four levels in the plane and between, and a flat swept
// in lanes. Each line is the sum over ten seeds: rms of the positions with the first pose fixed, for the
// start (the chain of odometry), for the right loops alone, for all; which wrong loops stayed in and which
// right ones went out; chi2 a degree of freedom (1 is right); CPU time a graph. A wrong loop joins two nodes
// drawn at random and measures them within about 0.3 m and 0.3 rad of each other.
#include <fmt/format.h>

#include <algorithm>
#include <ctime>
#include <numbers>
#include <string>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/solve/pose_graph.hpp"

namespace sweepkit {
namespace {

using std::numbers::pi;

struct Shape {
  std::string name;
  std::vector<SE3d> truth;
  double sigma_rho, sigma_phi;  // of a step [m, rad]; loops are as good
  double reach;                 // loops join nodes within it [m]
  int apart;                    // and at least so many steps apart
};

SE3d facing(const Vec3<double>& p, double yaw, double pitch = 0.0) {
  return {SO3d::exp(Vec3<double>(0, 0, yaw)) * SO3d::exp(Vec3<double>(0, pitch, 0)), p};
}

Shape sphere() {
  Shape s{"sphere", {}, 0.02, 0.01, 2.5, 40};
  for (int k = 0; k < 1000; ++k) {
    const double polar = pi * (k + 25.0) / 1050.0, turn = 2.0 * pi * k / 50.0;
    s.truth.push_back(facing(10.0 * Vec3<double>(std::sin(polar) * std::cos(turn),
                                                 std::sin(polar) * std::sin(turn), std::cos(polar)),
                             turn + pi / 2, 0.5 * pi - polar));
  }
  return s;
}

Shape garage() {
  Shape s{"garage", {}, 0.02, 0.003, 3.5, 60};
  for (int k = 0; k < 1000; ++k) {
    const double turn = 2.0 * pi * k / 125.0, height = 3.0 * std::floor(k / 250.0);
    const double ramp = std::max(0.0, (k % 250) - 230.0) / 20.0;
    s.truth.push_back(facing(Vec3<double>(25.0 * std::cos(turn), 12.0 * std::sin(turn), height + 3.0 * ramp),
                             turn + pi / 2, ramp > 0.0 ? -0.2 : 0.0));
  }
  return s;
}

Shape lanes() {
  Shape s{"lanes", {}, 0.005, 0.003, 0.35, 12};
  for (int k = 0; k < 1000; ++k) {
    const int lane = k / 25 % 20;
    const double along = 0.2 * (k % 25), x = lane % 2 == 0 ? along : 4.8 - along;
    s.truth.push_back(
        facing(Vec3<double>(x, 0.25 * lane + (k < 500 ? 0.0 : 0.05), 0), lane % 2 == 0 ? 0.0 : pi));
  }
  return s;
}

PoseGraphEdge<SE3d> edge_of(Random& random, const Shape& s, int i, int j, bool robust) {
  Vec6<double> error;
  for (int k = 0; k < 6; ++k) error[k] = random.normal(0.0, k < 3 ? s.sigma_rho : s.sigma_phi);
  PoseGraphEdge<SE3d> e{i, j,
                        s.truth[static_cast<std::size_t>(i)].inverse() *
                            s.truth[static_cast<std::size_t>(j)] * SE3d::exp(-error),
                        Mat6<double>::Zero(), robust};
  for (int k = 0; k < 6; ++k)
    e.information(k, k) = 1.0 / (k < 3 ? s.sigma_rho * s.sigma_rho : s.sigma_phi * s.sigma_phi);
  return e;
}

double squared_error(const Shape& s, const std::vector<SE3d>& poses) {
  double sum = 0.0;
  for (std::size_t k = 0; k < poses.size(); ++k)
    sum += (poses[k].translation() - s.truth[k].translation()).squaredNorm();
  return sum / static_cast<double>(poses.size());
}

void row(const Shape& s, int right, int wrong, bool in_fives) {
  constexpr int kSeeds = 10;
  double start = 0.0, clean = 0.0, all = 0.0, chi2 = 0.0, seconds = 0.0;
  int kept_wrong = 0, lost_right = 0;
  for (int seed = 1; seed <= kSeeds; ++seed) {
    Random random(static_cast<std::uint64_t>(seed));
    PoseGraph graph;
    const auto n = static_cast<int>(s.truth.size());
    graph.add_node(s.truth[0], true);
    for (int k = 1; k < n; ++k) {
      const auto e = edge_of(random, s, k - 1, k, false);
      graph.add_node(graph.nodes.back().T_world_node * e.T_i_j);
      graph.add_edge(e);
    }
    const auto draw = [&] { return static_cast<int>(random.index(static_cast<std::uint64_t>(n))); };
    for (int found = 0; found < right;) {
      const int i = draw(), j = draw();
      if (j - i < s.apart || (s.truth[static_cast<std::size_t>(i)].translation() -
                              s.truth[static_cast<std::size_t>(j)].translation())
                                     .norm() > s.reach)
        continue;
      graph.add_edge(edge_of(random, s, i, j, true));
      ++found;
    }
    const auto first_wrong = static_cast<int>(graph.edges.size());
    std::vector<SE3d> poses;
    for (const auto& node : graph.nodes) poses.push_back(node.T_world_node);
    start += squared_error(s, poses);
    PoseGraphOptions believed;
    believed.loss = PoseGraphLoss::quadratic;
    clean += squared_error(s, solve_pose_graph(graph, believed).T_world_node);
    const int in_group = in_fives ? 5 : 1;
    for (int k = 0; k < wrong; k += in_group) {
      int i = draw(), j = draw();
      while (std::abs(i - j) < 20 || std::max(i, j) > n - in_group) {
        i = draw();
        j = draw();
      }
      Vec6<double> xi;
      for (int d = 0; d < 6; ++d) xi[d] = random.normal(0.0, 0.3);
      const auto at = [&](int node) { return s.truth[static_cast<std::size_t>(node)]; };
      for (int m = 0; m < in_group; ++m) {
        auto e = edge_of(random, s, i + m, j + m, true);
        e.T_i_j = at(i + m).inverse() * at(i) * SE3d::exp(xi) * at(j).inverse() * at(j + m);
        graph.add_edge(e);
      }
    }
    const std::clock_t begin = std::clock();
    const auto result = solve_pose_graph(graph);
    seconds += static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC;
    all += squared_error(s, result.T_world_node);
    const auto out_wrong = static_cast<int>(std::count_if(result.rejected.begin(), result.rejected.end(),
                                                          [&](int l) { return l >= first_wrong; }));
    kept_wrong += wrong - out_wrong;
    lost_right += static_cast<int>(result.rejected.size()) - out_wrong;
    double sum = 0.0;
    for (std::size_t l = 0; l < result.chi2.size(); ++l) sum += result.weight[l] * result.chi2[l];
    chi2 += sum / (6.0 * (static_cast<double>(result.chi2.size() - result.rejected.size()) - (n - 1)));
  }
  const auto rms = [&](double sum) { return std::sqrt(sum / kSeeds); };
  fmt::print("| {} | {} | {}{} | {:.3f} | {:.3f} | {:.3f} | {} of {} | {} of {} | {:.2f} | {:.0f} |\n",
             s.name, right, wrong, in_fives ? " in fives" : "", rms(start), rms(clean), rms(all), kept_wrong,
             wrong * kSeeds, lost_right, right * kSeeds, chi2 / kSeeds, 1e3 * seconds / kSeeds);
}

}  // namespace
}  // namespace sweepkit

int main() {
  fmt::print(
      "| graph | right loops | wrong | start [m] | right loops alone [m] | all [m] | wrong kept | right "
      "rejected | "
      "chi2 / dof | CPU [ms] |\n| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n");
  for (const auto& shape : {sweepkit::sphere(), sweepkit::garage(), sweepkit::lanes()}) {
    for (const auto& [right, wrong] :
         {std::pair(50, 0), std::pair(50, 5), std::pair(50, 25), std::pair(10, 10)})
      sweepkit::row(shape, right, wrong, false);
    for (const auto& [right, wrong] : {std::pair(50, 5), std::pair(50, 25), std::pair(10, 5)})
      sweepkit::row(shape, right, wrong, true);
  }
}
