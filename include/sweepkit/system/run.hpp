// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "sweepkit/core/event.hpp"
#include "sweepkit/core/options.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/system/sweeper.hpp"

namespace sweepkit {

/// Pictures of frames with their key points, as write_frame_picture draws them.
struct PictureOptions {
  double every = 0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(every, "every", "s", range(0, 1e6),
      "a picture of a frame with its key points so often, into pictures/ of the results; 0: none");
  }
};

/// The whole system on a recording.
struct RunOptions {
  std::string data_path;
  std::string save_path;
  std::string atlas;
  bool localize = false;
  RecordingOptions recording;
  PictureOptions pictures;
  SweeperOptions sweeper = [] {
    SweeperOptions all;
    all.history = 0;
    return all;
  }();

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(data_path, "data_path", "", any_value(), "folder of the recording: EuRoC ASL or KITTI odometry");
    v(save_path, "save_path", "", any_value(), "folder for the results; made if needed");
    v(atlas, "atlas", "", any_value(),
      "file with the maps of runs before: read if it is there, and written again at the end");
    v(localize, "localize", "", any_value(), "the atlas must be there and stays as it is");
    v.group(recording, "recording", "what to read of the recording");
    v.group(pictures, "pictures", "pictures of frames");
    sweeper.visit_options(v);
  }
};

/// How far a run is.
struct RunProgress {
  std::int64_t images = 0;  ///< read so far
  std::int64_t total = 0;   ///< in what is to be read of the recording
  bool lost = false;        ///< no pose from vision at the newest image
};

/// Who watches a run; each may be left empty.
struct RunHooks {
  std::function<bool()> stop;                        ///< asked often; true ends the run
  std::function<void(const RunProgress&)> progress;  ///< after each image
  std::function<void(const Event&)> event;           ///< from any thread; must not throw
};

/// How a run went.
struct RunResult {
  bool initialised = false;  ///< there was a map at some time
  bool stopped = false;      ///< by RunHooks::stop
  SweeperCounts counts;
  std::int64_t keyframes = 0;
  std::int64_t points = 0;
  double path_m = 0.0;   ///< of the optimised trajectory
  double seconds = 0.0;  ///< by the wall clock
  StageTimes frame;
};

/// Feeds a recording to a Sweeper and writes all results: with sweeper.realtime at the pace of its stamps,
/// else as fast as it goes.
/// @throws Error(option) for an option out of range, without the two paths or to localize without an atlas,
///   before anything is written; Error(io, data) for an atlas that cannot be read or is of another rig;
///   Error(io, data, calibration) where the recording is damaged, after what came before it was processed and
///   the results were written
RunResult run_recording(const RunOptions& options, const RunHooks& hooks = {});

}  // namespace sweepkit
