// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/geometry/sim3.hpp"

namespace sweepkit {

/// A pose of a pose graph. Node k is the frame k.
template <class Pose>
struct PoseGraphNode {
  Pose T_world_node;
  bool fixed = false;  ///< must not move
};

/// A measured motion between two nodes, as odometry or a loop gives it:
/// T_world_i^-1 T_world_j = T_i_j Exp(e) with e ~ N(0, information^-1), (rho, phi[, sigma]) in j's axes.
template <class Pose>
struct PoseGraphEdge {
  using Information =
      Eigen::Matrix<double, Pose::Tangent::RowsAtCompileTime, Pose::Tangent::RowsAtCompileTime>;

  int i = 0, j = 0;  ///< nodes
  Pose T_i_j;
  Information information = Information::Identity();  ///< symmetric, positive definite [1/m^2, 1/rad^2]
  /// May be wrong altogether (a loop), and is then to be found out. Others (odometry) are believed.
  bool robust = false;
};

/// Poses and the motions measured between them: plain data, filled by whoever owns the map. `Pose` is SE3d or
/// Sim3d.
template <class Pose>
struct BasicPoseGraph {
  std::vector<PoseGraphNode<Pose>> nodes;
  std::vector<PoseGraphEdge<Pose>> edges;
  /// Unit vector against gravity, for PoseGraphFreedom::yaw.
  Vec3<double> up_world = Vec3<double>::UnitZ();

  /// Both return the index of what they added.
  int add_node(const Pose& T_world_node, bool fixed = false) {
    nodes.push_back({T_world_node, fixed});
    return static_cast<int>(nodes.size()) - 1;
  }
  int add_edge(const PoseGraphEdge<Pose>& edge) {
    edges.push_back(edge);
    return static_cast<int>(edges.size()) - 1;
  }
};

using PoseGraph = BasicPoseGraph<SE3d>;
/// For maps whose scale drifts (one camera).
using SimilarityGraph = BasicPoseGraph<Sim3d>;

/// What of a pose may move.
enum class PoseGraphFreedom {
  full,  ///< all of it: six numbers of SE(3), seven of Sim(3)
  yaw,   ///< the heading about `up_world` and the position: where gravity is known. The tilt stays as it is
};

/// What robust edges do.
enum class PoseGraphLoss {
  quadratic,      ///< are believed as the others
  huber,          ///< pull with bounded force
  cauchy,         ///< pull less and less
  geman_mcclure,  ///< hardly pull beyond the gate
  truncated,      ///< pull in full or, where all else contradicts them, not at all
};

struct PoseGraphOptions {
  PoseGraphFreedom freedom = PoseGraphFreedom::full;
  double tilt_sigma = 0.3;
  PoseGraphLoss loss = PoseGraphLoss::truncated;
  double gate = 1.0;
  int iterations = 50;
  double function_tolerance = 1e-8;
  double step_tolerance = 1e-7;
  bool covariances = false;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v.choice(freedom, "freedom", {{PoseGraphFreedom::full, "full"}, {PoseGraphFreedom::yaw, "yaw"}},
             "what of a pose may move: all, or heading and position");
    v(tilt_sigma, "tilt_sigma", "deg", range(0, 90),
      "yaw: how well the tilt of each pose is known; 0: exactly");
    v.choice(loss, "loss",
             {{PoseGraphLoss::quadratic, "quadratic"},
              {PoseGraphLoss::huber, "huber"},
              {PoseGraphLoss::cauchy, "cauchy"},
              {PoseGraphLoss::geman_mcclure, "geman_mcclure"},
              {PoseGraphLoss::truncated, "truncated"}},
             "loss of robust edges; truncated finds out which are wrong");
    v(gate, "gate", "", range(0.01, 1000),
      "multiplies the 99.9 % gate of chi-square, the width of the loss: 22.5, with scale 24.3");
    v(iterations, "iterations", "", range(1, 10000), "at most so many for each set of edges");
    v(function_tolerance, "function_tolerance", "", range(0, 1),
      "stop when the cost falls by less than this part of it");
    v(step_tolerance, "step_tolerance", "m, rad", range(0, 1), "stop when no pose moves more than this");
    v(covariances, "covariances", "", any_value(), "also the covariance of each pose");
  }
};

