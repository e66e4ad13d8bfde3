// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <string>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/floor/obstacle_cloud.hpp"

namespace sweepkit::python {

// Of floor_plane.cpp.
void bind_floor_plane(py::module_& m);
// Of floor_grid.cpp.
void bind_floor_grid(py::module_& m);
// Of floor_obstacles.cpp.
void bind_floor_obstacles(py::module_& m);

namespace {

/// Calls f with a View2d of the array's own type; copies only where pixels of a row are not side by side.
template <class F>
auto with_disparity(const py::array& given, const F& f) {
  const auto as_view = [&]<class D>(D) {
    const auto step = static_cast<py::ssize_t>(sizeof(D));
    py::array_t<D> array = py::reinterpret_borrow<py::array_t<D>>(given);
    if ((array.strides(1) != step && array.shape(1) > 1) || array.strides(0) % step != 0)
      array = py::array_t<D, py::array::c_style>(given);
    const View2d<const D> view{array.data(), static_cast<int>(array.shape(1)),
                               static_cast<int>(array.shape(0)), array.strides(0) / step};
    py::gil_scoped_release release;
    return f(view);
  };
  if (given.ndim() == 2 && py::isinstance<py::array_t<float>>(given)) return as_view(float{});
  if (given.ndim() == 2 && py::isinstance<py::array_t<std::int16_t>>(given)) return as_view(std::int16_t{});
  throw py::value_error("expected disparities, float32 or int16 of shape (height, width), got " +
                        describe(given));
}

template <class Cloud>
void bind_build(py::class_<Cloud>& cls) {
  cls.def(py::init<>())
      .def(
          "build",
          [](Cloud& cloud, const py::array& disparity, const RectifiedCamera& camera,
             const FloorDisparity& floor, const FloorTolerance& tolerance, bool obstacle, bool hole,
             bool on_floor) {
            with_disparity(disparity, [&]<class D>(View2d<const D> view) {
              cloud.build(view, camera, floor, tolerance, {obstacle, hole, on_floor});
            });
          },
          py::arg("disparity"), py::arg("camera"), py::arg("floor"), py::arg("tolerance"), py::kw_only(),
          py::arg("obstacle") = true, py::arg("hole") = false, py::arg("on_floor") = false,
          "Labels the pixels and makes points of those with the chosen labels. Arrays that were given out "
          "before change or lose their meaning: copy what is to stay.")
      .def_property_readonly(
          "mask", [](const py::object& self) { return image_view(self.cast<const Cloud&>().mask(), self); },
          "A FloorLabel a pixel, uint8 (height, width), where it lies.");
}

py::array plane_view(View2d<const float> plane, const py::object& owner) {
  const auto step = static_cast<py::ssize_t>(sizeof(float));
  return view_of(plane.data, {plane.height, plane.width}, {plane.stride * step, step}, owner);
}

}  // namespace

void register_floor(py::module_& m) {
  py::class_<FloorDisparity>(m, "FloorDisparity",
                             "The floor's disparity: at_origin + along_u * u + along_v * v [px].")
      .def(py::init([](double at_origin, double along_u, double along_v) {
             return FloorDisparity{at_origin, along_u, along_v};
           }),
           py::arg("at_origin") = 0.0, py::arg("along_u") = 0.0, py::arg("along_v") = 0.0)
      .def_readwrite("at_origin", &FloorDisparity::at_origin)
      .def_readwrite("along_u", &FloorDisparity::along_u)
      .def_readwrite("along_v", &FloorDisparity::along_v)
      .def("ramp", &FloorDisparity::ramp, py::arg("u"),
           "What dense matching should expect of such a floor: its disparities in column u.")
      .def("__call__", &FloorDisparity::operator(), py::arg("u"), py::arg("v"));

  py::class_<GroundPlane>(m, "GroundPlane", "The floor: points with down_camera . p_camera = height.")
      .def(py::init([](const Vector3& down, double height) {
             return GroundPlane{down.eigen<Vec3<double>>(), height};
           }),
           py::arg("down_camera"), py::arg("height"))
      .def_property(
          "down_camera", [](const GroundPlane& p) { return p.down_camera; },
          [](GroundPlane& p, const Vector3& down) { p.down_camera = down.eigen<Vec3<double>>(); },
          "Unit normal of the floor, downwards, in the camera's frame.")
      .def_readwrite("height", &GroundPlane::height, "Of the camera above the floor [m].")
      .def(
          "height_of",
          [](const GroundPlane& p, const Vector3& x) { return p.height_of(x.eigen<Vec3<double>>()); },
          py::arg("p_camera"), "How far a point is above the floor [m].")
      .def("disparity", &GroundPlane::disparity, py::arg("camera"), "Of the floor in a rectified camera.")
      .def_static("of", &GroundPlane::of, py::arg("floor"), py::arg("camera"),
                  "The plane that has this disparity.");

  py::enum_<FloorLabel>(m, "FloorLabel", "What a pixel shows beside the floor; the values of a mask.")
      .value("unknown", FloorLabel::unknown)
      .value("floor", FloorLabel::floor)
      .value("obstacle", FloorLabel::obstacle)
      .value("hole", FloorLabel::hole);

  bind_options<FloorNoise>(m, "FloorNoise", "Errors of disparities on the floor and of its plane.");
  py::class_<FloorTolerance>(m, "FloorTolerance", "How far a disparity may lie off the floor's.")
      .def(py::init([](double base, double slope, double above, double below) {
             return FloorTolerance{base, slope, above, below};
           }),
           py::arg("base") = 0.0, py::arg("slope") = 0.0, py::arg("above") = 0.0, py::arg("below") = 0.0)
      .def_readwrite("base", &FloorTolerance::base, "[px]")
      .def_readwrite("slope", &FloorTolerance::slope)
      .def_readwrite("above", &FloorTolerance::above)
      .def_readwrite("below", &FloorTolerance::below)
      .def("towards", &FloorTolerance::towards, py::arg("floor"), "Towards the camera [px].")
      .def("away", &FloorTolerance::away, py::arg("floor"), "Away from the camera [px].")
      .def_static("of", &FloorTolerance::of, py::arg("noise"), py::arg("plane"), py::arg("camera"),
                  "What follows from the noise.");

  m.def(
      "obstacle_mask",
      [](const py::array& disparity, const FloorDisparity& floor, const FloorTolerance& tolerance) {
        if (disparity.ndim() != 2)
          throw py::value_error("expected disparities, float32 or int16 of shape (height, width), got " +
                                describe(disparity));
        py::array_t<std::uint8_t> mask({disparity.shape(0), disparity.shape(1)});
        const View2d<std::uint8_t> to{mask.mutable_data(), static_cast<int>(mask.shape(1)),
                                      static_cast<int>(mask.shape(0))};
        with_disparity(disparity,
                       [&]<class D>(View2d<const D> view) { obstacle_mask(view, floor, tolerance, to); });
        return mask;
      },
      py::arg("disparity"), py::arg("floor"), py::arg("tolerance"),
      "A FloorLabel a pixel, uint8 (height, width), of disparities in pixels (float32) or sixteenths "
      "(int16).");

  py::class_<OrganisedCloud> organised(m, "OrganisedCloud",
                                       "Mask and a point a pixel, nan where not chosen.");
  bind_build(organised);
  organised
      .def_property_readonly(
          "x",
          [](const py::object& self) { return plane_view(self.cast<const OrganisedCloud&>().x(), self); },
          "In the rectified left camera's frame [m], (height, width), where it lies.")
      .def_property_readonly(
          "y",
          [](const py::object& self) { return plane_view(self.cast<const OrganisedCloud&>().y(), self); })
      .def_property_readonly("z", [](const py::object& self) {
        return plane_view(self.cast<const OrganisedCloud&>().z(), self);
      });

  py::class_<PointList> list(m, "PointList", "Mask and the points of the chosen pixels, row by row.");
  bind_build(list);
  list.def_property_readonly(
          "points",
          [](const py::object& self) {
            const auto points = self.cast<const PointList&>().points();
            const auto step = static_cast<py::ssize_t>(sizeof(float));
            return view_of(reinterpret_cast<const float*>(points.data()),
                           {static_cast<py::ssize_t>(points.size()), 3}, {3 * step, step}, self);
          },
          "float32 (n, 3) in the rectified left camera's frame [m], where they lie.")
      .def_property_readonly(
          "pixels",
          [](const py::object& self) {
            const auto pixels = self.cast<const PointList&>().pixels();
            return view_of(pixels.data(), {static_cast<py::ssize_t>(pixels.size())},
                           {static_cast<py::ssize_t>(sizeof(std::int32_t))}, self);
          },
          "v * width + u of each point, int32 (n,), where they lie.")
      .def("__len__", &PointList::size);

  bind_floor_plane(m);
  bind_floor_grid(m);
  bind_floor_obstacles(m);
}

}  // namespace sweepkit::python
