// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/stl.h>

#include <memory>
#include <optional>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/match/brute_force.hpp"
#include "sweepkit/match/projection.hpp"
#include "sweepkit/match/stereo.hpp"

namespace sweepkit::python {

void register_match_codes(py::module_& m);  // match_codes.cpp
void register_match_lines(py::module_& m);  // match_lines.cpp

namespace {

template <class T>
py::array_t<T> array_of(const std::vector<T>& values) {
  return py::array_t<T>(static_cast<py::ssize_t>(values.size()), values.data());
}

}  // namespace

void register_match(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(Match, index, distance);
  PYBIND11_NUMPY_DTYPE(StereoMatch, right, u_left, v_left, u_right, disparity, sigma, distance, rectified);
  m.attr("match_dtype") = py::dtype::of<Match>();
  m.attr("stereo_match_dtype") = py::dtype::of<StereoMatch>();

  bind_options<BruteForceOptions>(m, "BruteForceOptions", "Nearest neighbours among all features.");
  m.def(
      "match_brute_force",
      [](const Features<256>& a, const Features<256>& b, const BruteForceOptions& options) {
        std::vector<Match> matches;
        {
          py::gil_scoped_release release;
          matches = match_brute_force(a, b, options);
        }
        return array_of(matches);
      },
      py::arg("a"), py::arg("b"), py::arg("options") = BruteForceOptions{},
      "For each of a the nearest in b: an array of match_dtype, index -1 where there is none.");

  register_match_codes(m);

  bind_options<ProjectionOptions>(m, "ProjectionOptions", "Matching near predicted places.");
  bind_options<StereoSearchOptions>(m, "StereoSearchOptions", "Which key points are paired.");
  bind_options<PatchRefinement::Options>(m, "PatchRefinementOptions", "Disparity to a part of a pixel.");
  bind_options<MedianFilter::Options>(m, "MedianFilterOptions", "Removal of outliers.");
  bind_options<StereoOptions>(m, "StereoOptions", "Stereo matching.");
  py::class_<StereoMatcher>(m, "StereoMatcher", "The accelerated sparse stereo matcher. One for each thread.")
      .def(py::init<const StereoRig&, const StereoOptions&>(), py::arg("rig"),
           py::arg("options") = StereoOptions{})
      .def_property_readonly("rig", [](const StereoMatcher& s) { return s.rig(); })
      .def_property_readonly("options", [](const StereoMatcher& s) { return s.options(); })
      .def(
          "match",
          [](StereoMatcher& matcher, const Features<256>& left, const ImagePyramid& left_pyramid,
             const Features<256>& right, const ImagePyramid& right_pyramid,
             const std::optional<ArrayOf<float, -1>>& prior) {
            std::vector<StereoMatch> matches;
            const std::span<const float> expected =
                prior ? std::span(prior->data(), prior->size()) : std::span<const float>();
            {
              py::gil_scoped_release release;
              matcher.match(left, left_pyramid, right, right_pyramid, expected, matches);
            }
            return array_of(matches);
          },
          py::arg("left"), py::arg("left_pyramid"), py::arg("right"), py::arg("right_pyramid"),
          py::arg("prior") = py::none(),
          "One for each left key point: an array of stereo_match_dtype, right -1 where there is none. prior: "
          "expected disparities [px].");

  register_match_lines(m);
}

}  // namespace sweepkit::python
