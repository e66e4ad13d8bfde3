// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/run.hpp"

#include <algorithm>
#include <chrono>
#include <exception>
#include <filesystem>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include "sweepkit/core/option_text.hpp"
#include "sweepkit/data/atlas_file.hpp"
#include "sweepkit/system/frame_picture.hpp"
#include "sweepkit/system/results.hpp"

namespace sweepkit {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

// Events go to the file and to who watches.
class EventTee : public EventSink {
 public:
  EventTee(ResultWriter& writer, const RunHooks& hooks) : writer_(writer), hooks_(hooks) {}
  void on_event(const Event& event) override {
    writer_.on_event(event);
    if (hooks_.event) hooks_.event(event);
  }

 private:
  ResultWriter& writer_;
  const RunHooks& hooks_;
};

// Pictures of some frames. What cannot be written is kept for the thread that reads.
class PictureWriter : public FrameSink {
 public:
  PictureWriter(const StereoRig& rig, std::filesystem::path folder, double every)
      : rig_(rig), folder_(std::move(folder)), every_(from_seconds(every)) {
    std::filesystem::create_directories(folder_);
  }

  void on_frame(const StereoImage& image, const StereoFrame& frame, const TrackedImage& tracked) override {
    if (frame.t != image.t || (next_ && tracked.t < *next_)) return;
    next_ = tracked.t + every_;
    try {
      write_frame_picture(folder_ / (std::to_string(tracked.t) + ".png"), rig_, image.left.view, frame);
    } catch (...) {
      const std::scoped_lock lock(mutex_);
      error_ = std::current_exception();
    }
  }

  void rethrow() {
    const std::scoped_lock lock(mutex_);
    if (error_) std::rethrow_exception(error_);
  }

 private:
  const StereoRig rig_;
  const std::filesystem::path folder_;
  const TimeNs every_;
  std::optional<TimeNs> next_;
  std::mutex mutex_;
  std::exception_ptr error_;
};

class Run {
 public:
  Run(const RunOptions& options, const RunHooks& hooks)
      : options_(options),
        hooks_(hooks),
        recording_(open_recording(options.data_path, options.recording)),
        writer_(options.save_path),
        events_(writer_, hooks) {}

  RunResult operator()() {
    for (const std::string& sensor : recording_->info().missing_sensors)
      events_.on_event(Event(recording_->info().begin, "sensor_missing").with("sensor", sensor));
    const StereoRig rig = recording_->rig().stereo();
    if (options_.pictures.every > 0)
      pictures_.emplace(rig, writer_.folder() / "pictures", options_.pictures.every);
    Sweeper sweeper(recording_->rig(), options_.sweeper, &events_, pictures_ ? &*pictures_ : nullptr);
    const bool resumed =
        !options_.atlas.empty() && (options_.localize || std::filesystem::exists(options_.atlas));
    if (resumed) sweeper.resume(read_atlas(options_.atlas), options_.atlas);
    RunResult result;
    std::string ended = "end of recording";
    std::exception_ptr damage;
    try {
      if (!play(sweeper)) {
        result.stopped = true;
        ended = "interrupted";
      }
    } catch (const Error& error) {
      damage = std::current_exception();
      ended = error.what();
    }
    sweeper.finish();
    write_new_images(sweeper);
    result.seconds = seconds_since(begin_);
    RunOptions used = options_;
    writer_.finish(sweeper, {options_to_json(list_options(used)), recording_->info(),
                             clock_.times(Stage::read), result.seconds, ended});
    if (!options_.localize) {
      sweeper.save_atlas((writer_.folder() / "atlas.swk").string());
      if (!options_.atlas.empty()) sweeper.save_atlas(options_.atlas);
    }
    if (damage) std::rethrow_exception(damage);
    result.counts = sweeper.counts();
    result.initialised = result.counts.keyframes_made > 0;
    result.keyframes = static_cast<std::int64_t>(sweeper.map().keyframe_count());
    result.points = static_cast<std::int64_t>(sweeper.map().point_count());
    result.path_m = path_length(optimized_trajectory(sweeper));
    result.frame = sweeper.stage_clock().times(Stage::frame);
    return result;
  }

 private:
  // False if it was stopped.
  bool play(Sweeper& sweeper) {
    RunProgress progress{.total = static_cast<std::int64_t>(recording_->info().images)};
    for (;;) {
      if (stop()) return false;
      const auto begin = Clock::now();
      std::optional<Sample> sample = recording_->next();
      if (!sample) return true;
      const bool image = std::holds_alternative<StereoImage>(*sample);
      if (image)
        clock_.add(Stage::read, std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
      if (options_.sweeper.realtime && !wait_for(stamp(*sample))) return false;
      std::visit([&](auto&& s) { sweeper.feed(std::forward<decltype(s)>(s)); }, std::move(*sample));
      if (!image) continue;
      write_new_images(sweeper);
      ++progress.images;
      progress.lost = lost_;
      if (hooks_.progress) hooks_.progress(progress);
    }
  }

  bool stop() const { return hooks_.stop && hooks_.stop(); }

  // Sleeps until the clock shows the stamp, the first sample's being the begin. False if it was stopped.
  bool wait_for(TimeNs t) {
    if (!first_) first_ = {t, Clock::now()};
    const auto due = first_->second + std::chrono::nanoseconds(t - first_->first);
    while (Clock::now() < due) {
      if (stop()) return false;
      std::this_thread::sleep_until(std::min(due, Clock::now() + std::chrono::milliseconds(50)));
    }
    return true;
  }

  void write_new_images(const Sweeper& sweeper) {
    const std::vector<TrackedImage> images = sweeper.images(written_);
    writer_.write(images);
    if (pictures_) pictures_->rethrow();
    written_ += images.size();
    if (!images.empty()) lost_ = images.back().basis != PoseBasis::vision;
  }

  const RunOptions options_;
  const RunHooks& hooks_;
  const Clock::time_point begin_ = Clock::now();
  std::unique_ptr<Recording> recording_;
  ResultWriter writer_;
  EventTee events_;
  std::optional<PictureWriter> pictures_;
  StageClock clock_;
  std::optional<std::pair<TimeNs, Clock::time_point>> first_;
  std::size_t written_ = 0;
  bool lost_ = false;
};

}  // namespace

RunResult run_recording(const RunOptions& options, const RunHooks& hooks) {
  check_options(options);
  if (options.data_path.empty()) throw Error(ErrorKind::option, "data_path", "must be given");
  if (options.save_path.empty()) throw Error(ErrorKind::option, "save_path", "must be given");
  if (options.localize && options.atlas.empty())
    throw Error(ErrorKind::option, "atlas", "must be given to localize in it");
  return Run(options, hooks)();
}

}  // namespace sweepkit
