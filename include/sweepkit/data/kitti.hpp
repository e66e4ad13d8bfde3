// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "sweepkit/data/recording.hpp"

namespace sweepkit {

/// Opens a sequence of the KITTI odometry benchmark (Geiger et al., CVPR 2012): `image_0` and `image_1` with
/// files named by frame number, `calib.txt` with P0 and P1, `times.txt`. The body frame is the left camera's.
/// Stamps are those of times.txt, from zero. A frame with one image is delivered with the other absent.
/// @throws Error(io, data, calibration) naming file, line and value; Error(option) if nothing lies in the
/// selection
std::unique_ptr<Recording> open_kitti(const std::filesystem::path& folder,
                                      const RecordingOptions& options = {});

}  // namespace sweepkit
