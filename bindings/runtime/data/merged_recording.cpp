// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "merged_recording.hpp"

#include <algorithm>
#include <limits>

#include "sweepkit/data/euroc.hpp"
#include "sweepkit/data/kitti.hpp"

namespace sweepkit {

MergedRecording::MergedRecording(RecordingInfo info, Rig rig, Streams streams,
                                 const RecordingOptions& options)
    : info_(std::move(info)),
      rig_(std::move(rig)),
      streams_(std::move(streams)),
      end_(std::numeric_limits<TimeNs>::max()) {
  check_options(options);
  auto& frames = streams_.frames;
  if (streams_.imu) imu_ = streams_.imu();
  if (streams_.wheels) wheel_ = streams_.wheels();

  TimeNs first = std::numeric_limits<TimeNs>::max();
  if (!frames.empty()) {
    first = frames.front().t;
  } else {
    if (imu_) first = imu_->t;
    if (wheel_) first = std::min(first, wheel_->t);
  }
  // From the very start everything is read, also what the other sensors gave before the first image.
  const TimeNs begin =
      options.start > 0 ? first + from_seconds(options.start) : std::numeric_limits<TimeNs>::min();
  if (options.duration > 0) end_ = first + from_seconds(options.start) + from_seconds(options.duration);

  const std::size_t listed = frames.size();
  std::erase_if(frames, [&](const ListedFrame& frame) { return frame.t < begin || frame.t > end_; });
  while (imu_ && imu_->t < begin) imu_ = streams_.imu();
  while (wheel_ && wheel_->t < begin) wheel_ = streams_.wheels();
  if (frames.empty() && (listed > 0 || (!imu_ && !wheel_)))
    throw Error(ErrorKind::option, "start",
                "nothing of " + info_.path.string() + " lies in the selected span",
                number_text(options.start) + " s");

  info_.images = frames.size();
  info_.begin = frames.empty() ? (imu_ ? imu_->t : wheel_->t) : frames.front().t;
  info_.end = frames.empty() ? 0 : frames.back().t;
  for (const auto& frame : frames) {
    info_.left_missing += frame.left.file.empty();
    info_.right_missing += frame.right.file.empty();
  }
  const auto size = [](const std::optional<MountedCamera>& camera) {
    return camera ? ImageSize{camera->camera.width(), camera->camera.height()} : ImageSize{};
  };
  images_ =
      std::make_unique<ImageQueue>(std::move(frames), size(rig_.left), size(rig_.right), options.prefetch);
}

template <class T>
Sample MergedRecording::take(std::optional<T>& head, const std::function<std::optional<T>()>& stream) {
  const T sample = *head;
  try {
    head = stream();
  } catch (...) {
    // The sample in hand is good; the damage behind it is told at the next call.
    failure_ = std::current_exception();
  }
  return sample;
}

std::optional<Sample> MergedRecording::next() {
  if (failure_) std::rethrow_exception(failure_);
  constexpr TimeNs kNever = std::numeric_limits<TimeNs>::max();
  const TimeNs image = images_->next_stamp().value_or(kNever);
  const TimeNs imu = imu_ && imu_->t <= end_ ? imu_->t : kNever;
  const TimeNs wheel = wheel_ && wheel_->t <= end_ ? wheel_->t : kNever;
  if (imu != kNever && imu <= wheel && imu <= image) {
    return take(imu_, streams_.imu);
  }
  if (wheel != kNever && wheel <= image) {
    return take(wheel_, streams_.wheels);
  }
  if (image != kNever) return images_->pop();
  return std::nullopt;
}

std::unique_ptr<Recording> open_recording(const std::filesystem::path& folder,
                                          const RecordingOptions& options) {
  namespace fs = std::filesystem;
  if (!fs::exists(folder)) throw Error(ErrorKind::io, folder.string(), "there is no such folder");
  for (const char* name : {"mav0", "cam0", "cam1", "imu0", "odom0"})
    if (fs::is_directory(folder / name)) return open_euroc(folder, options);
  for (const char* name : {"image_0", "image_1", "calib.txt"})
    if (fs::exists(folder / name)) return open_kitti(folder, options);
  throw Error(ErrorKind::io, folder.string(),
              "is no recording: neither mav0 or cam0 (EuRoC ASL) nor image_0 (KITTI) lies in it");
}

}  // namespace sweepkit
