// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/grid_evaluation.hpp"

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cstdint>
#include <vector>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"

// A list of poses would be converted element by element; data.cpp binds it as a class.
PYBIND11_MAKE_OPAQUE(sweepkit::Trajectory)

namespace sweepkit::python {

void register_grid_evaluation(py::module_& m) {
  py::class_<FloorView>(m, "FloorView", "From where a camera looked over the floor.")
      .def(py::init([](const PlanarPose& pose, double right, double left, double near) {
             return FloorView{pose, right, left, near};
           }),
           py::arg("pose"), py::arg("right"), py::arg("left"), py::arg("near") = 0.0)
      .def_readwrite("pose", &FloorView::pose, "Of the point below the camera; yaw along what it looks at.")
      .def_readwrite("right", &FloorView::right,
                     "Of its field of view, counter-clockwise from the yaw [rad].")
      .def_readwrite("left", &FloorView::left, "[rad]")
      .def_readwrite("near", &FloorView::near, "Floor that is nearer lies below the image [m].");
  m.def("floor_views", &floor_views, py::arg("recording"), py::arg("truth"),
        "Where the left camera of a recording stood, every 0.1 s, not while it was dark or lifted.");

  bind_options<GridEvaluationOptions>(m, "GridEvaluationOptions", "How occupancy grids are compared.");
  py::class_<GridEvaluation>(m, "GridEvaluation",
                             "How far an occupancy grid is from the truth, in its cells.")
      .def_readonly("options", &GridEvaluation::options)
      .def_readonly("cell", &GridEvaluation::cell, "Of the truth [m].")
      .def_readonly("views", &GridEvaluation::views, "From how many places the floor was seen.")
      .def_readonly("visible", &GridEvaluation::visible, "Truly free and visible.")
      .def_readonly("found", &GridEvaluation::found, "Of these, free in the grid.")
      .def_readonly("missed_as_wall", &GridEvaluation::missed_as_wall, "Of these, occupied in the grid.")
      .def_readonly("false_free", &GridEvaluation::false_free, "Free in the grid but not in truth.")
      .def_readonly("free", &GridEvaluation::free, "Free in the grid.")
      .def_readonly("grid_walls", &GridEvaluation::grid_walls, "Occupied cells of the grid.")
      .def_readonly("right_walls", &GridEvaluation::right_walls, "Of these, at most a cell from a true one.")
      .def_readonly("true_walls", &GridEvaluation::true_walls, "Visible occupied cells of the truth.")
      .def_readonly("found_walls", &GridEvaluation::found_walls, "Of these, at most a cell from the grid's.")
      .def_property_readonly("iou", &GridEvaluation::iou, "Of the free space that was visible.")
      .def_property_readonly("precision", &GridEvaluation::precision, "Share of the grid's free cells.")
      .def_property_readonly("recall", &GridEvaluation::recall, "Share of the visible free cells.")
      .def_property_readonly("right_wall_share", &GridEvaluation::right_wall_share)
      .def_property_readonly("found_wall_share", &GridEvaluation::found_wall_share)
      .def("to_json", [](const GridEvaluation& e) { return to_json(e); })
      .def("to_table", [](const GridEvaluation& e) { return to_table(e); })
      .def("__str__", [](const GridEvaluation& e) { return to_table(e); });
  m.def(
      "evaluate_grid",
      [](const OccupancyImage& grid, const OccupancyImage& truth, const PlanarPose& T_truth_grid,
         const std::vector<FloorView>& views, const GridEvaluationOptions& options) {
        py::gil_scoped_release release;
        return evaluate_grid(grid, truth, T_truth_grid, views, options);
      },
      py::arg("grid"), py::arg("truth"), py::arg("T_truth_grid") = PlanarPose{},
      py::arg("views") = std::vector<FloorView>{}, py::arg("options") = GridEvaluationOptions{},
      "Compares an occupancy grid with the true one. Without views all counts as visible.");
  m.def(
      "visible_floor",
      [](const OccupancyImage& truth, const std::vector<FloorView>& views,
         const GridEvaluationOptions& options) {
        const GrayImage visible = visible_floor(truth, views, options);
        py::array_t<std::uint8_t> array({visible.height(), visible.width()});
        for (int y = 0; y < visible.height(); ++y)
          std::copy_n(visible.view().row(y), visible.width(), array.mutable_data(y));
        return array;
      },
      py::arg("truth"), py::arg("views"), py::arg("options") = GridEvaluationOptions{},
      "uint8 (height, width): 255 in cells of the truth that could be seen, else 0.");
}

}  // namespace sweepkit::python
