// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <exception>
#include <filesystem>
#include <mutex>
#include <span>
#include <string>

#include "sweepkit/core/event.hpp"
#include "sweepkit/core/stage_clock.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/system/sweeper.hpp"

namespace sweepkit {

/// What is told of a run beside what the Sweeper knows itself.
struct RunRecord {
  std::string options_json;  ///< options_to_json of all options of the run
  RecordingInfo recording;
  StageTimes read;       ///< waiting for the next image to be read and decoded
  double seconds = 0.0;  ///< by the wall clock
  std::string ended;     ///< "end of recording", "interrupted" or the error
};

/// Writes the result files of a run into a folder: `trajectory_live.tum`, `trajectory_odom.tum` and
/// `events.jsonl` as it goes, so that a crash loses nothing; the others (`trajectory_optimized.tum`,
/// `keyframes.tum`, `map.ply`, `map.svg`, `summary.json`) at the end, each complete or not at all.
class ResultWriter : public EventSink {
 public:
  /// Makes the folder if needed and removes results of an earlier run from it. @throws Error(io)
  explicit ResultWriter(std::filesystem::path folder);

  /// Thread-safe. Does not throw: what cannot be written is an error of the next call of write or finish.
  void on_event(const Event& event) override;
  /// Appends images to both trajectories that grow. @throws Error(io)
  void write(std::span<const TrackedImage> images);
  /// Writes the other files. @param sweeper after its finish  @throws Error(io)
  void finish(const Sweeper& sweeper, const RunRecord& record);

  const std::filesystem::path& folder() const { return folder_; }

 private:
  void rethrow_event_error();

  std::filesystem::path folder_;
  EventLog events_;
  TumWriter live_, odom_;
  std::mutex mutex_;
  std::exception_ptr event_error_;
};

/// T_map_body at each image, after all corrections.
Trajectory optimized_trajectory(const Sweeper& sweeper);

/// The content of keyframes.tum: T_map_body of the keyframes that live, by maps; before each map a comment
/// with its number and its keyframes' count.
std::string keyframes_tum(const Map& map, const SE3d& T_body_camera);

/// The content of map.ply: a binary little-endian point cloud of p_world [m] with the number of keyframes
/// that observe each point.
std::string map_ply(const Map& map);

/// A drawing of points, path and keyframes from above: along the axis of the map that is nearest to the
/// cameras' upward direction.
std::string map_svg(const Map& map, const SE3d& T_body_camera, std::span<const StampedPose> path);

/// The content of summary.json.
std::string summary_json(const Sweeper& sweeper, const RunRecord& record);

}  // namespace sweepkit
