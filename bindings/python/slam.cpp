// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/slam/frontend.hpp"
#include "sweepkit/slam/local_mapper.hpp"
#include "sweepkit/slam/odometry_bridge.hpp"
#include "sweepkit/slam/tracker.hpp"

namespace sweepkit::python {

void register_slam(py::module_& m) {
  bind_options<FrontendOptions>(m, "FrontendOptions", "From images to measurements.");
  bind_options<KeyframeRule>(m, "KeyframeRule", "When a frame becomes a keyframe.");
  bind_options<BlindKeyframeRule>(m, "BlindKeyframeRule",
                                  "When a frame that shows nothing becomes a keyframe.");
  bind_options<TrackerOptions>(m, "TrackerOptions", "The pose of each frame.");
  bind_options<LocalMapperOptions>(m, "LocalMapperOptions", "The map.");
  bind_options<OdometryBridgeOptions>(m, "OdometryBridgeOptions", "Wheels and IMU beside vision.");
  register_map_culling(m);
}

}  // namespace sweepkit::python
