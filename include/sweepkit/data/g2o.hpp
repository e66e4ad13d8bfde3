// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <vector>

#include "sweepkit/solve/pose_graph.hpp"

namespace sweepkit {

/// What the rotation rows of an information in a g2o file are of. The format's description does not say;
/// programs differ, and so do files.
enum class G2oRotation {
  quaternion,  ///< x y z of the error's quaternion, half its rotation vector: as the program g2o reckons
  vector,      ///< the rotation vector itself [rad], as here: 4 times smaller numbers for the same edge
};

/// A pose graph and how its file numbers the nodes.
struct G2oGraph {
  PoseGraph graph;
  std::vector<std::int64_t> ids;  ///< of each node, in the order of the file
};

/// Reads a pose graph in the format of g2o:
///
///     VERTEX_SE3:QUAT id x y z qx qy qz qw        EDGE_SE3:QUAT i j x y z qx qy qz qw, 21 of the information
///     VERTEX_SE2 id x y theta                     EDGE_SE2 i j x y theta, 6 of the information
///     FIX id ...
///
/// [m, rad], poses T_world_node, edges T_i_j; of an information, ordered translation before rotation, the
/// upper triangle by rows. Lines with # and PARAMS_SE3OFFSET are passed over. Poses of the plane come to lie
/// in z = 0; the directions that their edges leave open get the information of the others, so that the graph
/// stays in the plane. Similarities are not read: no description of lines for them is published.
/// @param robust_loops marks edges between nodes whose ids are not neighbours as robust
/// @throws Error(io, data) naming file, line and value: unknown lines, wrong number of columns, numbers that
/// are not finite, quaternions not of length 1, ids twice or missing, edges from a node to itself, an
/// information that is not positive definite
G2oGraph read_g2o(const std::filesystem::path& file, G2oRotation rotation = G2oRotation::quaternion,
                  bool robust_loops = false);

/// Writes one: VERTEX_SE3:QUAT, FIX and EDGE_SE3:QUAT, numbers so that they read back as they are. Which
/// edges are robust the format does not hold.
/// @param ids of the nodes; empty: 0, 1, ...
/// @throws Error(io), also where the disk is full; Error(argument) for ids of another count
void write_g2o(const std::filesystem::path& file, const PoseGraph& graph,
               G2oRotation rotation = G2oRotation::quaternion, std::span<const std::int64_t> ids = {});

}  // namespace sweepkit
