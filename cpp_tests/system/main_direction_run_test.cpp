// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/main_direction_run.hpp"

#include <catch2/catch.hpp>
#include <cstdlib>
#include <fstream>
#include <iterator>

#include "scratch_folder.hpp"
#include "sweepkit/data/main_directions.hpp"

using namespace sweepkit;

TEST_CASE("the main direction of a recording is found, written and near the truth") {
  const char* data = std::getenv("SWEEPKIT_DATA");
  if (!data) {
    WARN("skipped: SWEEPKIT_DATA is unset");
    return;
  }
  const ScratchFolder scratch;
  MainDirectionRunOptions options;
  options.data_path = std::string(data) + "/sweephome/dev03";
  options.save_path = (scratch.path() / "out").string();
  options.direction.window = 15;
  options.recording.start = 8;  // turning
  const auto result = find_main_direction(options);
  REQUIRE(result.detections.size() == 1);
  const auto file = scratch.path() / "out/main_direction_result.txt";
  const auto written = read_main_directions(file);
  REQUIRE(written.size() == 1);
  const auto e = evaluate_main_directions(read_true_directions(options.data_path), written);
  CHECK(e.pairs.size() == 2);
  CHECK(e.window_deg.max < 1.5);
  CHECK(e.run_deg.max < 1.5);
  CHECK(std::filesystem::exists(scratch.path() / "out/summary.json"));
  CHECK(std::filesystem::exists(scratch.path() / "out" /
                                ("main_direction_" + std::to_string(written[0].window_begin) + ".png")));

  // Again, the same; and every window to the end of a shorter part.
  options.detections = 0;
  options.recording.duration = 4;
  options.save_path.clear();
  const auto all = find_main_direction(options);
  CHECK(all.frames.size() <= 41);
  REQUIRE(all.detections.size() >= 2);
  CHECK(main_direction_line(all.detections[0]) == main_direction_line(result.detections[0]));
  CHECK(all.detections[1].run_begin == all.detections[0].run_begin);

  // A recording that ends first gives no answer.
  options.recording.duration = 1;
  CHECK(find_main_direction(options).detections.empty());
  const auto stopped = find_main_direction(options, {[] { return true; }, {}});
  CHECK(stopped.stopped);
  CHECK(stopped.frames.empty());
}

TEST_CASE("wrong options are refused before anything is written") {
  MainDirectionRunOptions options;
  CHECK_THROWS_AS(find_main_direction(options), Error);
  options.data_path = "/nowhere";
  options.direction.threshold = 2;
  CHECK_THROWS_WITH(find_main_direction(options), Catch::Contains("direction.threshold"));
  options.direction.threshold = 0.5;
  CHECK_THROWS_AS(find_main_direction(options), Error);
}
