// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>
#include <unistd.h>

#include <map>
#include <mutex>

#include "command_line.hpp"
#include "sweepkit/core/progress.hpp"
#include "sweepkit/system/run.hpp"

namespace sweepkit {
namespace {

// Events as lines of the log. Those that can come with every image are said once; the summary counts them.
class Log {
 public:
  void operator()(const Event& event) {
    const bool often =
        event.name == "overload" || event.name == "image_missing" || event.name == "sample_dropped";
    const std::scoped_lock lock(mutex_);
    if (often && seen_[event.name]++ > 0) return;
    fmt::print(stderr, "{}sweeper_robot: {}{}\n", isatty(STDERR_FILENO) ? "\r\x1b[K" : "", to_json(event),
               often ? " (the next ones go to events.jsonl only)" : "");
  }

 private:
  std::mutex mutex_;
  std::map<std::string, int> seen_;
};

void print_result(const RunOptions& options, const RunResult& r) {
  const SweeperCounts& c = r.counts;
  fmt::print("frames       {} in {:.1f} s; {} lost, {} dropped, {} of one camera only\n", c.images, r.seconds,
             c.images_lost, c.images_dropped, c.images_missing);
  fmt::print("frame time   median {:.2f} ms, 95 % {:.2f} ms, longest {:.2f} ms\n", r.frame.median_ms,
             r.frame.p95_ms, r.frame.max_ms);
  fmt::print("path         {:.2f} m\n", r.path_m);
  fmt::print("map          {} keyframes, {} points\n", r.keyframes, r.points);
  fmt::print("results      {}\n", options.save_path);
}

int run(const RunOptions& options) {
  std::optional<Progress> progress;
  Log log;
  const RunHooks hooks{[] { return interrupted(); },
                       [&](const RunProgress& p) {
                         if (!progress) progress.emplace(stderr, "sweeper_robot", p.total, "frames");
                         progress->update(p.images, p.lost ? "lost" : "");
                       },
                       [&](const Event& event) { log(event); }};
  const RunResult result = run_recording(options, hooks);
  if (progress) progress->finish();
  print_result(options, result);
  if (result.initialised || result.stopped) return 0;
  fmt::print(stderr, "sweeper_robot: never initialised: no image had enough stereo points to start a map\n");
  return 1;
}

}  // namespace
}  // namespace sweepkit

int main(int argc, char** argv) {
  using namespace sweepkit;
  RunOptions options;
  bool realtime = false, localize = false;
  ProgramInfo info{"sweeper_robot",
                   "Stereo SLAM on a recording: path, map and figures into a folder.",
                   {"sweeper_robot --data RECORDING --out results",
                    "sweeper_robot sweeper_config.yaml --data RECORDING --start 5 --duration 20",
                    "sweeper_robot --data RECORDING --out results --realtime --set frontend.orb.count=800",
                    "sweeper_robot --data RECORDING --out results --atlas home.swk"}};
  info.shortcuts.push_back({"--atlas", "atlas"});
  info.switches = {{"--realtime", "Play at sensor time, with threads, as option realtime", &realtime},
                   {"--localize", "Use the atlas without changing it, as option localize", &localize}};
  return run_program(argc, argv, info, list_options(options), [&] {
    options.sweeper.realtime |= realtime;
    options.localize |= localize;
    return run(options);
  });
}
