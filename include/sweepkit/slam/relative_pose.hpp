// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>

#include "sweepkit/core/options.hpp"
#include "sweepkit/geometry/pnp.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/match/brute_force.hpp"
#include "sweepkit/match/projection.hpp"
#include "sweepkit/slam/stereo_frame.hpp"
#include "sweepkit/solve/pose.hpp"

namespace sweepkit {

struct RelativePoseOptions {
  double max_depth_uncertainty = 0.3;
  double search_radius = 8;
  int min_inliers = 15;
  BruteForceOptions brute_force;
  ProjectionOptions projection;
  PnpOptions pnp;
  PoseOptions pose;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(max_depth_uncertainty, "max_depth_uncertainty", "", range(0.001, 1),
      "largest share of its depth by which a stereo point may be uncertain to be used");
    v(search_radius, "search_radius", "px", range(1, 100),
      "how far from its predicted place a point is looked for once there is a pose, at octave 0");
    v(min_inliers, "min_inliers", "", range(4, 1000), "fewer points that agree are no answer");
    v.group(brute_force, "brute_force", "first matches, without prediction");
    v.group(projection, "projection", "second matches, near predicted places");
    v.group(pnp, "pnp", "pose from the first matches");
    v.group(pose, "pose", "pose from the second matches");
  }
};

/// How one stereo frame stands to another.
struct RelativePoseEstimate {
  SE3d T_a_b;               ///< rectified left camera of b to that of a
  Mat6<double> covariance;  ///< of xi in T_a_b * Exp(xi), (rho, phi) in the camera b's axes [m^2, rad^2]
  int matches = 0;          ///< stereo points of a found in b
  int inliers = 0;          ///< of these, that agree on the pose
};

/// The motion between two stereo frames that see the same place, from their measurements alone: neither poses
/// nor a map nor the time between them are used. Descriptors of a's stereo points against all of b, a pose by
/// PnP, then a second search by projection and a robust pose. Deterministic.
/// @param a, b measurements, descriptors and grid must be set, as Frontend does
/// @return nothing if too few points agree
std::optional<RelativePoseEstimate> relative_pose(const RectifiedCamera& camera, const StereoFrame& a,
                                                  const StereoFrame& b,
                                                  const RelativePoseOptions& options = {});

}  // namespace sweepkit
