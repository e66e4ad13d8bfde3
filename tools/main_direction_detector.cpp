// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <numbers>
#include <optional>

#include "command_line.hpp"
#include "sweepkit/core/progress.hpp"
#include "sweepkit/data/main_directions.hpp"
#include "sweepkit/system/main_direction_run.hpp"

int main(int argc, char** argv) {
  using namespace sweepkit;
  MainDirectionRunOptions options;
  const ProgramInfo info{
      "main_direction_detector",
      "Finds the main direction of a room in the first seconds of a recording.",
      {"main_direction_detector --data RECORDING --out results",
       "main_direction_detector main_direction_detector.yaml --data RECORDING --start 12",
       "main_direction_detector --data RECORDING --out results --set direction.threshold=0.7"}};
  return run_program(argc, argv, info, list_options(options), [&] {
    if (options.save_path.empty()) throw Error(ErrorKind::option, "save_path", "must be given");
    std::optional<Progress> progress;
    const MainDirectionHooks hooks{[] { return interrupted(); },
                                   [&](std::int64_t images, std::int64_t total) {
                                     if (!progress)
                                       progress.emplace(stderr, "main_direction_detector", total, "frames");
                                     progress->update(images);
                                   }};
    const MainDirectionRunResult result = find_main_direction(options, hooks);
    if (progress) progress->finish();
    constexpr double kDegree = std::numbers::pi / 180;
    for (const MainDirection& d : result.detections)
      fmt::print(
          "direction    {:.3f} deg from the left camera at {:.3f} s, {:.3f} deg at the run's first frame; "
          "confidence {:.3f} ({} of {} directions, {} frames)\n",
          d.angle / kDegree, to_seconds(d.window_begin - d.run_begin), d.run_angle / kDegree, d.confidence,
          d.inliers, d.collected, d.frames);
    fmt::print("frames       {}; {} windows rejected\n", result.frames.size(), result.restarts);
    fmt::print("time         lines of a pair {:.2f} ms, direction {:.2f} ms (medians)\n", result.lines_ms,
               result.direction_ms);
    fmt::print("results      {}\n", options.save_path);
    if (!result.detections.empty() || result.stopped) return 0;
    if (result.restarts > 0)
      fmt::print(stderr,
                 "main_direction_detector: no main direction: none of {} windows reached the confidence {}\n",
                 result.restarts, options.direction.threshold);
    else
      fmt::print(stderr,
                 "main_direction_detector: no main direction: {} frames are fewer than a window of {}\n",
                 result.frames.size(), options.direction.window);
    return 1;
  });
}
