// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/solve/bundle.hpp"
#include "sweepkit/solve/pose.hpp"

namespace sweepkit::python {

void register_pose_graph(py::module_& m);  // pose_graph.cpp

void register_solve(py::module_& m) {
  bind_options<PoseOptions>(m, "PoseOptions", "Pose from matches, refined.");
  bind_options<BundleOptions>(m, "BundleOptions", "Bundle adjustment.");
  register_pose_graph(m);
}

}  // namespace sweepkit::python
