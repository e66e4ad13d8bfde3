// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "sweepkit/data/recording.hpp"

namespace sweepkit {

/// Opens a recording in the ASL layout of EuRoC (Burri et al., The EuRoC micro aerial vehicle datasets, IJRR
/// 2016): `cam0`, `cam1`, `imu0`, each with `sensor.yaml` and `data.csv`, and ours, `odom0`. `folder` holds
/// them or a `mav0` with them. Any of them may be absent. `odom0/data.csv` may instead be a log of speeds
/// (see read_wheel_log). Image names in `data.csv` are taken relative to `data/`; absolute ones as they are.
/// Where the IMU's T_BS is not the identity, all mountings are carried over into the IMU's frame.
/// @throws Error(io, data, calibration) naming file, line and value; Error(option) if nothing lies in the
/// selection
std::unique_ptr<Recording> open_euroc(const std::filesystem::path& folder,
                                      const RecordingOptions& options = {});

/// Reads a log of wheel speeds: comma-separated with a header line, whose first column is `t_s` [s] and which
/// has either columns with "left" and "right" in their names [m/s], or a forward speed (`v`, `v_mps`,
/// `v_forward_mps`) [m/s] and a turn rate (a name with "omega" or "yaw_rate") [rad/s].
/// @param track_width carries v and omega as wheel speeds [m]; any value serves if the same is used to undo
/// it
std::vector<WheelSample> read_wheel_log(const std::filesystem::path& file, double track_width = 1.0);

}  // namespace sweepkit
