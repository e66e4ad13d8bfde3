// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/numpy.h>

#include <utility>

#include "options.hpp"
#include "register.hpp"
#include "sweepkit/slam/frontend.hpp"
#include "sweepkit/slam/local_mapper.hpp"
#include "sweepkit/slam/loop_correction.hpp"
#include "sweepkit/slam/odometry_bridge.hpp"
#include "sweepkit/slam/tracker.hpp"

namespace sweepkit::python {

void register_slam(py::module_& m) {
  register_slam_place(m);
  bind_options<FrontendOptions>(m, "FrontendOptions", "From images to measurements.");
  bind_options<KeyframeRule>(m, "KeyframeRule", "When a frame becomes a keyframe.");
  bind_options<BlindKeyframeRule>(m, "BlindKeyframeRule",
                                  "When a frame that shows nothing becomes a keyframe.");
  bind_options<TrackerOptions>(m, "TrackerOptions", "The pose of each frame.");
  register_map_culling(m);
  bind_options<LoopCorrectionOptions>(m, "LoopCorrectionOptions", "Places known again.");
  bind_options<LocalMapperOptions>(m, "LocalMapperOptions", "The map.");
  bind_options<OdometryBridgeOptions>(m, "OdometryBridgeOptions", "Wheels and IMU beside vision.");
  m.def(
      "essential_graph",
      [](const Map& map, std::uint32_t id, const RectifiedCamera& camera,
         const LoopCorrectionOptions& options) {
        EssentialGraph essential = essential_graph(map, MapId{id}, camera, options);
        py::array_t<std::uint32_t> ids(static_cast<py::ssize_t>(essential.keyframes.size()));
        for (std::size_t k = 0; k < essential.keyframes.size(); ++k)
          ids.mutable_data()[k] = essential.keyframes[k].value;
        return py::make_tuple(std::move(essential.graph), ids);
      },
      py::arg("map"), py::arg("map_id"), py::arg("camera"), py::arg("options") = LoopCorrectionOptions{},
      "The pose graph of a map: keyframes (T_world_camera) tied by the points that they share, where nothing "
      "was "
      "seen by odometry; and the ids of the keyframes.");
}

}  // namespace sweepkit::python
