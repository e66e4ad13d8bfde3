// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Starts the search for a room's main direction at random moments of a recording with truth and prints a JSON
// object a line: one for each start. Segments are found once; everything else, odometry included, begins anew
// at each start, as main_direction_detector --start does.
//
//     main_direction_accuracy RECORDING [STARTS] [SEED] [none]
//
// `none` says that the room has no main direction, whatever its truth calls the direction of its walls.
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "sweepkit/data/main_directions.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/direction/level_odometry.hpp"
#include "sweepkit/feature/segments.hpp"

namespace {

using namespace sweepkit;

constexpr double kDegree = std::numbers::pi / 180;

struct Look {
  TimeNs t = 0;
  std::vector<LineSegment> left, right;
};

std::optional<double> truth_at(const std::vector<TrueDirection>& truth, TimeNs t) {
  const auto after =
      std::lower_bound(truth.begin(), truth.end(), t, [](const auto& d, TimeNs at) { return d.t < at; });
  const TrueDirection* nearest = nullptr;
  for (auto it = after == truth.begin() ? after : after - 1; it != truth.end() && it <= after; ++it)
    if (!nearest || std::abs(it->t - t) < std::abs(nearest->t - t)) nearest = &*it;
  if (!nearest || std::abs(nearest->t - t) > kNsPerSecond / 10) return std::nullopt;
  return nearest->angle;
}

std::string number(const std::optional<double>& value) {
  return value ? fmt::format("{:.5f}", *value) : "null";
}

/// Error against the truth [deg]; nothing where the recording has no main direction.
std::optional<double> error_at(const std::vector<TrueDirection>& truth, TimeNs t, double angle) {
  const auto right = truth_at(truth, t);
  if (!right) return std::nullopt;
  return wrap_quarter_turn(angle - *right) / kDegree;
}

int run(const std::string& folder, int starts, int seed, bool has_direction) {
  const auto recording = open_recording(folder);
  const Rig rig = recording->rig();
  std::vector<TrueDirection> truth;
  if (has_direction) truth = read_true_directions(folder);
  std::vector<Sample> samples;
  std::vector<Look> looks;
  SegmentDetector detector;
  while (auto sample = recording->next()) {
    if (const auto* image = std::get_if<StereoImage>(&*sample)) {
      Look look{image->t, {}, {}};
      if (!image->left.empty()) detector.detect(image->left.view, look.left);
      if (!image->right.empty()) detector.detect(image->right.view, look.right);
      looks.push_back(std::move(look));
    } else {
      samples.push_back(std::move(*sample));
    }
  }
  if (looks.empty()) throw Error(ErrorKind::data, folder, "has no images");
  // So late that two windows still fit.
  const TimeNs begin = looks.front().t, end = std::max(begin, looks.back().t - 10 * kNsPerSecond);
  Random random(static_cast<std::uint64_t>(seed));
  MainDirectionOptions options, any;
  any.threshold = 0;
  const StereoRig stereo = rig.stereo();
  for (int k = 0; k < starts; ++k) {
    const auto start = begin + static_cast<TimeNs>(random.uniform() * static_cast<double>(end - begin));
    auto look = std::find_if(looks.begin(), looks.end(), [&](const Look& l) { return l.t >= start; });
    auto sample =
        std::find_if(samples.begin(), samples.end(), [&](const Sample& s) { return stamp(s) >= look->t; });
    LevelOdometry odometry(rig.motion(), rig.left->T_body_camera);
    MainDirectionEstimator estimator(stereo, options);
    MainDirectionWindow first_window(any);
    std::optional<MainDirection> answer, first;
    double ms = 0;
    int frames = 0;
    for (; look != looks.end() && !answer; ++look) {
      for (; sample != samples.end() && stamp(*sample) <= look->t; ++sample) {
        if (const auto* imu = std::get_if<ImuSample>(&*sample)) odometry.add(*imu);
        if (const auto* wheels = std::get_if<WheelSample>(&*sample)) odometry.add(*wheels);
      }
      const auto clock = std::chrono::steady_clock::now();
      const SO3d R_world_body = odometry.orientation(look->t);
      answer = estimator.add(look->t, look->left, look->right, R_world_body, odometry.drift());
      ms += std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - clock).count();
      ++frames;
      if (const auto window = first_window.add(estimator.last()); window && !first) first = window;
    }
    std::optional<double> at_window, at_run, at_first;
    if (answer && has_direction) {
      at_window = error_at(truth, answer->window_begin, answer->angle);
      at_run = error_at(truth, answer->run_begin, answer->run_angle);
    }
    if (first && has_direction && first->inliers > 0)
      at_first = error_at(truth, first->window_begin, first->angle);
    fmt::print(
        R"({{"start": {:.3f}, "has_direction": {}, "answered": {}, "seconds": {}, "confidence": {}, "error": {}, )"
        R"("run_error": {}, "restarts": {}, "first_confidence": {}, "first_collected": {}, "first_error": {}, )"
        R"("ms": {:.3f}}})"
        "\n",
        to_seconds(start - begin), has_direction, answer.has_value(),
        number(answer ? std::optional(to_seconds(answer->window_end - answer->run_begin)) : std::nullopt),
        number(answer ? std::optional(answer->confidence) : std::nullopt), number(at_window), number(at_run),
        estimator.window().restarts(), number(first ? std::optional(first->confidence) : std::nullopt),
        first ? first->collected : 0, number(at_first), ms / std::max(frames, 1));
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    fmt::print(stderr, "main_direction_accuracy RECORDING [STARTS] [SEED] [none]\n");
    return 2;
  }
  try {
    return run(argv[1], argc > 2 ? std::atoi(argv[2]) : 200, argc > 3 ? std::atoi(argv[3]) : 1,
               argc <= 4 || std::string(argv[4]) != "none");
  } catch (const Error& error) {
    fmt::print(stderr, "main_direction_accuracy: {}\n", error.what());
    return 3;
  }
}
