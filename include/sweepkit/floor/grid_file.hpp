// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>

#include "sweepkit/floor/occupancy_grid.hpp"

namespace sweepkit {

/// Writes NAME.yaml and NAME.pgm as ROS's map_server reads them (mode trinary, negate 0, occupied_thresh
/// 0.65, free_thresh 0.196). A map without cells is written as one unknown cell, for map_server takes no
/// empty picture.
/// @throws Error(io) if a file cannot be written; Error(argument) for a cell size or origin that cannot be
void write_grid(const OccupancyImage& map, const std::filesystem::path& folder,
                const std::string& name = "grid");

/// Reads what map_server reads: YAML with image (PGM of either kind or PNG, 8 bit), resolution, origin
/// without rotation, negate, occupied_thresh, free_thresh; mode trinary or none. Each cell becomes kFree,
/// kOccupied or kUnknown by the thresholds: with p = (255 - grey) / 255 (negate: grey / 255), occupied if p >
/// occupied_thresh, free if p < free_thresh. Memory is taken only for what the length of the file can hold.
/// @throws Error(io) if a file cannot be read, Error(data) naming file and key for content that cannot be
OccupancyImage read_grid(const std::filesystem::path& yaml);

}  // namespace sweepkit
