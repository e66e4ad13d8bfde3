// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <memory>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
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
}

}  // namespace sweepkit::python
