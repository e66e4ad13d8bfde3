// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <string>

#include "register.hpp"

PYBIND11_MODULE(_core, m) {
  namespace python = sweepkit::python;
  m.doc() =
      "The compiled part of sweepkit. Import its sub-modules from the package itself: sweepkit.geometry.";
  pybind11::list folders;
  const auto add = [&](const char* folder, void (*fill)(pybind11::module_&), const char* doc) {
    pybind11::module_ sub = m.def_submodule(folder, doc);
    // Types say that they live in the public module, where pickle and readers look for them.
    sub.attr("__name__") = std::string("sweepkit.") + folder;
    fill(sub);
    folders.append(folder);
  };
  add("core", python::register_core, "Errors, versions, random numbers.");
  add("geometry", python::register_geometry, "Rotations, motions, cameras, stereo rig, triangulation, PnP.");
  add("image", python::register_image, "Images in several sizes, rectification, dense disparity.");
  add("feature", python::register_feature, "Key points with binary descriptors.");
  add("motion", python::register_motion, "Wheels and IMU: integration, bias, standstill, calibration, slip.");
  add("match", python::register_match, "Stereo matching and matching by descriptor.");
  add("bow", python::register_bow, "Vocabularies, bags of words, images by their words.");
  add("direction", python::register_direction,
      "Vanishing points, Manhattan frames, the main direction of a room.");
  add("floor", python::register_floor, "What lies on the floor: mask and cloud by the floor's disparity.");
  add("map", python::register_map, "Keyframes, points and who saw what; atlases.");
  add("solve", python::register_solve, "Pose graphs; options of the solvers.");
  add("slam", python::register_slam, "Options of tracking and mapping.");
  add("data", python::register_data, "Recordings, trajectories and their evaluation.");
  add("system", python::register_system, "The whole system, on a recording or fed live.");
  m.attr("folders") = pybind11::tuple(folders);
}
