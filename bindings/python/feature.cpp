// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <memory>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/feature/line_extractor.hpp"
#include "sweepkit/feature/orb.hpp"

namespace sweepkit::python {

namespace {

using KeyPointArray = py::array_t<KeyPoint, py::array::c_style>;
using DescriptorArray = ArrayOf<std::uint8_t, -1, 32>;

Features<256> make_features(const py::object& keypoints, const DescriptorArray& descriptors) {
  const py::array given = py::array::ensure(keypoints);
  if (!given || given.ndim() != 1 || !given.dtype().equal(py::dtype::of<KeyPoint>()))
    throw py::value_error("expected key points of dtype " +
                          py::str(py::dtype::of<KeyPoint>()).cast<std::string>() + " of shape (n,), got " +
                          (given ? describe(given) : "something else"));
  const KeyPointArray points = KeyPointArray::ensure(given);
  require(static_cast<std::size_t>(points.size()) == descriptors.size(), "Features descriptors",
          "must be as many as the key points", descriptors.size());
  Features<256> features;
  features.keypoints.assign(points.data(), points.data() + points.size());
  const auto* codes = reinterpret_cast<const OrbDescriptor*>(descriptors.data());
  features.descriptors.resize(descriptors.size());
  std::copy_n(reinterpret_cast<const char*>(codes), 32 * descriptors.size(),
              reinterpret_cast<char*>(features.descriptors.data()));
  return features;
}

using SegmentArray = ArrayOf<float, -1, 4>;

py::array_t<float> rows_of(const std::vector<LineSegment>& segments) {
  py::array_t<float> rows({static_cast<py::ssize_t>(segments.size()), py::ssize_t{4}});
  for (std::size_t i = 0; i < segments.size(); ++i)
    std::copy_n(&segments[i].x1, 4, rows.mutable_data() + 4 * i);
  return rows;
}

std::vector<LineSegment> segments_of(const SegmentArray& rows) {
  std::vector<LineSegment> segments(rows.size());
  for (std::size_t i = 0; i < segments.size(); ++i) {
    const float* row = rows.data() + 4 * i;
    segments[i].x1 = row[0];
    segments[i].y1 = row[1];
    segments[i].x2 = row[2];
    segments[i].y2 = row[3];
  }
  return segments;
}

std::shared_ptr<LineFeatures<256>> make_lines(const SegmentArray& segments,
                                              const DescriptorArray& descriptors) {
  require(segments.size() == descriptors.size(), "LineFeatures descriptors",
          "must be as many as the segments", descriptors.size());
  auto lines = std::make_shared<LineFeatures<256>>();
  lines->segments = segments_of(segments);
  lines->descriptors.resize(descriptors.size());
  std::copy_n(reinterpret_cast<const char*>(descriptors.data()), 32 * descriptors.size(),
              reinterpret_cast<char*>(lines->descriptors.data()));
  return lines;
}

void register_lines(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(LineSegment, x1, y1, x2, y2, width, contrast, response, octave);
  m.attr("segment_dtype") = py::dtype::of<LineSegment>();

  bind_options<SegmentOptions>(m, "SegmentOptions", "What counts as a line segment.");
  bind_options<LineOptions>(m, "LineOptions", "What LineExtractor looks for.");
  py::class_<SegmentDetector>(m, "SegmentDetector",
                              "Finds line segments at one size of the image. One for each thread.")
      .def(py::init<const SegmentOptions&>(), py::arg("options") = SegmentOptions{})
      .def_property_readonly("options", [](const SegmentDetector& d) { return d.options(); })
      .def(
          "detect",
          [](SegmentDetector& detector, const Gray& image) {
            const GrayView view = image.view();
            std::vector<LineSegment> segments;
            {
              py::gil_scoped_release release;
              detector.detect(view, segments);
            }
            return rows_of(segments);
          },
          py::arg("image"),
          "float32 of shape (n, 4): x1, y1, x2, y2 [px], the dark side on the left hand; none in an image "
          "without edges.");

  py::class_<LineFeatures<256>, std::shared_ptr<LineFeatures<256>>>(
      m, "LineFeatures", "Line segments of one image and their descriptors, index by index. Does not change.")
      .def(py::init(&make_lines), py::arg("segments"), py::arg("descriptors"))
      .def_property_readonly(
          "segments",
          [](const py::object& self) {
            const auto& segments = self.cast<const LineFeatures<256>&>().segments;
            return view_of(reinterpret_cast<const float*>(segments.data()),
                           {static_cast<py::ssize_t>(segments.size()), 4},
                           {sizeof(LineSegment), sizeof(float)}, self);
          },
          "float32 of shape (n, 4): x1, y1, x2, y2 [px]; where they lie.")
      .def_property_readonly(
          "records",
          [](const py::object& self) {
            const auto& segments = self.cast<const LineFeatures<256>&>().segments;
            return view_of(segments.data(), {static_cast<py::ssize_t>(segments.size())},
                           {sizeof(LineSegment)}, self);
          },
          "Array of segment_dtype: also width [px], contrast [grey levels / px], response (-log10 of the "
          "expected false alarms) and octave; where they lie.")
      .def_property_readonly(
          "descriptors",
          [](const py::object& self) -> py::array_t<std::uint8_t> {
            const auto& codes = self.cast<const LineFeatures<256>&>().descriptors;
            return view_of(reinterpret_cast<const std::uint8_t*>(codes.data()),
                           {static_cast<py::ssize_t>(codes.size()), 32}, {sizeof(LineDescriptor), 1}, self);
          },
          "uint8 of shape (n, 32); where they lie.")
      .def("__len__", [](const LineFeatures<256>& f) { return f.size(); });

  py::class_<LineExtractor>(m, "LineExtractor", "Finds and describes line segments. One for each thread.")
      .def(py::init<const LineOptions&>(), py::arg("options") = LineOptions{})
      .def_property_readonly("options", [](const LineExtractor& e) { return e.options(); })
      .def(
          "extract",
          [](LineExtractor& extractor, const Gray& image) {
            const GrayView view = image.view();
            auto lines = std::make_shared<LineFeatures<256>>();
            py::gil_scoped_release release;
            extractor.extract(view, *lines);
            return lines;
          },
          py::arg("image"), "LineFeatures of an image, at all its sizes.")
      .def(
          "describe",
          [](LineExtractor& extractor, const Gray& image, const SegmentArray& rows) {
            const GrayView view = image.view();
            const std::vector<LineSegment> segments = segments_of(rows);
            std::vector<LineDescriptor> codes;
            if (view.empty()) {
              codes.resize(segments.size());
            } else {
              py::gil_scoped_release release;
              ImagePyramid pyramid;
              pyramid.build(view, 1, 2.0);
              extractor.describe(pyramid, segments, codes);
            }
            py::array_t<std::uint8_t> result({static_cast<py::ssize_t>(codes.size()), py::ssize_t{32}});
            std::copy_n(reinterpret_cast<const std::uint8_t*>(codes.data()), 32 * codes.size(),
                        result.mutable_data());
            return result;
          },
          py::arg("image"), py::arg("segments"),
          "Descriptors of given segments, (n, 4), at the full size of the image: uint8 of shape (n, 32). "
          "Zeros "
          "for what is shorter than a pixel, not finite, or beyond 16384 px.");
}

}  // namespace

void register_feature(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(KeyPoint, x, y, angle, response, octave);
  m.attr("keypoint_dtype") = py::dtype::of<KeyPoint>();

  bind_options<OrbOptions>(m, "OrbOptions", "What OrbExtractor looks for.");
  py::class_<Features<256>, std::shared_ptr<Features<256>>>(
      m, "Features", "Key points of one image and their descriptors, index by index. Does not change.")
      .def(py::init(&make_features), py::arg("keypoints"), py::arg("descriptors"))
      .def_property_readonly(
          "keypoints",
          [](const py::object& self) {
            const auto& points = self.cast<const Features<256>&>().keypoints;
            return view_of(points.data(), {static_cast<py::ssize_t>(points.size())}, {sizeof(KeyPoint)},
                           self);
          },
          "Array of keypoint_dtype: x, y [px], angle [rad], response, octave; where they lie.")
      .def_property_readonly(
          "descriptors",
          [](const py::object& self) -> py::array_t<std::uint8_t> {
            const auto& codes = self.cast<const Features<256>&>().descriptors;
            return view_of(reinterpret_cast<const std::uint8_t*>(codes.data()),
                           {static_cast<py::ssize_t>(codes.size()), 32}, {sizeof(OrbDescriptor), 1}, self);
          },
          "uint8 of shape (n, 32), as OpenCV's; where they lie.")
      .def("__len__", [](const Features<256>& f) { return f.size(); });

  py::class_<OrbExtractor>(m, "OrbExtractor", "Finds and describes key points. One for each thread.")
      .def(py::init<const OrbOptions&>(), py::arg("options") = OrbOptions{})
      .def_property_readonly("options", [](const OrbExtractor& e) { return e.options(); })
      .def(
          "extract",
          [](OrbExtractor& extractor, const Gray& image) {
            const GrayView view = image.view();
            auto features = std::make_shared<Features<256>>();
            py::gil_scoped_release release;
            extractor.extract(view, *features);
            return features;
          },
          py::arg("image"), "Features of an image.");

  m.def(
      "hamming_distance",
      [](const ArrayOf<std::uint8_t, 32>& a, const ArrayOf<std::uint8_t, 32>& b) {
        OrbDescriptor left, right;
        std::copy_n(a.data(), 32, reinterpret_cast<std::uint8_t*>(left.words.data()));
        std::copy_n(b.data(), 32, reinterpret_cast<std::uint8_t*>(right.words.data()));
        return hamming_distance(left, right);
      },
      py::arg("a"), py::arg("b"), "Number of bits that differ.");

  register_lines(m);
}

}  // namespace sweepkit::python
