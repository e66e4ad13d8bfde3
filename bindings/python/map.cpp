// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <cstring>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/data/atlas_file.hpp"
#include "sweepkit/map/atlas.hpp"
#include "sweepkit/slam/map_culling.hpp"

namespace sweepkit::python {

namespace {

using Rows = ArrayOf<std::uint8_t, -1, 32>;
using MeasurementRows = ArrayOf<float, -1, 7>;

// Keyframes or points that live, in the order of their ids.
template <class IdType, class Visit>
void for_each(const Map& map, Visit visit) {
  const std::uint32_t end = std::is_same_v<IdType, KeyframeId> ? map.keyframe_id_end() : map.point_id_end();
  for (std::uint32_t i = 0; i < end; ++i)
    if (const auto* found = map.find(IdType{i})) visit(*found);
}

template <class T>
py::array_t<T> table(const std::vector<T>& values, py::ssize_t columns) {
  py::array_t<T> result({static_cast<py::ssize_t>(values.size()) / columns, columns});
  if (!values.empty()) std::memcpy(result.mutable_data(), values.data(), values.size() * sizeof(T));
  return result;
}

template <class T, class IdType, class Get>
py::array_t<T> column(const Map& map, Get get) {
  std::vector<T> values;
  for_each<IdType>(map, [&](const auto& entry) { values.push_back(get(entry)); });
  return py::array_t<T>(static_cast<py::ssize_t>(values.size()), values.data());
}

void append(std::vector<double>& values, const SE3d& T) {
  const Eigen::Matrix<double, 4, 4, Eigen::RowMajor> rows = T.matrix();
  values.insert(values.end(), rows.data(), rows.data() + 16);
}

py::array_t<double> poses(const std::vector<double>& values) {
  py::array_t<double> result({static_cast<py::ssize_t>(values.size()) / 16, py::ssize_t{4}, py::ssize_t{4}});
  if (!values.empty()) std::memcpy(result.mutable_data(), values.data(), values.size() * sizeof(double));
  return result;
}

std::uint32_t add_keyframe(Map& map, std::uint32_t map_id, TimeNs t, const SE3d& T_camera_world,
                           const MeasurementRows& measurements, const Rows& descriptors,
                           std::optional<std::uint32_t> parent) {
  Keyframe keyframe;
  keyframe.map = MapId{map_id};
  keyframe.t = t;
  keyframe.T_camera_world = T_camera_world;
  if (parent) keyframe.parent = KeyframeId{*parent};
  for (std::size_t i = 0; i < measurements.size(); ++i) {
    const float* row = measurements.data() + 7 * i;
    keyframe.measurements.push_back(
        {row[0], row[1], row[2], row[3], row[4], row[5], static_cast<std::int32_t>(row[6])});
  }
  keyframe.descriptors.resize(descriptors.size());
  if (descriptors.size() > 0)
    std::memcpy(keyframe.descriptors.data(), descriptors.data(), descriptors.size() * sizeof(OrbDescriptor));
  return map.add_keyframe(std::move(keyframe)).value;
}

void bind_map(py::module_& m) {
  py::class_<Map>(
      m, "Map",
      "Keyframes, points and who saw what. Arrays are copies; ids are plain numbers, never used again.")
      .def(py::init<>())
      .def(
          "add_map", [](Map& map) { return map.add_map().value; }, "Starts another map; gives its id.")
      .def("add_keyframe", &add_keyframe, py::arg("map"), py::arg("t"), py::arg("T_camera_world"),
           py::arg("measurements"), py::arg("descriptors"), py::arg("parent") = py::none(),
           "Adds a keyframe and gives its id. measurements: u, v, u_right (negative: none), sigma, "
           "sigma_right [px], "
           "angle [rad], octave in rows; descriptors: uint8, 32 in a row.")
      .def(
          "remove_keyframe", [](Map& map, std::uint32_t id) { map.remove_keyframe(KeyframeId{id}); },
          py::arg("id"))
      .def(
          "add_point",
          [](Map& map, const Vector3& p, std::uint32_t keyframe, std::uint32_t index) {
            return map.add_point(p.eigen<Vec3<double>>(), KeyframeId{keyframe}, index).value;
          },
          py::arg("p_world"), py::arg("keyframe"), py::arg("index"),
          "Makes a point [m] seen at that measurement; gives its id.")
      .def(
          "add_observation",
          [](Map& map, std::uint32_t point, std::uint32_t keyframe, std::uint32_t index) {
            return map.add_observation(PointId{point}, KeyframeId{keyframe}, index);
          },
          py::arg("point"), py::arg("keyframe"), py::arg("index"), "False if it or the measurement is taken.")
      .def(
          "set_pose", [](Map& map, std::uint32_t id, const SE3d& T) { map.set_pose(KeyframeId{id}, T); },
          py::arg("id"), py::arg("T_camera_world"))
      .def("broken_invariant", &Map::broken_invariant, "The first invariant found broken, or None.")
      .def("memory_bytes", &Map::memory_bytes, "What the map takes.")
      .def_property_readonly("map_count", &Map::map_count)
      .def_property_readonly("keyframe_count", &Map::keyframe_count)
      .def_property_readonly("point_count", &Map::point_count)
      .def_property_readonly(
          "keyframe_ids",
          [](const Map& map) {
            return column<std::uint32_t, KeyframeId>(map, [](const Keyframe& k) { return k.id.value; });
          },
          "uint32 of shape (n,), rising; the other arrays of keyframes have their order.")
      .def_property_readonly(
          "keyframe_maps",
          [](const Map& map) {
            return column<std::uint32_t, KeyframeId>(map, [](const Keyframe& k) { return k.map.value; });
          },
          "Map of each keyframe.")
      .def_property_readonly(
          "keyframe_times",
          [](const Map& map) {
            return column<std::int64_t, KeyframeId>(map, [](const Keyframe& k) { return k.t; });
          },
          "[ns]")
      .def_property_readonly(
          "keyframe_poses",
          [](const Map& map) {
            std::vector<double> values;
            for_each<KeyframeId>(map, [&](const Keyframe& k) { append(values, k.T_camera_world.inverse()); });
            return poses(values);
          },
          "T_world_camera of the rectified left camera, float64 of shape (n, 4, 4).")
      .def_property_readonly(
          "point_ids",
          [](const Map& map) {
            return column<std::uint32_t, PointId>(map, [](const MapPoint& p) { return p.id.value; });
          },
          "uint32 of shape (n,), rising.")
      .def_property_readonly(
          "points",
          [](const Map& map) {
            std::vector<double> values;
            for_each<PointId>(map, [&](const MapPoint& p) {
              values.insert(values.end(), p.p_world.data(), p.p_world.data() + 3);
            });
            return table(values, 3);
          },
          "float64 of shape (n, 3), in the order of point_ids [m].")
      .def_property_readonly(
          "observations",
          [](const Map& map) {
            std::vector<std::uint32_t> values;
            for_each<PointId>(map, [&](const MapPoint& p) {
              for (const Observation& o : p.observations)
                values.insert(values.end(), {p.id.value, o.keyframe.value, o.index});
            });
            return table(values, 3);
          },
          "uint32 of shape (n, 3): point, keyframe, measurement of it.")
      .def_property_readonly(
          "covisibility",
          [](const Map& map) {
            std::vector<std::uint32_t> values;
            for_each<KeyframeId>(map, [&](const Keyframe& k) {
              for (const Covisible& c : k.covisible)
                if (k.id < c.keyframe)
                  values.insert(values.end(),
                                {k.id.value, c.keyframe.value, static_cast<std::uint32_t>(c.points)});
            });
            return table(values, 3);
          },
          "uint32 of shape (n, 3): two keyframes, the smaller id first, and how many points they share.")
      .def_property_readonly(
          "parents",
          [](const Map& map) {
            std::vector<std::uint32_t> values;
            for_each<KeyframeId>(map, [&](const Keyframe& k) {
              if (k.parent.valid()) values.insert(values.end(), {k.id.value, k.parent.value});
            });
            return table(values, 2);
          },
          "uint32 of shape (n, 2): keyframe and its parent in the spanning tree.")
      .def_property_readonly(
          "odometry",
          [](const Map& map) {
            std::vector<std::uint32_t> ids;
            std::vector<double> motions;
            for_each<KeyframeId>(map, [&](const Keyframe& k) {
              if (!k.odometry) return;
              ids.insert(ids.end(), {k.odometry->from.value, k.id.value});
              append(motions, k.odometry->motion.T);
            });
            return py::make_tuple(table(ids, 2), poses(motions));
          },
          "Edges of odometry: keyframes from and to, uint32 of shape (n, 2), and T_from_to between their "
          "cameras, "
          "float64 of shape (n, 4, 4).")
      .def(
          "measurements",
          [](const Map& map, std::uint32_t id) {
            std::vector<float> values;
            for (const Measurement& x : map.keyframe(KeyframeId{id}).measurements)
              values.insert(values.end(), {x.u, x.v, x.u_right, x.sigma, x.sigma_right, x.angle,
                                           static_cast<float>(x.octave)});
            return table(values, 7);
          },
          py::arg("keyframe"), "As add_keyframe takes them, float32 of shape (n, 7).")
      .def(
          "descriptors",
          [](const Map& map, std::uint32_t id) {
            const auto& list = map.keyframe(KeyframeId{id}).descriptors;
            std::vector<std::uint8_t> values(list.size() * sizeof(OrbDescriptor));
            if (!list.empty()) std::memcpy(values.data(), list.data(), values.size());
            return table(values, 32);
          },
          py::arg("keyframe"), "uint8 of shape (n, 32).");
}

void bind_atlas(py::module_& m) {
  py::class_<Atlas>(m, "Atlas", "Maps and what a later run needs to go on with them.")
      .def(py::init([](const StereoRig& rig) {
             Atlas atlas;
             atlas.info.rig = identity_of(rig);
             return atlas;
           }),
           py::arg("rig"), "Without any keyframe yet, for maps of that rig.")
      .def_property_readonly(
          "map", [](Atlas& a) -> Map& { return a.map; }, py::return_value_policy::reference_internal)
      .def_property(
          "vocabulary", [](const Atlas& a) { return a.info.vocabulary; },
          [](Atlas& a, const std::string& name) { a.info.vocabulary = name; },
          "Name of the vocabulary in use; empty if there was none.")
      .def_property(
          "vocabulary_checksum", [](const Atlas& a) { return a.info.vocabulary_checksum; },
          [](Atlas& a, std::uint64_t sum) { a.info.vocabulary_checksum = sum; })
      .def_property(
          "disparity_bias", [](const Atlas& a) { return a.info.disparity_bias; },
          [](Atlas& a, double bias) { a.info.disparity_bias = bias; },
          "Taken off the disparities already [px].")
      .def_property(
          "gravity_known", [](const Atlas& a) { return a.info.gravity_known; },
          [](Atlas& a, const std::vector<bool>& known) { a.info.gravity_known = known; },
          "By map: whether z of its world is up.")
      .def_property(
          "attachments",
          [](const Atlas& a) {
            std::map<std::string, std::map<std::uint32_t, py::bytes>> all;
            for (const auto& [name, pieces] : a.info.attachments)
              for (const KeyframeAttachment& piece : pieces)
                all[name][piece.keyframe.value] =
                    py::bytes(reinterpret_cast<const char*>(piece.bytes.data()), piece.bytes.size());
            return all;
          },
          [](Atlas& a, const std::map<std::string, std::map<std::uint32_t, py::bytes>>& all) {
            a.info.attachments.clear();
            for (const auto& [name, pieces] : all)
              for (const auto& [id, bytes] : pieces) {
                const std::string_view view = bytes;
                const auto* data = reinterpret_cast<const std::byte*>(view.data());
                a.info.attachments[name].push_back({KeyframeId{id}, {data, data + view.size()}});
              }
          },
          "By name and keyframe, bytes that somebody keeps with it; a copy: set the whole.")
      .def_property_readonly(
          "software", [](const Atlas& a) { return a.info.software; }, "Version that wrote it.")
      .def(
          "rig_difference",
          [](const Atlas& a, const StereoRig& rig) { return difference(a.info.rig, identity_of(rig)); },
          py::arg("rig"), "The first difference to a rig in words, or None.");
}

}  // namespace

void register_atlas_files(py::module_& m) {
  m.def(
      "write_atlas",
      [](const std::filesystem::path& path, const Atlas& atlas) { write_atlas(path.string(), atlas); },
      py::arg("path"), py::arg("atlas"), py::call_guard<py::gil_scoped_release>(),
      "Writes an atlas, whole or not at all; points are numbered anew.");
  m.def(
      "read_atlas", [](const std::filesystem::path& path) { return read_atlas(path.string()); },
      py::arg("path"), py::call_guard<py::gil_scoped_release>(),
      "Reads an atlas. DataError names file, section, byte and value of what is wrong.");
}

void register_map_culling(py::module_& m) {
  bind_options<MapCaps>(m, "MapCaps", "How large a map may become.");
  m.def(
      "choose_culls",
      [](const Map& map, const MapCaps& caps, const std::vector<std::uint32_t>& keep) {
        std::vector<KeyframeId> ids;
        for (const std::uint32_t id : keep) ids.push_back(KeyframeId{id});
        std::vector<std::uint32_t> chosen;
        for (const KeyframeId id : choose_culls(map, caps, ids)) chosen.push_back(id.value);
        return py::array_t<std::uint32_t>(static_cast<py::ssize_t>(chosen.size()), chosen.data());
      },
      py::arg("map"), py::arg("caps"), py::arg("keep") = std::vector<std::uint32_t>(),
      "Ids of the keyframes to remove, in that order, for the map to be within its caps.");
  m.def("count_views", &count_views, py::arg("map"), py::arg("caps"), py::arg("doublings") = 0,
        "How many cells of position and sectors of direction the map knows.");
}

void register_map(py::module_& m) {
  bind_map(m);
  bind_atlas(m);
}

}  // namespace sweepkit::python
