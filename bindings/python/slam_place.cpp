// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <cstring>
#include <memory>
#include <optional>
#include <string>

#include "arrays.hpp"
#include "options.hpp"
#include "sweepkit/slam/place_recognition.hpp"

namespace sweepkit::python {

void register_slam_place(py::module_& m);

namespace {

using DescriptorRows = ArrayOf<std::uint8_t, -1, 32>;
using MeasurementRows = ArrayOf<float, -1, 7>;

StereoFrame make_frame(TimeNs t, const MeasurementRows& measurements, const DescriptorRows& descriptors) {
  StereoFrame frame;
  frame.t = t;
  for (std::size_t i = 0; i < measurements.size(); ++i) {
    const float* row = measurements.data() + 7 * i;
    frame.measurements.push_back(
        {row[0], row[1], row[2], row[3], row[4], row[5], static_cast<std::int32_t>(row[6])});
  }
  frame.descriptors.resize(descriptors.size());
  if (descriptors.size() > 0)
    std::memcpy(frame.descriptors.data(), descriptors.data(), descriptors.size() * sizeof(OrbDescriptor));
  frame.grid.build(frame.measurements);
  return frame;
}

std::optional<Vec3<double>> vector_of(const std::optional<Vector3>& v) {
  if (!v) return std::nullopt;
  return v->eigen<Vec3<double>>();
}

py::dict counts_of(const PlaceCounts& counts) {
  py::dict result;
  result["queries"] = counts.queries;
  result["candidates"] = counts.candidates;
  result["accepted"] = counts.accepted;
  for (std::size_t r = 1; r < kPlaceRejections; ++r)
    result[py::str(std::string(to_string(static_cast<PlaceRejection>(r))))] = counts.rejected[r];
  return result;
}

py::array_t<std::uint32_t> pairs_of(const PlaceMatch& match) {
  py::array_t<std::uint32_t> pairs({static_cast<py::ssize_t>(match.pairs.size()), py::ssize_t{2}});
  auto rows = pairs.mutable_unchecked<2>();
  for (std::size_t i = 0; i < match.pairs.size(); ++i) {
    rows(static_cast<py::ssize_t>(i), 0) = match.pairs[i].measurement;
    rows(static_cast<py::ssize_t>(i), 1) = match.pairs[i].point.value;
  }
  return pairs;
}

std::unique_ptr<PlaceRecognizer> make_recognizer(const StereoRig& rig,
                                                 std::shared_ptr<OrbVocabulary> vocabulary,
                                                 const PlaceRecognizerOptions& options, double scale_factor,
                                                 int levels) {
  const RectifiedCamera camera{rig.focal(), rig.center().x(), rig.center().y(), rig.baseline()};
  return std::make_unique<PlaceRecognizer>(camera, rig.bounds(), ScaleLevels{scale_factor, levels},
                                           std::move(vocabulary), options);
}

}  // namespace

void register_slam_place(py::module_& m) {
  bind_options<PlaceDatabaseOptions>(m, "PlaceDatabaseOptions", "Which keyframes look alike.");
  bind_options<PlaceVerifierOptions>(m, "PlaceVerifierOptions", "Whether they show the same place.");
  bind_options<PlaceRecognizerOptions>(m, "PlaceRecognizerOptions", "Places known again.");

  py::class_<PlaceGroup>(m, "PlaceGroup", "Covisible keyframes that look like an image.")
      .def_property_readonly("best", [](const PlaceGroup& g) { return g.best.value; })
      .def_property_readonly("map", [](const PlaceGroup& g) { return g.map.value; })
      .def_readonly("score", &PlaceGroup::score)
      .def_property_readonly("members", [](const PlaceGroup& g) {
        std::vector<std::uint32_t> ids;
        for (const KeyframeId id : g.members) ids.push_back(id.value);
        return ids;
      });

  py::class_<PlaceMatch>(m, "PlaceMatch", "A place known again.")
      .def_property_readonly(
          "query",
          [](const PlaceMatch& p) {
            return p.query.valid() ? std::optional(p.query.value) : std::optional<std::uint32_t>();
          },
          "The keyframe that knows it, None if it was a frame.")
      .def_property_readonly("candidate", [](const PlaceMatch& p) { return p.candidate.value; })
      .def_property_readonly("map", [](const PlaceMatch& p) { return p.map.value; })
      .def_readonly("T_camera_world", &PlaceMatch::T_camera_world,
                    "The image's rectified left camera in the candidate's map.")
      .def_readonly("T_query_candidate", &PlaceMatch::T_query_candidate)
      .def_property_readonly("covariance", [](const PlaceMatch& p) { return p.covariance; })
      .def_property_readonly("pairs", &pairs_of, "Measurement of the image and id of the point, in rows.")
      .def_readonly("matches", &PlaceMatch::matches)
      .def_readonly("predicted", &PlaceMatch::predicted)
      .def_readonly("found", &PlaceMatch::found)
      .def_readonly("seen_share", &PlaceMatch::seen_share)
      .def_readonly("inverse_share", &PlaceMatch::inverse_share)
      .def_readonly("contradictions", &PlaceMatch::contradictions)
      .def_readonly("off_plane", &PlaceMatch::off_plane)
      .def_property_readonly("cells", [](const PlaceMatch& m) { return m.cells.count(); })
      .def_readonly("confirmations", &PlaceMatch::confirmations);

  py::class_<PlaceRecognizer>(
      m, "PlaceRecognizer",
      "Says of keyframes and frames where in a map they were taken. measurements: u, "
      "v, u_right (negative: none), sigma, sigma_right [px], angle [rad], octave in "
      "rows; descriptors: uint8, 32 in a row. Gravity is a direction, in the rectified "
      "left camera and in the map's world.")
      .def(py::init(&make_recognizer), py::arg("rig"), py::arg("vocabulary"),
           py::arg("options") = PlaceRecognizerOptions{}, py::arg("scale_factor") = 1.2,
           py::arg("levels") = 8)
      .def(
          "follow", [](PlaceRecognizer& r, const Map& map) { r.database().follow(map); }, py::arg("map"),
          py::call_guard<py::gil_scoped_release>(),
          "Adds the keyframes of the map that are missing and forgets those that are gone.")
      .def("__len__", [](const PlaceRecognizer& r) { return r.database().size(); })
      .def_property_readonly("memory_bytes",
                             [](const PlaceRecognizer& r) { return r.database().memory_bytes(); })
      .def(
          "candidates",
          [](const PlaceRecognizer& r, const Map& map, const MeasurementRows& measurements,
             const DescriptorRows& descriptors) {
            const StereoFrame frame = make_frame(0, measurements, descriptors);
            py::gil_scoped_release release;
            return r.database().candidates(r.database().image(frame), map);
          },
          py::arg("map"), py::arg("measurements"), py::arg("descriptors"),
          "Groups of keyframes that look like an image, best first within each map.")
      .def(
          "feed",
          [](PlaceRecognizer& r, const Map& map, std::uint32_t keyframe,
             const std::optional<Vector3>& gravity) {
            const auto down = vector_of(gravity);
            py::gil_scoped_release release;
            return r.feed(map, KeyframeId{keyframe}, down ? &*down : nullptr);
          },
          py::arg("map"), py::arg("keyframe"), py::arg("gravity") = py::none(),
          "A new keyframe of the map: the place where it was before, or None. Adds it.")
      .def(
          "locate",
          [](PlaceRecognizer& r, const Map& map, TimeNs t, const MeasurementRows& measurements,
             const DescriptorRows& descriptors, const std::optional<Vector3>& gravity_camera,
             const std::optional<Vector3>& gravity_world, const SE3d* T_camera_odom) {
            const StereoFrame frame = make_frame(t, measurements, descriptors);
            const auto in_camera = vector_of(gravity_camera), in_world = vector_of(gravity_world);
            py::gil_scoped_release release;
            return r.locate(map, frame, in_camera ? &*in_camera : nullptr, in_world ? &*in_world : nullptr,
                            T_camera_odom);
          },
          py::arg("map"), py::arg("t"), py::arg("measurements"), py::arg("descriptors"),
          py::arg("gravity_camera") = py::none(), py::arg("gravity_world") = py::none(),
          py::arg("T_camera_odom") = nullptr, "Where a frame of no map was taken, or None.")
      .def("forget", &PlaceRecognizer::forget, "Forgets the frames that locate() has seen.")
      .def_property_readonly("counts", [](const PlaceRecognizer& r) { return counts_of(r.counts()); })
      .def_property_readonly("last_rejection", [](const PlaceRecognizer& r) {
        return std::string(to_string(r.last_rejection()));
      });
}

}  // namespace sweepkit::python
