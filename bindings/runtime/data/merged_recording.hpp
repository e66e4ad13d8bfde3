// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <exception>
#include <functional>
#include <memory>

#include "image_queue.hpp"
#include "sweepkit/data/recording.hpp"

namespace sweepkit {

/// A recording made of three streams: two that are read as they are asked for, and a list of images.
class MergedRecording : public Recording {
 public:
  struct Streams {
    std::function<std::optional<ImuSample>()> imu;       ///< empty if there is none
    std::function<std::optional<WheelSample>()> wheels;  ///< empty if there is none
    std::vector<ListedFrame> frames;
  };

  /// Applies the selection of the options and reads the first sample of each stream.
  MergedRecording(RecordingInfo info, Rig rig, Streams streams, const RecordingOptions& options);

  const Rig& rig() const override { return rig_; }
  const RecordingInfo& info() const override { return info_; }
  std::optional<Sample> next() override;

 private:
  template <class T>
  Sample take(std::optional<T>& head, const std::function<std::optional<T>()>& stream);

  RecordingInfo info_;
  Rig rig_;
  Streams streams_;
  TimeNs end_;
  std::optional<ImuSample> imu_;
  std::optional<WheelSample> wheel_;
  std::unique_ptr<ImageQueue> images_;
  std::exception_ptr failure_;
};

}  // namespace sweepkit
