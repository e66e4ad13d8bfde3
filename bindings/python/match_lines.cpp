// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/stl.h>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/match/lines.hpp"

namespace sweepkit::python {

namespace {

using SegmentArray = ArrayOf<float, -1, 4>;
using DescriptorArray = ArrayOf<std::uint8_t, -1, 32>;
using MatchArray = py::array_t<LineStereoMatch, py::array::c_style>;

template <class T>
py::array_t<T> array_of(const std::vector<T>& values) {
  return py::array_t<T>(static_cast<py::ssize_t>(values.size()), values.data());
}

std::vector<Segment2d> segments_of(const SegmentArray& rows) {
  std::vector<Segment2d> segments(rows.size());
  for (std::size_t i = 0; i < segments.size(); ++i) {
    const float* row = rows.data() + 4 * i;
    segments[i] = {row[0], row[1], row[2], row[3]};
  }
  return segments;
}

std::vector<LineDescriptor> codes_of(const DescriptorArray& rows) {
  std::vector<LineDescriptor> codes(rows.size());
  std::copy_n(reinterpret_cast<const char*>(rows.data()), 32 * rows.size(),
              reinterpret_cast<char*>(codes.data()));
  return codes;
}

py::tuple triangulate(const LineStereoMatcher& matcher, const py::object& matches) {
  const py::array given = py::array::ensure(matches);
  if (!given || given.ndim() != 1 || !given.dtype().equal(py::dtype::of<LineStereoMatch>()))
    throw py::value_error("expected matches of line_stereo_match_dtype of shape (n,), got " +
                          (given ? describe(given) : "something else"));
  const MatchArray array = MatchArray::ensure(given);
  const py::ssize_t n = array.size();
  py::array_t<bool> valid(n);
  py::array_t<double> points({n, py::ssize_t{2}, py::ssize_t{3}});
  py::array_t<double> covariances({n, py::ssize_t{2}, py::ssize_t{3}, py::ssize_t{3}});
  std::fill_n(points.mutable_data(), points.size(), 0.0);
  std::fill_n(covariances.mutable_data(), covariances.size(), 0.0);
  for (py::ssize_t i = 0; i < n; ++i) {
    const auto segment = matcher.triangulate(array.data()[i]);
    valid.mutable_data()[i] = segment.has_value();
    if (!segment) continue;
    std::copy_n(segment->p1.data(), 3, points.mutable_data(i, 0, 0));
    std::copy_n(segment->p2.data(), 3, points.mutable_data(i, 1, 0));
    std::copy_n(segment->covariance1.data(), 9, covariances.mutable_data(i, 0, 0, 0));  // symmetric
    std::copy_n(segment->covariance2.data(), 9, covariances.mutable_data(i, 1, 0, 0));
  }
  return py::make_tuple(valid, points, covariances);
}

}  // namespace

void register_match_lines(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(Segment2d, u1, v1, u2, v2);
  PYBIND11_NUMPY_DTYPE(LineStereoMatch, right, distance, left, disparity1, disparity2, sigma1, sigma2,
                       rectified);
  m.attr("line_stereo_match_dtype") = py::dtype::of<LineStereoMatch>();

  bind_options<LineStereoOptions>(m, "LineStereoOptions", "Which line segments are paired left and right.");
  py::class_<LineStereoMatcher>(m, "LineStereoMatcher",
                                "Stereo matching of line segments by their ends. One for each thread.")
      .def(py::init<const StereoRig&, const LineStereoOptions&>(), py::arg("rig"),
           py::arg("options") = LineStereoOptions{})
      .def_property_readonly("rig", [](const LineStereoMatcher& s) { return s.rig(); })
      .def_property_readonly("options", [](const LineStereoMatcher& s) { return s.options(); })
      .def(
          "match",
          [](LineStereoMatcher& matcher, const LineFeatures<256>& left, const LineFeatures<256>& right) {
            std::vector<LineStereoMatch> matches;
            {
              py::gil_scoped_release release;
              matcher.match(left, right, matches);
            }
            return array_of(matches);
          },
          py::arg("left"), py::arg("right"),
          "One for each left segment: an array of line_stereo_match_dtype, right -1 where there is none.")
      .def("triangulate", &triangulate, py::arg("matches"),
           "Of what match gave: whether there is a segment in space, its two ends, (n, 2, 3) in the "
           "rectified left "
           "camera [m], and their covariances, (n, 2, 3, 3) [m^2]; zeros where there is none.");

  bind_options<LineProjectionOptions>(m, "LineProjectionOptions", "Matching of lines near predicted ones.");
  py::class_<LineProjectionMatcher>(
      m, "LineProjectionMatcher",
      "Finds predicted lines among the segments of an image. One for each thread.")
      .def(py::init<const LineProjectionOptions&>(), py::arg("options") = LineProjectionOptions{})
      .def_property_readonly("options", [](const LineProjectionMatcher& s) { return s.options(); })
      .def(
          "match",
          [](LineProjectionMatcher& matcher, const SegmentArray& predicted, const DescriptorArray& wanted,
             const SegmentArray& segments, const DescriptorArray& descriptors, float radius) {
            std::vector<LineQuery> queries;
            for (const Segment2d& s : segments_of(predicted)) queries.push_back({s, radius});
            const auto query_codes = codes_of(wanted), codes = codes_of(descriptors);
            const auto found_in = segments_of(segments);
            std::vector<Match> matches;
            {
              py::gil_scoped_release release;
              const std::vector<std::int32_t> octaves(found_in.size(), 0);
              matcher.match(queries, query_codes, found_in, octaves, codes, matches);
            }
            return array_of(matches);
          },
          py::arg("predicted"), py::arg("predicted_descriptors"), py::arg("segments"), py::arg("descriptors"),
          py::arg("radius") = 20.0f,
          "For each predicted line, (n, 4), the segment, (m, 4), nearest in descriptor that lies within "
          "radius "
          "[px] of it: an array of match_dtype, index -1 where there is none.");
}

}  // namespace sweepkit::python
