// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <pybind11/pybind11.h>

namespace sweepkit::python {

// One for each folder, in the file of its name; given the sub-module to fill.
void register_core(pybind11::module_& m);
void register_geometry(pybind11::module_& m);
void register_image(pybind11::module_& m);
void register_feature(pybind11::module_& m);
void register_motion(pybind11::module_& m);
void register_match(pybind11::module_& m);
void register_bow(pybind11::module_& m);
void register_direction(pybind11::module_& m);
void register_floor(pybind11::module_& m);
void register_map(pybind11::module_& m);
void register_solve(pybind11::module_& m);
void register_slam(pybind11::module_& m);
void register_slam_place(pybind11::module_& m);
void register_data(pybind11::module_& m);
void register_simulation_world(pybind11::module_& m);
void register_simulation_drive(pybind11::module_& m);
void register_system(pybind11::module_& m);

// Of map.cpp: what belongs to other folders, in data and slam.
void register_atlas_files(pybind11::module_& m);
void register_map_culling(pybind11::module_& m);

}  // namespace sweepkit::python
