// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>

#include "sweepkit/data/scene.hpp"

namespace sweepkit {

// A scene file is one YAML document. Keys of the world: name, frame, flat (a generated flat, see
// FlatOptions), rooms, doors, windows, pictures, objects, lights, daylight, materials. Keys of the drive
// (robot, drive, events, sensors, ...) are left to their readers. Lengths in m, angles in degrees. Positions
// are in the frame of the file, which `frame: {yaw: 61, origin: [2.1, -3.4]}` places in the world.

/// Reads the world of a scene file and checks it. With `flat`, what stands under the other keys is added to
/// the generated flat.
/// @throws Error(io) if it cannot be read; Error(data) with file and line: unknown keys (and the nearest
/// known
///   one), missing or wrong values, what Scene::check refuses
Scene read_scene(const std::filesystem::path& file);

/// The same from text. @param name stands in errors where the file would
Scene parse_scene(const std::string& text, const std::string& name);

/// A scene as such a document, all in full: reading it gives the same scene to 1 nm and 1e-9 rad.
std::string scene_to_yaml(const Scene& scene);

/// Writes it to a file. @throws Error(io); no half file is left
void write_scene(const Scene& scene, const std::filesystem::path& file);

}  // namespace sweepkit
