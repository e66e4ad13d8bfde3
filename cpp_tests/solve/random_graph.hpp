// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <numbers>

#include "sweepkit/core/random.hpp"
#include "sweepkit/solve/pose_graph.hpp"

namespace sweepkit::test {

/// A tangent vector of normal numbers: translation, the rest.
template <class Pose>
typename Pose::Tangent draw(Random& random, double rho, double phi) {
  typename Pose::Tangent xi;
  for (int k = 0; k < xi.size(); ++k) xi[k] = random.normal(0.0, k < 3 ? rho : phi);
  return xi;
}

/// Rounds of a hilly circle: each node measured from the few before it, and loops from one round to the next.
struct RoundsOptions {
  int nodes = 80, nodes_a_round = 40, band = 2, loops = 10;
  double sigma_rho = 0.01, sigma_phi = 0.005;  ///< of what is measured [m, rad]
  double noise = 1.0;                          ///< 0: measurements are exact
  std::uint64_t seed = 1;
};

template <class Pose>
struct Rounds {
  std::vector<Pose> truth;
  BasicPoseGraph<Pose> graph;  ///< starts from the chain of measurements; node 0 is fixed at its truth
  int first_loop = 0;
};

template <class Pose>
Rounds<Pose> make_rounds(const RoundsOptions& o) {
  Random random(o.seed);
  Rounds<Pose> rounds;
  for (int k = 0; k < o.nodes; ++k) {
    const double a = 2.0 * std::numbers::pi * k / o.nodes_a_round;
    const SE3d T(SO3d::exp(Vec3<double>(0, 0, a)) * SO3d::exp(Vec3<double>(0.1 * std::sin(3 * a), 0.05, 0)),
                 Vec3<double>(2 * std::cos(a), 2 * std::sin(a), 0.1 * std::cos(2 * a)));
    if constexpr (std::is_same_v<Pose, Sim3d>)
      rounds.truth.push_back(Sim3d(T.rotation(), T.translation(), 1.0 + 0.1 * std::sin(a)));
    else
      rounds.truth.push_back(T);
  }
  const auto edge = [&](int i, int j, bool robust) {
    PoseGraphEdge<Pose> e;
    e.i = i;
    e.j = j;
    const typename Pose::Tangent error = o.noise * draw<Pose>(random, o.sigma_rho, o.sigma_phi);
    e.T_i_j = rounds.truth[static_cast<std::size_t>(i)].inverse() *
              rounds.truth[static_cast<std::size_t>(j)] * Pose::exp(-error);
    for (int k = 0; k < e.information.rows(); ++k)
      e.information(k, k) = std::pow(k < 3 ? o.sigma_rho : o.sigma_phi, -2);
    e.robust = robust;
    return e;
  };
  rounds.graph.add_node(rounds.truth[0], true);
  for (int k = 1; k < o.nodes; ++k) {
    for (int d = 1; d <= std::min(o.band, k); ++d) {
      const auto e = edge(k - d, k, false);
      if (d == 1)
        rounds.graph.add_node(rounds.graph.nodes[static_cast<std::size_t>(k) - 1].T_world_node * e.T_i_j);
      rounds.graph.add_edge(e);
    }
  }
  rounds.first_loop = static_cast<int>(rounds.graph.edges.size());
  for (int l = 0; l < o.loops; ++l) {
    const int i = static_cast<int>(random.index(static_cast<std::uint64_t>(o.nodes - o.nodes_a_round)));
    rounds.graph.add_edge(edge(i, i + o.nodes_a_round - (i > 0 ? 1 : 0), true));
  }
  return rounds;
}

}  // namespace sweepkit::test
