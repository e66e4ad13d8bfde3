// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <optional>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/floor/ground_plane_estimator.hpp"

namespace sweepkit::python {

namespace {

template <class D>
GroundPlaneResult estimate(GroundPlaneEstimator& self, py::array_t<D> array, const GroundPlaneStep& step) {
  const auto size = static_cast<py::ssize_t>(sizeof(D));
  if ((array.strides(1) != size && array.shape(1) > 1) || array.strides(0) % size != 0)
    array = py::array_t<D, py::array::c_style>(array);
  const View2d<const D> view{array.data(), static_cast<int>(array.shape(1)), static_cast<int>(array.shape(0)),
                             array.strides(0) / size};
  py::gil_scoped_release release;
  return self.estimate(view, step);
}

}  // namespace

void bind_floor_plane(py::module_& m) {
  py::class_<GroundPlaneSeed>(m, "GroundPlaneSeed", "What calibration says of the floor.")
      .def_static("from_base", &GroundPlaneSeed::from_base, py::arg("T_base_camera"),
                  "From where the rectified left camera is mounted on the robot's base (x forward, y left, z "
                  "up, on the floor between the drive wheels).")
      .def_static(
          "from_height",
          [](const Vector3& down, double height) {
            return GroundPlaneSeed::from_height(down.eigen<Vec3<double>>(), height);
          },
          py::arg("down_camera"), py::arg("height"),
          "From the direction down in the camera's frame and the camera's height [m].")
      .def_readwrite("plane", &GroundPlaneSeed::plane)
      .def_property(
          "wheels_camera", [](const GroundPlaneSeed& s) { return s.wheels_camera; },
          [](GroundPlaneSeed& s, const Vector3& p) { s.wheels_camera = p.eigen<Vec3<double>>(); },
          "Where the drive wheels touch the floor, in the camera's frame [m].");

  bind_options<GroundPlaneOptions>(m, "GroundPlaneOptions", "How the ground plane is estimated.");

  py::enum_<GroundPlaneState>(m, "GroundPlaneState", "Whether a frame showed the floor.")
      .value("measured", GroundPlaneState::measured)
      .value("predicted", GroundPlaneState::predicted)
      .value("refused", GroundPlaneState::refused);
  py::enum_<GroundPlaneReason>(m, "GroundPlaneReason", "Why a plane was not measured.")
      .value("none", GroundPlaneReason::none)
      .value("no_disparity", GroundPlaneReason::no_disparity)
      .value("no_floor", GroundPlaneReason::no_floor)
      .value("too_narrow", GroundPlaneReason::too_narrow)
      .value("contradiction", GroundPlaneReason::contradiction)
      .value("lifted", GroundPlaneReason::lifted);

  py::class_<GroundPlaneResult>(m, "GroundPlaneResult",
                                "The ground plane of a frame, and how far to trust it.")
      .def_readonly("plane", &GroundPlaneResult::plane)
      .def_property_readonly(
          "covariance", [](const GroundPlaneResult& r) { return r.covariance; },
          "Of (pitch, roll, height) [rad^2, rad m, m^2].")
      .def_readonly("state", &GroundPlaneResult::state)
      .def_readonly("reason", &GroundPlaneResult::reason)
      .def_readonly("pixels", &GroundPlaneResult::pixels, "Valid disparities looked at where a floor can be.")
      .def_readonly("inliers", &GroundPlaneResult::inliers, "Of these, on the plane that was fitted.")
      .def_readonly("noise", &GroundPlaneResult::noise, "Of the inliers about that plane [px].")
      .def_property_readonly("measured", &GroundPlaneResult::measured);

  m.def("pitch_down", &pitch_down, py::arg("plane"),
        "The angle by which the camera looks down at a plane [rad].");
  m.def("roll", &roll, py::arg("plane"), "The angle of a plane's normal about the viewing axis [rad].");

  py::class_<GroundPlaneEstimator>(m, "GroundPlaneEstimator",
                                   "Estimates the floor under the wheels from disparity images.")
      .def(py::init<const RectifiedCamera&, const GroundPlaneSeed&, const GroundPlaneOptions&>(),
           py::arg("camera"), py::arg("seed"), py::arg("options") = GroundPlaneOptions{})
      .def(
          "estimate",
          [](GroundPlaneEstimator& self, const py::array& disparity, double seconds,
             const std::optional<SE3d>& T_now_before, const std::optional<ArrayOf<double, 6, 6>>& covariance,
             const std::optional<Vector3>& down_camera, double down_sigma) {
            GroundPlaneStep step;
            step.seconds = seconds;
            if (T_now_before.has_value() != covariance.has_value())
              throw py::value_error("T_now_before and covariance are given together or not at all");
            if (T_now_before) step.motion = {*T_now_before, covariance->eigen<Mat6<double>>()};
            if (down_camera) step.vertical = {down_camera->eigen<Vec3<double>>(), down_sigma};
            if (disparity.ndim() == 2 && py::isinstance<py::array_t<float>>(disparity))
              return estimate<float>(self, py::reinterpret_borrow<py::array_t<float>>(disparity), step);
            if (disparity.ndim() == 2 && py::isinstance<py::array_t<std::int16_t>>(disparity))
              return estimate<std::int16_t>(
                  self, py::reinterpret_borrow<py::array_t<std::int16_t>>(disparity), step);
            throw py::value_error("expected disparities, float32 or int16 of shape (height, width), got " +
                                  describe(disparity));
          },
          py::arg("disparity"), py::kw_only(), py::arg("seconds") = 0.1, py::arg("T_now_before") = py::none(),
          py::arg("covariance") = py::none(), py::arg("down_camera") = py::none(),
          py::arg("down_sigma") = 0.01,
          "Takes the next frame: disparities in px (float32) or sixteenths (int16), the time since the last "
          "one [s], how the camera moved since (with the covariance of xi in T_now_before * Exp(xi), "
          "translation first) and the direction of gravity with its deviation [rad], if known.")
      .def("mounting", &GroundPlaneEstimator::mounting,
           "The plane while all wheels are on one surface, as learned so far.")
      .def("reset", &GroundPlaneEstimator::reset, "Forgets all but the seed.");
}

}  // namespace sweepkit::python
