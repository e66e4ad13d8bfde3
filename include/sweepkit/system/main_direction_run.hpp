// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/direction/level_odometry.hpp"
#include "sweepkit/direction/main_direction.hpp"
#include "sweepkit/feature/segments.hpp"

namespace sweepkit {

/// Finding a room's main direction in a recording.
struct MainDirectionRunOptions {
  std::string data_path;
  std::string save_path;
  int detections = 1;
  RecordingOptions recording;
  MainDirectionOptions direction;
  SegmentOptions segments;
  LevelOdometryOptions odometry;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(data_path, "data_path", "", any_value(), "folder of the recording: EuRoC ASL or KITTI odometry");
    v(save_path, "save_path", "", any_value(), "folder for the results; made if needed");
    v(detections, "detections", "", range(0, 1000000), "stop after so many accepted windows; 0: at the end");
    v.group(recording, "recording", "what to read of the recording");
    v.group(direction, "direction", "the main direction");
    v.group(segments, "segments", "line segments in the images");
    v.group(odometry, "odometry", "orientation from IMU and wheels");
  }
};

/// Who watches; each may be left empty.
struct MainDirectionHooks {
  std::function<bool()> stop;                                             ///< asked often; true ends the run
  std::function<void(std::int64_t images, std::int64_t total)> progress;  ///< after each image
};

struct MainDirectionRunResult {
  std::vector<MainDirection> detections;
  std::vector<FrameDirection> frames;  ///< of every stereo image that was read
  int restarts = 0;                    ///< windows thrown away
  double last_confidence = 0;          ///< of the last complete window
  bool stopped = false;                ///< by the hook
  double lines_ms = 0;                 ///< median time for the segments of both images
  double direction_ms = 0;             ///< median time for the rest
};

/// Reads a recording until the asked number of windows was accepted. With a save_path writes
/// `main_direction_result.txt`, `summary.json` and, for each accepted window, `main_direction_<stamp>.png`:
/// the left image of its first frame, segments coloured by direction. An image of one camera alone counts as
/// a frame without a direction.
/// @throws Error(option) for an option out of range or without data_path; Error(io, data, calibration) where
/// the
///   recording is damaged, after what came before was written
MainDirectionRunResult find_main_direction(const MainDirectionRunOptions& options,
                                           const MainDirectionHooks& hooks = {});

}  // namespace sweepkit
