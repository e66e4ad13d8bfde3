// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/eigen.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <algorithm>
#include <optional>
#include <string>
#include <vector>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/floor/drivable_area.hpp"
#include "sweepkit/floor/floor_map.hpp"
#include "sweepkit/floor/grid_file.hpp"
#include "sweepkit/floor/reachable_floor.hpp"

namespace sweepkit::python {

namespace {

template <class D>
void bind_scan(py::class_<FloorScanner>& cls) {
  cls.def(
      "scan",
      [](FloorScanner& scanner, const py::array_t<D, py::array::c_style>& disparity,
         const RectifiedCamera& camera, const GroundPlane& plane, const Vector3& base_camera) {
        if (disparity.ndim() != 2)
          throw py::value_error("expected disparities, float32 or int16 of shape (height, width), got " +
                                describe(disparity));
        const View2d<const D> view{disparity.data(), static_cast<int>(disparity.shape(1)),
                                   static_cast<int>(disparity.shape(0))};
        const auto base = base_camera.eigen<Vec3<double>>();
        FloorScan scan;
        py::gil_scoped_release release;
        scanner.scan(view, camera, plane, base, scan);
        return scan;
      },
      py::arg("disparity").noconvert(), py::arg("camera"), py::arg("plane"), py::arg("base_camera"),
      "A scan of disparities in pixels (float32) or sixteenths (int16). base_camera: the robot's centre in "
      "the camera's frame [m].");
}

py::array cells_view(const GrayImage& image, const py::object& owner) {
  return image_view(image.view(), owner);
}

}  // namespace

void bind_floor_grid(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(FloorStretch, bearing, from, to, label, rows);
  m.attr("floor_stretch_dtype") = py::dtype::of<FloorStretch>();

  py::class_<PlanarPose>(m, "PlanarPose", "A place on the floor [m] and a heading [rad].")
      .def(py::init([](double x, double y, double yaw) {
             return PlanarPose{x, y, yaw};
           }),
           py::arg("x") = 0.0, py::arg("y") = 0.0, py::arg("yaw") = 0.0)
      .def_readwrite("x", &PlanarPose::x)
      .def_readwrite("y", &PlanarPose::y)
      .def_readwrite("yaw", &PlanarPose::yaw)
      .def_static("of", &PlanarPose::of, py::arg("T_map_scan"), py::arg("max_tilt"),
                  "What is left of a pose seen from above; None if it is tilted by more [rad].");

  bind_options<FloorScanOptions>(m, "FloorScanOptions", "What one image says of the floor.");
  bind_options<OccupancyGridOptions>(m, "OccupancyGridOptions", "Cells and evidence.");
  bind_options<FloorMapOptions>(m, "FloorMapOptions", "The floor as all scans show it.");

  py::class_<FloorScan>(m, "FloorScan", "What one image says of the floor, a few kilobytes.")
      .def(py::init<>())
      .def_readwrite("first_bearing", &FloorScan::first_bearing, "Of ray 0, counter-clockwise [rad].")
      .def_readwrite("bearing_step", &FloorScan::bearing_step, "[rad]")
      .def_readwrite("bearings", &FloorScan::bearings, "Number of rays.")
      .def_readwrite("range_noise", &FloorScan::range_noise, "[1/m]")
      .def_property(
          "footprint", [](const FloorScan& s) { return s.footprint; },
          [](FloorScan& s, const Vector2& p) { s.footprint = p.eigen<Vec2<double>>(); },
          "Centre of the robot [m].")
      .def_readwrite("footprint_radius", &FloorScan::footprint_radius, "[m]")
      .def_property(
          "stretches",
          [](const py::object& self) {
            const auto& s = self.cast<const FloorScan&>();
            return view_of(s.stretches.data(), {static_cast<py::ssize_t>(s.stretches.size())},
                           {static_cast<py::ssize_t>(sizeof(FloorStretch))}, self);
          },
          [](FloorScan& s, const py::array_t<FloorStretch, py::array::c_style>& rows) {
            if (rows.ndim() != 1)
              throw py::value_error("expected stretches of shape (n,), got " + describe(rows));
            s.stretches.assign(rows.data(), rows.data() + rows.size());
          },
          "Array of floor_stretch_dtype: bearing (index of the ray), from and to [mm], label, rows.")
      .def_property_readonly("bytes", &FloorScan::bytes, "Memory.");

  m.def("camera_from_scan", &camera_from_scan, py::arg("plane"),
        "SE3d from the frame of a scan (on the floor below the camera, x forward, z up) to the camera's.");

  py::class_<FloorScanner> scanner(m, "FloorScanner", "Makes scans of the floor from disparity images.");
  scanner.def(py::init<const FloorScanOptions&>(), py::arg("options") = FloorScanOptions{});
  bind_scan<std::int16_t>(scanner);
  bind_scan<float>(scanner);

  py::class_<OccupancyImage>(
      m, "OccupancyImage", "A map of the floor: 254 free, 0 occupied, 205 unknown; row 0 has the highest y.")
      .def(py::init([](const Gray& cells, double cell, const Vector2& origin) {
             OccupancyImage map;
             map.cell = cell;
             map.origin = origin.eigen<Vec2<double>>();
             map.cells.assign(cells.view());
             return map;
           }),
           py::arg("cells"), py::arg("cell") = 0.05, py::arg("origin") = py::make_tuple(0.0, 0.0))
      .def_readonly("cell", &OccupancyImage::cell, "[m]")
      .def_property_readonly(
          "origin", [](const OccupancyImage& map) { return map.origin; }, "Lower left corner [m].")
      .def_property_readonly(
          "cells",
          [](const py::object& self) { return cells_view(self.cast<const OccupancyImage&>().cells, self); },
          "uint8 (height, width), where they lie.")
      .def(
          "at", [](const OccupancyImage& map, const Vector2& p) { return map.at(p.eigen<Vec2<double>>()); },
          py::arg("p"), "The cell around a point; unknown outside.");

  py::class_<OccupancyGrid>(m, "OccupancyGrid", "Log-odds of the floor's cells being occupied.")
      .def(py::init<const OccupancyGridOptions&>(), py::arg("options") = OccupancyGridOptions{})
      .def("add", &OccupancyGrid::add, py::arg("scan"), py::arg("pose"),
           py::call_guard<py::gil_scoped_release>())
      .def("remove", &OccupancyGrid::remove, py::arg("scan"), py::arg("pose"),
           py::call_guard<py::gil_scoped_release>(), "Takes back a scan added at exactly this pose.")
      .def("clear", &OccupancyGrid::clear)
      .def(
          "log_odds",
          [](const OccupancyGrid& grid, const Vector2& p) {
            return static_cast<double>(grid.log_odds(p.eigen<Vec2<double>>())) / OccupancyGrid::kOne;
          },
          py::arg("p"), "Of the cell around a point; 0 where nothing is known.")
      .def_property_readonly(
          "cells",
          [](const py::object& self) {
            const auto view = self.cast<const OccupancyGrid&>().cells();
            const auto step = static_cast<py::ssize_t>(sizeof(std::int32_t));
            return view_of(view.data, {view.height, view.width}, {view.stride * step, step}, self);
          },
          "Log-odds in 1/1024, int32 (height, width), row 0 lowest, where they lie until the grid changes.")
      .def_property_readonly(
          "first", [](const OccupancyGrid& g) { return py::make_tuple(g.first_x(), g.first_y()); },
          "Indices of the first cell: cell (i, j) covers [i, i + 1) x [j, j + 1) cells of the map's frame.")
      .def_property_readonly("left_out", &OccupancyGrid::left_out)
      .def("image", &OccupancyGrid::image);

  py::class_<FloorMap>(m, "FloorMap", "Scans hung on keyframes, and the grid that follows them.")
      .def(py::init<const FloorMapOptions&>(), py::arg("options") = FloorMapOptions{})
      .def(
          "add",
          [](FloorMap& map, std::uint32_t keyframe, const SE3d& T, const FloorScan& scan) {
            map.add({keyframe}, T, scan);
          },
          py::arg("keyframe"), py::arg("T_keyframe_scan"), py::arg("scan"))
      .def(
          "set_pose",
          [](FloorMap& map, std::uint32_t keyframe, const std::optional<SE3d>& T) {
            map.set_pose({keyframe}, T);
          },
          py::arg("keyframe"), py::arg("T_map_keyframe"), "None takes its scans off the grid.")
      .def("update", &FloorMap::update, py::call_guard<py::gil_scoped_release>(),
           "Draws what is new or moved; returns how many scans.")
      .def("rebuild", &FloorMap::rebuild, py::call_guard<py::gil_scoped_release>())
      .def_property_readonly("grid", &FloorMap::grid, py::return_value_policy::reference_internal)
      .def("image", &FloorMap::image, py::call_guard<py::gil_scoped_release>(),
           "The grid as a map, without what lies behind walls by error.")
      .def_property_readonly("scans", &FloorMap::scans)
      .def_property_readonly("drawn", &FloorMap::drawn)
      .def_property_readonly("bytes", &FloorMap::bytes);

  py::class_<DrivableArea>(m, "DrivableArea", "Where a round robot can drive on a floor.")
      .def_property_readonly(
          "centres",
          [](const py::object& self) { return cells_view(self.cast<const DrivableArea&>().centres, self); },
          "255 where the robot's centre may be, else 0.")
      .def_property_readonly(
          "covered",
          [](const py::object& self) { return cells_view(self.cast<const DrivableArea&>().covered, self); },
          "255 in cells that come under the robot, else 0.")
      .def_readonly("centres_m2", &DrivableArea::centres_m2)
      .def_readonly("covered_m2", &DrivableArea::covered_m2)
      .def_readonly("found", &DrivableArea::found);
  m.def(
      "drivable_area",
      [](const OccupancyImage& map, const Vector2& position, double radius) {
        const auto p = position.eigen<Vec2<double>>();
        py::gil_scoped_release release;
        return drivable_area(map, p, radius);
      },
      py::arg("map"), py::arg("position"), py::arg("radius"),
      "The part of the free floor that a robot of that radius [m] reaches from a place.");
  m.def(
      "keep_reachable",
      [](OccupancyImage& map, const Points2& places) { keep_reachable(map, places.as<Vec2<double>>()); },
      py::arg("map"), py::arg("places"), "Takes out what lies behind walls by error; changes the map.");
  m.def("write_grid", &write_grid, py::arg("map"), py::arg("folder"), py::arg("name") = "grid",
        "Writes NAME.yaml and NAME.pgm in map_server's form.");
  m.def("read_grid", &read_grid, py::arg("yaml"), "Reads a map in map_server's form.");
}

}  // namespace sweepkit::python
