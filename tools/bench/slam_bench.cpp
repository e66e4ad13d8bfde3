// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// The frame path of the whole system on a recording, beside what cv::ORB alone takes for the same two images.
// Both figures are medians over the images of a run: a frame that becomes a keyframe costs more than the
// next.

#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>
#include <optional>
#include <string>
#include <vector>

#include "sweepkit/data/recording.hpp"
#include "sweepkit/system/sweeper.hpp"

namespace {

using namespace sweepkit;

struct Clip {
  std::optional<StereoRig> rig;
  std::vector<StereoImage> images;
};

// The drive from standstill through the first turn on the spot; empty without recordings.
const Clip& clip() {
  static const Clip loaded = [] {
    Clip clip;
    const char* data = std::getenv("SWEEPKIT_DATA");
    if (!data) return clip;
    RecordingOptions options;
    options.duration = 20;
    options.use_imu = options.use_wheels = false;
    const auto recording = open_recording(std::filesystem::path(data) / "sweephome" / "dev01", options);
    clip.rig = recording->rig().stereo();
    while (auto sample = recording->next())
      if (const auto* image = std::get_if<StereoImage>(&*sample)) clip.images.push_back(*image);
    return clip;
  }();
  return loaded;
}

bool has_clip(benchmark::State& state) {
  if (clip().rig) return true;
  state.SkipWithError("needs sweephome dev01 under SWEEPKIT_DATA");
  return false;
}

void sweepkit_frame(benchmark::State& state) {
  if (!has_clip(state)) return;
  double tracked = 0;
  Sweeper* last = nullptr;
  std::optional<Sweeper> robot;
  for (auto _ : state) {
    robot.emplace(*clip().rig);
    for (const StereoImage& image : clip().images) robot->feed(image);
    state.SetIterationTime(robot->stage_clock().times(Stage::frame).median_ms * 1e-3);
    last = &*robot;
  }
  for (const TrackedImage& image : last->images()) tracked += image.points;
  const auto ms = [&](Stage stage) { return last->stage_clock().times(stage).median_ms; };
  state.counters["points"] = tracked / static_cast<double>(clip().images.size());
  state.counters["extract_ms"] = ms(Stage::extract);
  state.counters["stereo_ms"] = ms(Stage::stereo);
  state.counters["track_ms"] = ms(Stage::track);
  state.counters["local_ba_ms"] = ms(Stage::local_ba);
}

void opencv_orb_pair(benchmark::State& state) {
  if (!has_clip(state)) return;
  cv::setNumThreads(1);
  const auto orb = cv::ORB::create(1000);
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  for (auto _ : state) {
    std::vector<double> seconds;
    for (const StereoImage& image : clip().images) {
      const auto begin = std::chrono::steady_clock::now();
      for (const GrayView& view : {image.left.view, image.right.view}) {
        const cv::Mat mat(view.height, view.width, CV_8U, const_cast<std::uint8_t*>(view.data),
                          static_cast<std::size_t>(view.stride));
        orb->detectAndCompute(mat, cv::noArray(), keypoints, descriptors);
      }
      seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
    }
    std::nth_element(seconds.begin(), seconds.begin() + static_cast<std::ptrdiff_t>(seconds.size() / 2),
                     seconds.end());
    state.SetIterationTime(seconds[seconds.size() / 2]);
  }
}

BENCHMARK(sweepkit_frame)
    ->Name("slam/frame/sweepkit")
    ->UseManualTime()
    ->Iterations(1)
    ->Unit(benchmark::kMillisecond);
BENCHMARK(opencv_orb_pair)
    ->Name("slam/frame/opencv_orb")
    ->UseManualTime()
    ->Iterations(1)
    ->Unit(benchmark::kMillisecond);

}  // namespace
