// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "sweepkit/map/atlas.hpp"

namespace sweepkit {

/// Writes an atlas, `atlas.swk`: the old file or the new one stands there at any time, never a part, also
/// when the disk is full or the power goes. Any state of a map can be written, also none. Points are numbered
/// anew from 0 in their old order; keyframes keep their ids. Needs 256 KB of memory, whatever the size of the
/// map. Throws Error(io) that says why it cannot be written; the old file then is as it was.
void write_atlas(const std::string& path, const AtlasInfo& info, const Map& map);
void write_atlas(const std::string& path, const Atlas& atlas);

/// Reads an atlas. Everything is checked: what comes back is what was written, or Error(io) or Error(data) is
/// thrown that names file, section, byte and value. Takes no more memory than about three times the file.
Atlas read_atlas(const std::string& path);

/// The same from and to memory.
/// @param place stands for the path in messages
std::vector<std::byte> encode_atlas(const AtlasInfo& info, const Map& map);
Atlas decode_atlas(std::span<const std::byte> bytes, const std::string& place = "atlas");

/// Throws Error(data) that names the first difference if the atlas was made with another rig.
/// @param place the atlas' file, for the message
void check_same_rig(const AtlasInfo& info, const StereoRig& rig, const std::string& place = "atlas");

}  // namespace sweepkit
