// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/solve/pose_graph.hpp"

#include <cmath>
#include <numbers>
#include <string>
#include <type_traits>

#include "pose_graph_solver.hpp"
#include "small_matrix.hpp"
#include "sweepkit/core/error.hpp"

namespace sweepkit {
namespace {

std::string edge_place(std::size_t l) { return "solve_pose_graph edge " + std::to_string(l); }

template <class Pose>
void check(const BasicPoseGraph<Pose>& graph, const PoseGraphOptions& options) {
  check_options(options);
  const int size = static_cast<int>(graph.nodes.size());
  for (std::size_t k = 0; k < graph.nodes.size(); ++k)
    if (!is_finite(graph.nodes[k].T_world_node))
      throw Error(ErrorKind::argument, "solve_pose_graph node " + std::to_string(k), "is not finite");
  for (std::size_t l = 0; l < graph.edges.size(); ++l) {
    const PoseGraphEdge<Pose>& edge = graph.edges[l];
    for (const int node : {edge.i, edge.j})
      if (node < 0 || node >= size)
        throw Error(ErrorKind::argument, edge_place(l), "there is no such node", std::to_string(node));
    if (edge.i == edge.j)
      throw Error(ErrorKind::argument, edge_place(l), "leads from a node to itself", std::to_string(edge.i));
    if (!is_finite(edge.T_i_j)) throw Error(ErrorKind::argument, edge_place(l), "is not finite");
    if (!edge.information.allFinite())
      throw Error(ErrorKind::argument, edge_place(l), "the information is not finite");
    const double largest = edge.information.cwiseAbs().maxCoeff();
    if ((edge.information - edge.information.transpose()).cwiseAbs().maxCoeff() > 1e-9 * largest)
      throw Error(ErrorKind::argument, edge_place(l), "the information is not symmetric");
    auto factor = edge.information;
    if (!small::factorize(factor))
      throw Error(ErrorKind::argument, edge_place(l), "the information is not positive definite");
  }
  if (options.freedom == PoseGraphFreedom::yaw) {
    if (!std::is_same_v<Pose, SE3d>)
      throw Error(ErrorKind::argument, "solve_pose_graph freedom", "yaw is for SE(3) only");
    if (!(std::abs(graph.up_world.norm() - 1.0) < 1e-6))
      throw Error(ErrorKind::argument, "solve_pose_graph up_world", "must be a unit vector",
                  std::to_string(graph.up_world.norm()));
  }
}

}  // namespace

template <class Pose>
PoseGraphResult<Pose> solve_pose_graph(const BasicPoseGraph<Pose>& graph, const PoseGraphOptions& options,
                                       const std::atomic<bool>* stop) {
  check(graph, options);
  if constexpr (std::is_same_v<Pose, SE3d>)
    if (options.freedom == PoseGraphFreedom::yaw)
      return PoseGraphSolver<YawFreedom>(
                 graph, options, YawFreedom{graph.up_world, options.tilt_sigma * std::numbers::pi / 180.0},
                 stop)
          .solve();
  return PoseGraphSolver<FullFreedom<Pose>>(graph, options, {}, stop).solve();
}

template PoseGraphResult<SE3d> solve_pose_graph(const PoseGraph&, const PoseGraphOptions&,
                                                const std::atomic<bool>*);
template PoseGraphResult<Sim3d> solve_pose_graph(const SimilarityGraph&, const PoseGraphOptions&,
                                                 const std::atomic<bool>*);

}  // namespace sweepkit
