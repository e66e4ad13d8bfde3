// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// The whole system on recordings. The bounds leave some room: tools/bench/accuracy.py prints the figures.
#include <catch2/catch.hpp>
#include <cstdlib>

#include "scratch_folder.hpp"
#include "sweepkit/data/evaluation.hpp"
#include "sweepkit/system/run.hpp"

using namespace sweepkit;

namespace {

struct Outcome {
  RunResult result;
  Evaluation live;   ///< best rigid motion
  Evaluation first;  ///< first pose aligned
};

// Nothing, and a visible note, where there are no recordings.
std::optional<Outcome> run(const std::string& name, double seconds, bool cameras_alone = true) {
  const char* data = std::getenv("SWEEPKIT_DATA");
  if (!data) {
    WARN("skipped: SWEEPKIT_DATA is not set");
    return std::nullopt;
  }
  const ScratchFolder folder;
  RunOptions options;
  options.data_path = (std::filesystem::path(data) / name).string();
  options.save_path = (folder / "out").string();
  options.recording.duration = seconds;
  options.recording.use_imu = options.recording.use_wheels = !cameras_alone;
  Outcome outcome;
  outcome.result = run_recording(options);
  const Trajectory truth = read_trajectory(options.data_path);
  const Trajectory live = read_tum(folder / "out/trajectory_live.tum");
  outcome.live = evaluate_trajectory(truth, live);
  EvaluationOptions first;
  first.align = AlignMode::first;
  outcome.first = evaluate_trajectory(truth, live, first);
  return outcome;
}

}  // namespace

TEST_CASE("KITTI 06, 51 frames", "[recording]") {
  const auto outcome = run("kitti/06_first51", 0);
  if (!outcome) return;
  CHECK(outcome->result.counts.images == 51);
  CHECK(outcome->result.counts.images_lost == 0);
  CHECK(outcome->live.ape_m.rmse < 0.05);
  CHECK(*outcome->live.translation_error_percent_end < 0.7);
  REQUIRE(outcome->first.translation_error_percent_end);
  CHECK(*outcome->first.translation_error_percent_end < 1.1);
}

TEST_CASE("EuRoC V1_01, standing still", "[recording]") {
  const auto outcome = run("euroc_still", 0);
  if (!outcome) return;
  CHECK(outcome->result.counts.images == 48);
  CHECK(outcome->result.counts.images_lost == 0);
  CHECK(outcome->live.ape_m.rmse < 0.7e-3);
  CHECK(outcome->first.rotation_fitted_deg.rmse < 0.1);
}

TEST_CASE("sweephome dev01, the first 10 s", "[recording]") {
  const auto outcome = run("sweephome/dev01", 10);
  if (!outcome) return;
  CHECK(outcome->result.counts.images == 101);
  CHECK(outcome->result.counts.images_lost == 0);
  CHECK(outcome->live.ape_m.rmse < 0.015);
  CHECK(outcome->first.rotation_deg.max < 1.0);
}

TEST_CASE("sweephome dev01 with IMU and wheels", "[recording]") {
  const auto outcome = run("sweephome/dev01", 0, false);
  if (!outcome) return;
  CHECK(outcome->result.counts.images_lost == 0);
  CHECK(outcome->live.ape_m.rmse < 0.008);
}

TEST_CASE("sweephome dev02: dark for five seconds, slip, a person", "[recording]") {
  const auto outcome = run("sweephome/dev02", 0, false);
  if (!outcome) return;
  CHECK(outcome->live.ape_m.rmse < 0.018);
}

TEST_CASE("sweephome dev03: a bare wall, and carried through the air", "[recording]") {
  const auto outcome = run("sweephome/dev03", 0, false);
  if (!outcome) return;
  CHECK(outcome->live.ape_m.rmse < 0.020);
}
