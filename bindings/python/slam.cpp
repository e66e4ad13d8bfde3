// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/slam/frontend.hpp"
#include "sweepkit/slam/local_mapper.hpp"
#include "sweepkit/slam/tracker.hpp"

namespace sweepkit::python {

void register_slam(py::module_& m) {
  bind_options<FrontendOptions>(m, "FrontendOptions", "From images to measurements.");
  bind_options<KeyframeRule>(m, "KeyframeRule", "When a frame becomes a keyframe.");
  bind_options<TrackerOptions>(m, "TrackerOptions", "The pose of each frame.");
  bind_options<LocalMapperOptions>(m, "LocalMapperOptions", "The map.");
}

}  // namespace sweepkit::python