template <class Pose>
struct PoseGraphResult {
  using Covariance = typename PoseGraphEdge<Pose>::Information;

  bool usable = false;        ///< false: no solution was found and the poses are those given
  bool converged = false;     ///< a tolerance was met
  bool stopped = false;       ///< asked to stop; the poses are the best so far
  int iterations = 0;         ///< linearisations, for all sets of edges
  double initial_cost = 0.0;  ///< half the sum of chi2, robust edges by their loss
  double final_cost = 0.0;
  std::vector<Pose> T_world_node;
  std::vector<double> chi2;    ///< of each edge at the end: e' information e
  std::vector<double> weight;  ///< of each edge in the last solution, 0 to 1; 1 for those believed
  /// For each robust edge how far it is from what all others say of it, in units of what is known: e' (S +
  /// S_edge)^-1 e with S the covariance of the others' prediction, chi-square distributed if it is right. An
  /// edge that closes a chain alone has hardly any chi2 left of its own, however wrong it is; this tells. 0
  /// for edges that are believed, and for all unless the loss is truncated.
  std::vector<double> contradiction;
  std::vector<int> rejected;  ///< robust edges that weigh less than a half at the end
  std::vector<int> held;      ///< nodes that were held because nothing fixed is connected with them
  int components = 0;         ///< parts that no edge connects
  double products = 0.0;      ///< multiplications that one factorisation takes
  /// Of each pose, if asked for: of xi in T_world_node Exp(xi), relative to the fixed nodes; 0 for these.
  std::vector<Covariance> covariance;
};

/// Moves the nodes that are not fixed to where the edges fit best: minimises half the sum of e' information e
/// by Levenberg and Marquardt with exact Jacobians (pose_graph_error.hpp) and a sparse Cholesky factorisation
/// by blocks in an order of minimum degree. Of each part of the graph without a fixed node the first node is
/// held. Fixed and held poses stay as they are to the last bit. No threads; bit-identical.
///
/// With yaw alone free the residual keeps its six numbers. What the tilts of both ends may be wrong by
/// (`tilt_sigma`) is added to the covariance of each edge, so that edges which tell another tilt than the
/// poses have do not bend the map for it; chi2 and contradiction are of that covariance.
///
/// With the truncated loss the cost of a robust edge is half of min(contradiction, gate). If the solution
/// with all of them contradicts some edge beyond the gate, it begins anew with those that are believed, takes
/// in the robust ones that do not contradict what is known then, and on from there leaves out the edge that
/// the others contradict most, or takes one back, as long as the cost falls (data snooping; Baarda, A testing
/// procedure for use in geodetic networks, 1968). The contradictions need the covariances between the ends of
/// each edge, which come from the sparse inverse (Takahashi, Fagan and Chin 1973).
/// @param stop when it becomes true the solver ends after the iteration under way; may be null
/// Throws Error(argument), naming node or edge, at numbers that are not finite, indices out of range, edges
/// from a node to itself, an information that is not symmetric and positive definite, an `up_world` that is
/// no unit vector, and yaw with Sim(3); Error(option).
template <class Pose>
PoseGraphResult<Pose> solve_pose_graph(const BasicPoseGraph<Pose>& graph,
                                       const PoseGraphOptions& options = {},
                                       const std::atomic<bool>* stop = nullptr);

extern template PoseGraphResult<SE3d> solve_pose_graph(const PoseGraph&, const PoseGraphOptions&,
                                                       const std::atomic<bool>*);
extern template PoseGraphResult<Sim3d> solve_pose_graph(const SimilarityGraph&, const PoseGraphOptions&,
                                                        const std::atomic<bool>*);

}  // namespace sweepkit
