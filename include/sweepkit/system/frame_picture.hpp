// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>

#include "sweepkit/core/view.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/slam/stereo_frame.hpp"

namespace sweepkit {

/// Writes a PNG of the raw left image with the frame's key points: green circles are tracked map points,
/// orange dots have a stereo match but no map point, grey dots neither.
/// @param left the image that the frame was made of
/// @throws Error(io) if the file cannot be written
void write_frame_picture(const std::filesystem::path& file, const StereoRig& rig, GrayView left,
                         const StereoFrame& frame);

}  // namespace sweepkit
