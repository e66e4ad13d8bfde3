// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/data/source.hpp"

namespace sweepkit {

/// Which stamps of the two cameras are one instant.
enum class Pairing {
  exact,    ///< equal ones
  nearest,  ///< the nearest within half a frame; the left one is kept
};

/// What to read of a recording.
struct RecordingOptions {
  double start = 0.0;
  double duration = 0.0;
  bool use_imu = true;
  bool use_wheels = true;
  Pairing pairing = Pairing::exact;
  int prefetch = 4;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(start, "start", "s", range(0, 1e9), "first instant to read, counted from the first image");
    v(duration, "duration", "s", range(0, 1e9), "length to read; 0: to the end");
    v(use_imu, "use_imu", "", any_value(), "read the IMU, if there is one");
    v(use_wheels, "use_wheels", "", any_value(), "read the wheels, if there are any");
    v.choice(pairing, "pairing", {{Pairing::exact, "exact"}, {Pairing::nearest, "nearest"}},
             "stamps of the two cameras that are one instant: equal, or the nearest within half a frame");
    v(prefetch, "prefetch", "", range(0, 1000), "image pairs decoded ahead in a thread; 0: no thread");
  }
};

/// What is known of a recording before it is read.
struct RecordingInfo {
  std::string format;          ///< "EuRoC ASL" or "KITTI odometry"
  std::filesystem::path path;  ///< folder of the sensors
  TimeNs begin = 0;  ///< stamp of the first image that is read [ns]; without images, of the first sample
  TimeNs end = 0;    ///< stamp of the last image that is read [ns]; without images 0
  std::size_t images = 0;        ///< instants with an image of at least one camera
  std::size_t left_missing = 0;  ///< of these, instants without the left image
  std::size_t right_missing = 0;
  std::vector<std::string> missing_sensors;  ///< of "cam0", "cam1", "imu0", "odom0": those that there are not
  std::filesystem::path truth;               ///< file of true poses; empty if there is none
};

/// A source that lies in files.
class Recording : public Source {
 public:
  virtual const RecordingInfo& info() const = 0;
};

/// Opens a recording of either kind, told by what the folder holds: `mav0` or `cam0` (EuRoC ASL), `image_0`
/// (KITTI).
/// @throws Error(io) if it is neither; else as open_euroc and open_kitti
std::unique_ptr<Recording> open_recording(const std::filesystem::path& folder,
                                          const RecordingOptions& options = {});

}  // namespace sweepkit
