// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/simulate.hpp"

#include <fmt/format.h>

#include <optional>
#include <string_view>

#include "command_line.hpp"
#include "sweepkit/core/progress.hpp"

namespace sweepkit {
namespace {

// The scene has to be known before the other options: what it says of robot and sensors is below what the
// configuration and the command line say.
std::optional<std::string> scene_of(int argc, char** argv) {
  std::optional<std::string> scene;
  constexpr std::string_view kFlag = "--scene";
  for (int i = 1; i < argc; ++i) {
    const std::string_view word = argv[i];
    if (word == "--") break;
    if (word == kFlag && i + 1 < argc) scene = argv[i + 1];
    if (word.starts_with("--scene=")) scene = word.substr(kFlag.size() + 1);
  }
  return scene;
}

int run(const SimulatedScene& scene, const SimulationOptions& options) {
  if (options.save_path.empty()) throw Error(ErrorKind::option, "save_path", "is needed: --out DIR");
  std::optional<Progress> progress;
  const SimulationHooks hooks{[] { return interrupted(); },
                              [&](int done, int total) {
                                if (!progress) progress.emplace(stderr, "simulate", total, "frames");
                                progress->update(done);
                              }};
  const SimulationResult result = simulate(scene, options, hooks);
  if (progress) progress->finish();
  if (result.stopped) return 0;
  fmt::print("recording    {:.1f} s, {} stereo images, {:.2f} m\n", result.duration, result.frames,
             result.path_m);
  fmt::print("time         {:.1f} s, of these {:.1f} s for images: {:.1f} pairs a second\n", result.seconds,
             result.drawing, result.frames / std::max(result.drawing, 1e-3));
  fmt::print("results      {}\n", options.save_path);
  return 0;
}

}  // namespace
}  // namespace sweepkit

int main(int argc, char** argv) {
  using namespace sweepkit;
  SimulationOptions options;
  std::optional<SimulatedScene> scene;
  std::optional<Error> failure;
  std::string file;
  if (const auto given = scene_of(argc, argv)) {
    try {
      scene = read_simulated_scene(*given, options);
    } catch (const Error& error) {
      failure = error;
    }
  }
  const ProgramInfo info{
      "simulate",
      "Makes a recording of a cleaning robot in a furnished flat, with truth.",
      {"simulate --scene two_rooms.yaml --out recording",
       "simulate --scene two_rooms.yaml --out recording --duration 20 --seed 3 --set format=jpeg",
       "simulate --scene two_rooms.yaml --out recording --set sensors.imu.gyro_noise_density=0.001"},
      {{"--out", "save_path"},
       {"--seed", "seed"},
       {"--duration", "duration"},
       {"--threads", "renderer.threads"}},
      {{"--scene", "FILE", "the flat, the drive and what happens; its robot and sensors are defaults here",
        &file, true}}};
  return run_program(argc, argv, info, list_options(options), [&] {
    if (failure) throw *failure;
    if (!scene) throw Error(ErrorKind::option, "--scene", "is needed");
    return run(*scene, options);
  });
}
