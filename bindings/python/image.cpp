// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "arrays.hpp"
#include "register.hpp"
#include "sweepkit/image/pyramid.hpp"

namespace sweepkit::python {

namespace {

// Levels are asked for by any number; C++ leaves the check to the caller.
int checked_level(const ImagePyramid& pyramid, int l) {
  require(l >= 0 && l < pyramid.levels(), "ImagePyramid level", "there is no such level", l);
  return l;
}

}  // namespace

void register_image(py::module_& m) {
  py::class_<ImagePyramid>(m, "ImagePyramid",
                           "An image in several sizes, each a bilinear resize of the last.")
      .def(py::init([](const Gray& image, int levels, double factor) {
             const GrayView view = image.view();
             py::gil_scoped_release release;
             ImagePyramid pyramid;
             pyramid.build(view, levels, factor);
             return pyramid;
           }),
           py::arg("image"), py::arg("levels") = 8, py::arg("factor") = 1.2)
      .def_property_readonly("levels", &ImagePyramid::levels, "Number of levels.")
      .def_property_readonly("factor", &ImagePyramid::factor, "Size of a level against the next.")
      .def(
          "level",
          [](const py::object& self, int l) -> py::array_t<std::uint8_t> {
            const auto& pyramid = self.cast<const ImagePyramid&>();
            return image_view(pyramid.level(checked_level(pyramid, l)), self);
          },
          py::arg("l"), "The image of a level, where it lies; cannot be written to.")
      .def(
          "scale", [](const ImagePyramid& p, int l) { return p.scale(checked_level(p, l)); }, py::arg("l"),
          "Nominal size of a pixel of a level in pixels of level 0.")
      .def("__len__", &ImagePyramid::levels);
}

}  // namespace sweepkit::python
