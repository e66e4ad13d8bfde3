// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/stage_clock.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/floor/obstacle_detector.hpp"
#include "sweepkit/slam/odometry_bridge.hpp"
#include "sweepkit/system/obstacle_stage.hpp"

namespace sweepkit {

/// Obstacles in a recording.
struct ObstacleRunOptions {
  std::string data_path;
  std::string save_path;
  int only_obs_det = 1;
  double every = 1.0;
  RecordingOptions recording;
  FloorMountingOptions floor;
  ObstacleDetectorOptions detector;
  OdometryBridgeOptions odometry;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(data_path, "data_path", "", any_value(), "folder of the recording: EuRoC ASL or KITTI odometry");
    v(save_path, "save_path", "", any_value(), "folder for the results; made if needed");
    v(only_obs_det, "only_obs_det", "", range(0, 1), "1: obstacles alone; 0 would also name objects");
    v(every, "every", "s", range(0.0, 1e6), "mask, cloud and picture of an image so often; 0: of each");
    v.group(recording, "recording", "what to read of the recording");
    v.group(floor, "floor", "where the floor is, for a rig without wheels");
    detector.visit_options(v);
    v.group(odometry, "odometry", "wheels and IMU, which tell how the camera moves");
  }
};

/// Who watches; each may be left empty.
struct ObstacleHooks {
  std::function<bool()> stop;                                             ///< asked often; true ends the run
  std::function<void(std::int64_t images, std::int64_t total)> progress;  ///< after each image
  std::function<void(const ObstacleFrame&)> frame;                        ///< each image as it is done
};

struct ObstacleRunResult {
  std::int64_t frames = 0;          ///< pairs that were looked at
  std::int64_t frames_missing = 0;  ///< images of one camera alone
  std::int64_t planes_measured = 0;
  std::int64_t obstacles = 0;  ///< over all frames
  std::int64_t holes = 0;
  std::int64_t confirmed = 0;  ///< different ones, ever confirmed
  bool stopped = false;        ///< by the hook
  StageTimes times;            ///< of a pair, all steps
};

/// Looks for obstacles in all stereo images of a recording. With a save_path writes `obstacles.jsonl` (a line
/// for each pair), `masks/<stamp>.png`, `clouds/<stamp>.ply`, `pictures/<stamp>.png` and `summary.json`; the
/// page of this folder tells what is in them. Poses come from wheels and IMU; without them nothing is
/// tracked.
/// @throws Error(option) for an option out of range, without data_path or with only_obs_det 0;
///   Error(calibration) where nothing tells where the floor is; Error(io, data, calibration) where the
///   recording is damaged, after what came before was written
ObstacleRunResult detect_obstacles(const ObstacleRunOptions& options, const ObstacleHooks& hooks = {});

}  // namespace sweepkit
