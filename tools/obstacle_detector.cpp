// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <optional>

#include "command_line.hpp"
#include "sweepkit/core/progress.hpp"
#include "sweepkit/system/obstacle_run.hpp"

int main(int argc, char** argv) {
  using namespace sweepkit;
  ObstacleRunOptions options;
  const ProgramInfo info{"obstacle_detector",
                         "Finds what lies in the way on the floor, in the stereo images of a recording.",
                         {"obstacle_detector --data RECORDING --out results",
                          "obstacle_detector obstacle_detector.yaml --data RECORDING --start 12 --duration 5",
                          "obstacle_detector --data RECORDING --out results --set every=0 --set "
                          "obstacles.max_range=2"}};
  return run_program(argc, argv, info, list_options(options), [&] {
    if (options.save_path.empty()) throw Error(ErrorKind::option, "save_path", "must be given");
    std::optional<Progress> progress;
    ObstacleHooks hooks;
    hooks.stop = [] { return interrupted(); };
    hooks.progress = [&](std::int64_t images, std::int64_t total) {
      if (!progress) progress.emplace(stderr, "obstacle_detector", total, "frames");
      progress->update(images);
    };
    const ObstacleRunResult result = detect_obstacles(options, hooks);
    if (progress) progress->finish();
    fmt::print("frames       {}; floor measured in {}\n", result.frames, result.planes_measured);
    fmt::print("obstacles    {} sightings, {} of holes; {} things confirmed\n", result.obstacles,
               result.holes, result.confirmed);
    fmt::print("time         {:.1f} ms a pair (median), {:.1f} ms (95 %)\n", result.times.median_ms,
               result.times.p95_ms);
    fmt::print("results      {}\n", options.save_path);
    if (result.frames > 0 || result.stopped) return 0;
    fmt::print(stderr, "obstacle_detector: no stereo pair in the recording\n");
    return 1;
  });
}
