// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <optional>
#include <string>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/floor/obstacle_detector.hpp"
#include "sweepkit/system/obstacle_run.hpp"

namespace sweepkit::python {

namespace {

template <class D>
std::vector<Obstacle> find(ObstacleFinder& self, py::array_t<D> array, const Gray& mask,
                           const RectifiedCamera& camera, const GroundPlane& plane, GrayView left,
                           GrayView right, const FloorDoubt& doubt) {
  const auto size = static_cast<py::ssize_t>(sizeof(D));
  if ((array.strides(1) != size && array.shape(1) > 1) || array.strides(0) % size != 0)
    array = py::array_t<D, py::array::c_style>(array);
  const View2d<const D> view{array.data(), static_cast<int>(array.shape(1)), static_cast<int>(array.shape(0)),
                             array.strides(0) / size};
  const GrayView labels = mask.view();
  py::gil_scoped_release release;
  return self.find(view, labels, camera, plane, left, right, doubt);
}

py::array regions_view(const View2d<const std::uint16_t>& view, const py::handle& owner) {
  const auto step = static_cast<py::ssize_t>(sizeof(std::uint16_t));
  return view_of(view.data, {view.height, view.width}, {view.stride * step, step}, owner);
}

template <class T>
std::vector<T> copy_of(std::span<const T> items) {
  return {items.begin(), items.end()};
}

std::string repr_of(const Obstacle& o) {
  return "<" + std::string(to_string(o.kind)) + " at " + std::to_string(o.distance) + " m, top " +
         std::to_string(o.box.top) + " m, " + std::to_string(o.pixels) + " pixels>";
}

void bind_things(py::module_& m) {
  py::enum_<ObstacleKind>(m, "ObstacleKind", "What is in the robot's way.")
      .value("obstacle", ObstacleKind::obstacle)
      .value("hole", ObstacleKind::hole);
  py::class_<FloorBox>(m, "FloorBox", "A box that stands on a floor, turned about the vertical only.")
      .def_property_readonly(
          "centre", [](const FloorBox& b) { return b.centre; }, "x, y of the floor's frame [m].")
      .def_readonly("yaw", &FloorBox::yaw, "Of its long side, counter-clockwise seen from above [rad].")
      .def_readonly("length", &FloorBox::length, "Of its long side [m].")
      .def_readonly("width", &FloorBox::width, "Across [m].")
      .def_readonly("bottom", &FloorBox::bottom, "Height of its lowest part above the floor [m].")
      .def_readonly("top", &FloorBox::top, "Height of its highest part [m].");
  py::class_<Obstacle>(m, "Obstacle", "One thing in the way, as one image shows it.")
      .def_readonly("kind", &Obstacle::kind)
      .def_property_readonly(
          "p_camera", [](const Obstacle& o) { return o.p_camera; },
          "Mean of its points in the rectified left camera's frame; of a hole, its opening [m].")
      .def_property_readonly(
          "covariance", [](const Obstacle& o) { return o.covariance; }, "Of p_camera [m^2].")
      .def_readonly("box", &Obstacle::box, "In the frame of the floor below the camera.")
      .def_readonly("distance", &Obstacle::distance, "Along the floor to its nearest part [m].")
      .def_readonly("pixels", &Obstacle::pixels)
      .def_readonly("clear", &Obstacle::clear,
                    "Whether the images show it beyond doubt; only such sightings confirm it.")
      .def_property_readonly(
          "image",
          [](const Obstacle& o) {
            return py::make_tuple(o.image.u_min, o.image.v_min, o.image.u_max, o.image.v_max);
          },
          "u_min, v_min, u_max, v_max of its pixels.")
      .def("__repr__", &repr_of);
  py::class_<TrackedObstacle>(m, "TrackedObstacle", "An obstacle followed over images.")
      .def_readonly("id", &TrackedObstacle::id)
      .def_readonly("kind", &TrackedObstacle::kind)
      .def_property_readonly(
          "p_world", [](const TrackedObstacle& t) { return t.p_world; }, "[m]")
      .def_property_readonly(
          "covariance", [](const TrackedObstacle& t) { return t.covariance; },
          "Of p_world, without the pose's [m^2].")
      .def_readonly("box", &TrackedObstacle::box, "As last seen, in the world.")
      .def_readonly("log_odds", &TrackedObstacle::log_odds, "Of being there.")
      .def_property_readonly("confidence", &TrackedObstacle::confidence)
      .def_readonly("confirmed", &TrackedObstacle::confirmed)
      .def_readonly("hits", &TrackedObstacle::hits, "Images that showed it.")
      .def_readonly("first_seen", &TrackedObstacle::first_seen, "[ns]")
      .def_readonly("last_seen", &TrackedObstacle::last_seen, "[ns]")
      .def_readonly("last", &TrackedObstacle::last,
                    "Index among the obstacles of the last image; -1: not seen there.");
}

void bind_finder(py::module_& m) {
  m.def("floor_frame", &floor_frame, py::arg("plane"),
        "T_floor_camera: x forward, y left along the floor, z up, below the camera.");
  py::class_<ObstacleFinder>(m, "ObstacleFinder", "Gathers pixels that stand out of the floor to things.")
      .def(py::init<const ObstacleOptions&>(), py::arg("options") = ObstacleOptions{})
      .def(
          "find",
          [](ObstacleFinder& self, const py::array& disparity, const Gray& mask,
             const RectifiedCamera& camera, const GroundPlane& plane, const std::optional<Gray>& left,
             const std::optional<Gray>& right, double sigma_tilt, bool contradicted) {
            const GrayView l = left ? left->view() : GrayView{}, r = right ? right->view() : GrayView{};
            const FloorDoubt doubt{sigma_tilt, contradicted};
            if (disparity.ndim() == 2 && py::isinstance<py::array_t<float>>(disparity))
              return find<float>(self, py::reinterpret_borrow<py::array_t<float>>(disparity), mask, camera,
                                 plane, l, r, doubt);
            if (disparity.ndim() == 2 && py::isinstance<py::array_t<std::int16_t>>(disparity))
              return find<std::int16_t>(self, py::reinterpret_borrow<py::array_t<std::int16_t>>(disparity),
                                        mask, camera, plane, l, r, doubt);
            throw py::value_error("expected disparities, float32 or int16 of shape (height, width), got " +
                                  describe(disparity));
          },
          py::arg("disparity"), py::arg("mask"), py::arg("camera"), py::arg("plane"),
          py::arg("left") = py::none(), py::arg("right") = py::none(), py::arg("sigma_tilt") = 0.0,
          py::arg("contradicted") = false,
          "The obstacles and holes of an image, from near to far. With the rectified images each thing is "
          "tested against the floor. sigma_tilt [rad] and contradicted tell what is known against the plane: "
          "with the images they decide what is clear.")
      .def_property_readonly(
          "regions",
          [](const py::object& self) {
            return regions_view(self.cast<const ObstacleFinder&>().regions(), self);
          },
          "uint16 (height, width): 0, or one more than the index of the obstacle; where it lies.");
}

void bind_detector(py::module_& m) {
  py::class_<ObstacleDetector>(m, "ObstacleDetector",
                               "Dense stereo, ground plane, mask, obstacles and their confidence over time.")
      .def(py::init<const StereoRig&, const GroundPlaneSeed&, const ObstacleDetectorOptions&>(),
           py::arg("rig"), py::arg("seed"), py::arg("options") = ObstacleDetectorOptions{})
      .def(
          "detect",
          [](ObstacleDetector& self, TimeNs t, const Gray& left, const Gray& right,
             const std::optional<SE3d>& T_odom_camera) {
            const GrayView l = left.view(), r = right.view();
            ObstaclePose pose;
            pose.T_odom_camera = T_odom_camera;
            std::vector<Obstacle> found;
            {
              py::gil_scoped_release release;
              const ObstacleFrame& frame = self.detect(t, l, r, pose);
              found = copy_of(frame.obstacles);
            }
            return found;
          },
          py::arg("t"), py::arg("left"), py::arg("right"), py::arg("T_odom_camera") = py::none(),
          "Takes a raw pair with its stamp [ns] and returns its obstacles; the rest of the frame can be "
          "asked "
          "afterwards. Arrays that were given out before change: copy what is to stay.")
      .def_property_readonly("camera", &ObstacleDetector::camera, "The rectified left camera.")
      .def_property_readonly(
          "plane", [](const ObstacleDetector& d) { return d.last().plane; },
          "GroundPlaneResult of the image.")
      .def_property_readonly(
          "left",
          [](const py::object& self) { return image_view(self.cast<ObstacleDetector&>().last().left, self); },
          "The rectified left image, where it lies.")
      .def_property_readonly(
          "mask",
          [](const py::object& self) { return image_view(self.cast<ObstacleDetector&>().last().mask, self); },
          "A FloorLabel a pixel, where it lies.")
      .def_property_readonly(
          "disparity",
          [](const py::object& self) {
            const DisparityView view = self.cast<ObstacleDetector&>().last().disparity;
            const auto step = static_cast<py::ssize_t>(sizeof(std::int16_t));
            return view_of(view.data, {view.height, view.width}, {view.stride * step, step}, self);
          },
          "int16 in sixteenths of a pixel, where they lie.")
      .def_property_readonly(
          "regions",
          [](const py::object& self) {
            return regions_view(self.cast<ObstacleDetector&>().last().regions, self);
          },
          "uint16: 0, or one more than the index of the obstacle; where it lies.")
      .def_property_readonly("obstacles",
                             [](const ObstacleDetector& d) { return copy_of(d.last().obstacles); })
      .def_property_readonly(
          "tracked", [](const ObstacleDetector& d) { return copy_of(d.last().tracked); },
          "All that are kept, with their confidence; none without poses.")
      .def_property_readonly(
          "times_ms",
          [](const ObstacleDetector& d) {
            const ObstacleTimes& t = d.last().times;
            py::dict times;
            times["disparity"] = t.disparity;
            times["plane"] = t.plane;
            times["mask"] = t.mask;
            times["obstacles"] = t.obstacles;
            return times;
          },
          "Of the steps of the last image.");
}

}  // namespace

void bind_floor_obstacles(py::module_& m) {
  bind_options<ObstacleOptions>(m, "ObstacleOptions", "What counts as an obstacle or a hole.");
  bind_options<ObstacleTrackerOptions>(m, "ObstacleTrackerOptions",
                                       "How obstacles become more certain from image to image.");
  bind_options<ObstacleDetectorOptions>(m, "ObstacleDetectorOptions", "From a raw stereo pair to obstacles.");
  bind_things(m);
  bind_finder(m);
  bind_detector(m);
  m.def(
      "detect_obstacles",
      [](const std::string& data, const std::string& out, double start, double duration, double every,
         double camera_height, double pitch_down_deg, const ObstacleDetectorOptions& detector) {
        ObstacleRunOptions options;
        options.data_path = data;
        options.save_path = out;
        options.recording.start = start;
        options.recording.duration = duration;
        options.every = every;
        options.floor.camera_height = camera_height;
        options.floor.pitch_down = pitch_down_deg;
        options.detector = detector;
        ObstacleRunResult result;
        {
          py::gil_scoped_release release;
          ObstacleHooks hooks;
          hooks.stop = [] {
            py::gil_scoped_acquire acquire;
            return PyErr_CheckSignals() != 0;
          };
          result = detect_obstacles(options, hooks);
        }
        if (PyErr_Occurred()) throw py::error_already_set();
        py::dict counts;
        counts["frames"] = result.frames;
        counts["frames_missing"] = result.frames_missing;
        counts["planes_measured"] = result.planes_measured;
        counts["obstacles"] = result.obstacles;
        counts["holes"] = result.holes;
        counts["confirmed"] = result.confirmed;
        counts["median_ms"] = result.times.median_ms;
        return counts;
      },
      py::arg("data"), py::arg("out") = "", py::kw_only(), py::arg("start") = 0.0, py::arg("duration") = 0.0,
      py::arg("every") = 1.0, py::arg("camera_height") = 0.0, py::arg("pitch_down_deg") = 0.0,
      py::arg("detector") = ObstacleDetectorOptions{},
      "Looks for obstacles in a recording, as the program obstacle_detector does, and returns counts.");
}

}  // namespace sweepkit::python
