// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdio>
#include <filesystem>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "sweepkit/core/time.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// Where the body was at an instant.
struct StampedPose {
  TimeNs t = 0;
  SE3d T_world_body;
};

/// Poses in the order of their stamps.
using Trajectory = std::vector<StampedPose>;

/// One line of a TUM file, with its line end: `t x y z qx qy qz qw`, t in seconds with exactly 9 decimals,
/// the rest [m, -] with 9. The quaternion's w is not negative.
std::string tum_line(const StampedPose& pose);

/// Writes a TUM file line by line. What was written is in the file after each flush and when it is closed.
class TumWriter {
 public:
  /// @throws Error(io) if the file cannot be made
  explicit TumWriter(std::filesystem::path file);
  ~TumWriter();
  TumWriter(const TumWriter&) = delete;
  TumWriter& operator=(const TumWriter&) = delete;

  /// @throws Error(io) if it cannot be written (a full disk)
  void write(const StampedPose& pose);
  /// A line that begins with #.
  void comment(std::string_view text);
  void flush();

 private:
  void put(const std::string& text);

  std::filesystem::path file_;
  std::FILE* stream_;
};

/// Writes a whole TUM file. @throws Error(io)
void write_tum(const std::filesystem::path& file, std::span<const StampedPose> trajectory);

/// Reads a TUM file. @throws Error(io, data) naming file and line
Trajectory read_tum(const std::filesystem::path& file);

/// Reads a EuRoC `state_groundtruth_estimate0/data.csv` (t, p, q as w x y z; further columns are left alone).
/// @throws Error(io, data) naming file and line
Trajectory read_euroc_truth(const std::filesystem::path& file);

/// Reads KITTI poses, one 3x4 matrix by rows a line, with the stamps of a `times.txt`.
/// @throws Error(io, data) naming file and line; also if there are fewer stamps than poses
Trajectory read_kitti_poses(const std::filesystem::path& file, const std::filesystem::path& times);

/// Reads any of the three, told by the number of columns. A folder stands for the truth of the recording in
/// it.
/// @param times stamps of KITTI poses; empty: `times.txt` beside the poses
/// @throws Error(io, data) naming file and line
Trajectory read_trajectory(const std::filesystem::path& file, const std::filesystem::path& times = {});

/// The pose at an instant between two poses: along the constant twist from one to the other. Nothing before
/// the first and after the last, and where the two are more than `max_gap` apart.
std::optional<SE3d> interpolate(std::span<const StampedPose> trajectory, TimeNs t,
                                TimeNs max_gap = std::numeric_limits<TimeNs>::max());

/// Length of the path through the positions [m].
double path_length(std::span<const StampedPose> trajectory);

}  // namespace sweepkit
