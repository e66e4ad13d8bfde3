// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/image/dense_disparity.hpp"
#include "sweepkit/image/pyramid.hpp"

namespace sweepkit::python {

namespace {

// Levels are asked for by any number; C++ leaves the check to the caller.
int checked_level(const ImagePyramid& pyramid, int l) {
  require(l >= 0 && l < pyramid.levels(), "ImagePyramid level", "there is no such level", l);
  return l;
}

py::array disparity_view(const DisparityView& view, const py::handle& owner) {
  const auto step = static_cast<py::ssize_t>(sizeof(std::int16_t));
  return view_of(view.data, {view.height, view.width}, {view.stride * step, step}, owner);
}

// The same for all that matches a pair.
template <class Matcher>
py::array match_pair(const py::object& self, const Gray& left, const Gray& right, const DisparityRamp& ramp) {
  auto& matcher = self.cast<Matcher&>();
  const GrayView l = left.view(), r = right.view();
  DisparityView found;
  {
    py::gil_scoped_release release;
    found = matcher.match(l, r, ramp);
  }
  return disparity_view(found, self);
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

  py::class_<StereoRectifier>(m, "StereoRectifier", "Rectifies whole images, for dense matching.")
      .def(py::init<const StereoRig&>(), py::arg("rig"))
      .def_property_readonly("camera", &StereoRectifier::camera, "Of the rectified left image.")
      .def(
          "rectify",
          [](StereoRectifier& rectifier, const Gray& left, const Gray& right) {
            const GrayView l = left.view(), r = right.view();
            py::gil_scoped_release release;
            rectifier.rectify(l, r);
          },
          py::arg("left"), py::arg("right"), "Takes a raw pair.")
      .def(
          "image",
          [](const py::object& self, Side side) {
            return image_view(self.cast<const StereoRectifier&>().image(side), self);
          },
          py::arg("side"), "The rectified image of the last pair, where it lies.")
      .def(
          "seen",
          [](const py::object& self, Side side) {
            return image_view(self.cast<const StereoRectifier&>().seen(side), self);
          },
          py::arg("side"), "255 where the raw image fills the rectified one, else 0.");

  bind_options<DisparitySmoothing>(m, "DisparitySmoothing", "Weighted least squares after matching.");
  bind_options<DisparityOptions>(m, "DisparityOptions", "Dense stereo matching.");
  py::class_<DisparityRamp>(m, "DisparityRamp", "A disparity to expect, linear in the row: that of a floor.")
      .def(py::init([](double at_top, double per_row) {
             return DisparityRamp{at_top, per_row};
           }),
           py::arg("at_top") = 0.0, py::arg("per_row") = 0.0)
      .def_readwrite("at_top", &DisparityRamp::at_top, "In row 0 [px].")
      .def_readwrite("per_row", &DisparityRamp::per_row, "[px]");
  constexpr const char* kMatch =
      "Disparities of the rectified left image in sixteenths of a pixel, int16 (height, width), 0 where "
      "unknown; on the matcher's memory, which the next call writes over.";
  py::class_<DenseMatcher>(m, "DenseMatcher", "Dense disparities of a rectified pair.")
      .def(py::init<const DisparityOptions&>(), py::arg("options") = DisparityOptions{})
      .def_property_readonly("options", &DenseMatcher::options)
      .def("match", &match_pair<DenseMatcher>, py::arg("left"), py::arg("right"),
           py::arg("ramp") = DisparityRamp{}, kMatch);
  py::class_<StereoDisparity>(m, "StereoDisparity", "Dense disparities of a raw pair.")
      .def(py::init<const StereoRig&, const DisparityOptions&>(), py::arg("rig"),
           py::arg("options") = DisparityOptions{})
      .def_property_readonly("camera", &StereoDisparity::camera, "Of the rectified left image.")
      .def_property_readonly("rectifier", &StereoDisparity::rectifier)
      .def_property_readonly("options", &StereoDisparity::options)
      .def("match", &match_pair<StereoDisparity>, py::arg("left"), py::arg("right"),
           py::arg("ramp") = DisparityRamp{}, kMatch);
}

}  // namespace sweepkit::python
