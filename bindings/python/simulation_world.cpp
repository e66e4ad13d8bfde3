// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/eigen.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <algorithm>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/data/flat.hpp"
#include "sweepkit/data/floor_plan.hpp"
#include "sweepkit/data/renderer.hpp"
#include "sweepkit/data/scene_file.hpp"
#include "sweepkit/data/scene_plot.hpp"

namespace sweepkit::python {

namespace {

template <class T>
py::array_t<T> array_of(const Image<T>& image) {
  py::array_t<T> result({image.height(), image.width()});
  for (int y = 0; y < image.height(); ++y)
    std::memcpy(result.mutable_data(y), image.row(y), sizeof(T) * static_cast<std::size_t>(image.width()));
  return result;
}

std::vector<Vec2<double>> points_of(const Points2& points) {
  const auto span = points.as<Vec2<double>>();
  return {span.begin(), span.end()};
}

py::dict truth_dict(const ObjectTruth& truth) {
  py::dict d;
  d["class"] = truth.object_class;
  d["name"] = truth.name;
  d["label"] = static_cast<int>(truth.label);
  d["centre"] = truth.centre;
  d["size"] = truth.size;
  d["yaw"] = truth.yaw;
  return d;
}

/// Calls a query of the floor plan for each point.
template <class Result, class Query>
py::array_t<Result> for_points(const Points2& points, Query&& query) {
  py::array_t<Result> result(static_cast<py::ssize_t>(points.size()));
  Result* out = result.mutable_data();
  for (const Vec2<double>& p : points.as<Vec2<double>>()) *out++ = query(p.x(), p.y());
  return result;
}

py::dict render(const Renderer& renderer, const Camera& camera, const SE3d& T_world_camera, double lamps,
                double daylight, const std::vector<MovingThing>& moving) {
  ViewRequest request;
  request.T_world_camera = T_world_camera;
  request.lamps = lamps;
  request.daylight = daylight;
  request.moving = moving;
  request.depth = true;
  RenderedView view;
  {
    py::gil_scoped_release release;
    renderer.render(RayTable(camera, renderer.options().samples), request, view);
  }
  py::dict d;
  d["radiance"] = array_of(view.radiance);
  d["depth"] = array_of(view.depth);
  d["label"] = array_of(view.label);
  return d;
}

}  // namespace

void register_simulation_world(py::module_& m) {
  bind_options<FlatOptions>(m, "FlatOptions", "What a generated flat is like.");
  bind_options<RendererOptions>(m, "RendererOptions", "How scenes are drawn.");

  py::class_<Scene>(m, "Scene", "A furnished flat. World: z up, the bare floor at z = 0; [m], [rad].")
      .def_static(
          "generate",
          [](const FlatOptions& options) {
            py::gil_scoped_release release;
            return generate_flat(options);
          },
          py::arg("options") = FlatOptions{}, "A flat from a seed.")
      .def_static("read", &read_scene, py::arg("file"), "The world of a scene file.")
      .def_static("parse", &parse_scene, py::arg("text"), py::arg("name") = "scene", "The same from text.")
      .def(
          "write", [](const Scene& s, const std::filesystem::path& file) { write_scene(s, file); },
          py::arg("file"), "Writes it, all in full.")
      .def("to_yaml", &scene_to_yaml, "What write() writes.")
      .def_readonly("name", &Scene::name)
      .def_readonly("yaw", &Scene::yaw, "Of the frame of the scene's file in the world.")
      .def_property_readonly(
          "rooms",
          [](const Scene& s) {
            py::list list;
            for (const Room& room : s.rooms) {
              py::dict d;
              d["name"] = room.name;
              py::array_t<double> corners({room.corners.size(), std::size_t{2}});
              std::memcpy(corners.mutable_data(), room.corners.data(), 16 * room.corners.size());
              d["corners"] = corners;
              d["main_direction"] = s.main_direction(room);
              list.append(d);
            }
            return list;
          },
          "name, corners (n, 2) in the world and main_direction (None if the walls have no common one) of "
          "each.")
      .def_property_readonly(
          "objects",
          [](const Scene& s) {
            py::list list;
            for (const ObjectTruth& truth : object_truth(s)) list.append(truth_dict(truth));
            return list;
          },
          "class, name, label, centre, size along the own axes and yaw of each.")
      .def(
          "to_svg",
          [](const Scene& s, const std::vector<Points2>& paths) {
            std::vector<PlanPath> lines;
            for (const Points2& path : paths) lines.push_back({points_of(path), "#d62728", ""});
            return scene_to_svg(s, lines);
          },
          py::arg("paths") = std::vector<Points2>{},
          "The flat from above as SVG, with paths (n, 2) in the world.")
      .def(
          "occupancy",
          [](const Scene& s, const Vector2& start, double cell) {
            TrueOccupancy map;
            {
              py::gil_scoped_release release;
              map = true_occupancy(s, start.eigen<Vec2<double>>(), cell);
            }
            py::dict d;
            d["cells"] = array_of(map.cells);
            d["origin"] = map.origin;
            d["cell"] = map.cell;
            return d;
          },
          py::arg("start"), py::arg("cell") = 0.05,
          "cells (uint8, row 0 has the highest y; 254 free, 0 occupied, 205 unknown), origin of the lower "
          "left corner, "
          "cell. Free is what can be reached from start.");

  py::class_<FloorPlan>(m, "FloorPlan", "The floor of a flat from above: how high it is, where a robot fits.")
      .def(py::init<const Scene&>(), py::arg("scene"))
      .def(
          "height",
          [](const FloorPlan& plan, const Points2& points) {
            return for_points<double>(points, [&](double x, double y) { return plan.height(x, y); });
          },
          py::arg("points"), "Height on which a wheel stands, over the bare floor, at points (n, 2) [m].")
      .def(
          "clearance",
          [](const FloorPlan& plan, const Points2& points) {
            return for_points<double>(points, [&](double x, double y) { return plan.clearance(x, y); });
          },
          py::arg("points"), "Distance to the nearest wall or obstacle; negative inside of one [m].")
      .def(
          "room_at",
          [](const FloorPlan& plan, const Points2& points) {
            return for_points<int>(points, [&](double x, double y) { return plan.room_at(x, y); });
          },
          py::arg("points"), "Index of the room around each point; -1 in doors and outside.")
      .def_property_readonly("low", &FloorPlan::low, "Lowest x and y of all rooms.")
      .def_property_readonly("high", &FloorPlan::high, "Highest x and y of all rooms.");

  py::class_<MovingThing>(m, "MovingThing", "Something that moves, at one instant.");
  m.def("walking_person", &walking_person, py::arg("T_world_person"), py::arg("phase"),
        "A person in mid stride; phase 1 is two steps on.");

  py::class_<Renderer>(m, "Renderer",
                       "Draws a scene by casting rays. Making one takes about a second a room.")
      .def(py::init([](const Scene& scene, const RendererOptions& options) {
             py::gil_scoped_release release;
             return std::make_unique<Renderer>(scene, options);
           }),
           py::arg("scene"), py::arg("options") = RendererOptions{})
      .def("render", &render, py::arg("camera"), py::arg("T_world_camera"), py::arg("lamps") = 1.0,
           py::arg("daylight") = 1.0, py::arg("moving") = std::vector<MovingThing>{},
           "What the camera sees, unrectified: radiance (float32, linear; white paper in a lit room is about "
           "1), depth "
           "(float32, z [m], 0: none), label (uint8).");
  m.def(
      "to_gray",
      [](const ArrayOf<float, -1, -1>& radiance, double mean) {
        require(mean > 0 && mean < 255, "to_gray mean", "must lie in 0 .. 255", mean);
        py::array_t<std::uint8_t> result({radiance.array.shape(0), radiance.array.shape(1)});
        const auto count = static_cast<std::size_t>(radiance.array.size());
        double sum = 0;
        for (std::size_t i = 0; i < count; ++i) sum += std::min(radiance.data()[i], 2.0f);
        const double gain = sum > 0 ? mean * static_cast<double>(count) / sum : 0.0;
        for (std::size_t i = 0; i < count; ++i)
          result.mutable_data()[i] =
              static_cast<std::uint8_t>(std::clamp(gain * radiance.data()[i] + 0.5, 0.0, 255.0));
        return result;
      },
      py::arg("radiance"), py::arg("mean") = 95.0,
      "An 8-bit image, exposed so that the mean, bright windows aside, has that grey value; no noise.");
}

}  // namespace sweepkit::python
