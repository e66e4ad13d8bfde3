// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/main_directions.hpp"

#include <catch2/catch.hpp>
#include <cstdlib>
#include <fstream>
#include <numbers>

#include "scratch_folder.hpp"

using namespace sweepkit;

namespace {

constexpr double kDegree = std::numbers::pi / 180;

MainDirection direction(TimeNs t, double degrees, double confidence, TimeNs run, double run_degrees) {
  MainDirection d;
  d.window_begin = t;
  d.angle = degrees * kDegree;
  d.confidence = confidence;
  d.run_begin = run;
  d.run_angle = run_degrees * kDegree;
  return d;
}

}  // namespace

TEST_CASE("a result has five columns and reads back") {
  const MainDirection d = direction(1701775511050000000, 2.31592, 0.83333, 1701775509999999999, -44.99);
  CHECK(main_direction_line(d) == "1701775511.050000000 2.315920 0.833330 1701775509.999999999 -44.990000");
  // -45 degrees is written as what it is modulo a quarter turn.
  CHECK(main_direction_line(direction(0, -45 + 1e-9, 1, 0, 45)) ==
        "0.000000000 45.000000 1.000000 0.000000000 45.000000");

  const ScratchFolder folder;
  const auto file = folder.path() / "main_direction_result.txt";
  write_main_directions(file, {d, direction(5, 40, 0.5, 0, -10)});
  const auto back = read_main_directions(file);
  REQUIRE(back.size() == 2);
  CHECK(back[0].window_begin == d.window_begin);
  CHECK(back[0].run_begin == d.run_begin);
  CHECK(back[0].angle == Approx(d.angle));
  CHECK(back[0].run_angle == Approx(d.run_angle));
  CHECK(back[1].confidence == 0.5);
  write_main_directions(file, {});
  CHECK(read_main_directions(file).empty());
  CHECK_THROWS_AS(write_main_directions(folder.path() / "none" / "x.txt", {}), Error);
}

TEST_CASE("damaged results and truths are refused with file and line") {
  const ScratchFolder folder;
  const auto file = folder.path() / "r.txt";
  for (const char* text : {"1 2 3\n", "1 x 0.5 1 2\n", "1 2 1.5 1 2\n", "1 nan 0.5 1 2\n"}) {
    std::ofstream(file) << "# a comment\n" << text;
    CHECK_THROWS_WITH(read_main_directions(file), Catch::Contains("r.txt:2"));
  }
  std::ofstream(file) << "1\n";
  CHECK_THROWS_WITH(read_true_directions(file), Catch::Contains("r.txt:1"));
  std::ofstream(folder.path() / "truth.yaml") << "main_direction: {yaw_from_left_camera_frame0_deg: north}\n";
  CHECK_THROWS_WITH(read_true_directions(folder.path() / "truth.yaml"), Catch::Contains("must be a number"));
  std::ofstream(folder.path() / "truth.yaml") << "a: [1\n";
  CHECK_THROWS_AS(read_true_directions(folder.path() / "truth.yaml"), Error);
  CHECK_THROWS_AS(read_true_directions(folder.path() / "missing.txt"), Error);
}

TEST_CASE("errors are taken modulo a quarter turn, at the window and at the run") {
  const ScratchFolder folder;
  std::ofstream(folder.path() / "main_direction_gt.txt") << "10.0 44\n20.0, -44.5\n";
  const auto truth = read_true_directions(folder.path());
  REQUIRE(truth.size() == 2);
  const auto e = evaluate_main_directions(truth, {direction(20'010'000'000, 44.5, 0.9, 10'000'000'000, 41),
                                                  direction(99'000'000'000, 0, 0.9, 10'000'000'000, 44)});
  REQUIRE(e.pairs.size() == 3);
  CHECK(e.pairs[0].error / kDegree == Approx(-1));
  CHECK(e.pairs[1].error / kDegree == Approx(-3));
  CHECK(e.pairs[1].at_run);
  CHECK(e.window_deg.max == Approx(1));
  CHECK(e.run_deg.mean == Approx(1.5));
  CHECK(e.right_share == Approx(2.0 / 3));
  CHECK(to_json(e).find("\"right_share\"") != std::string::npos);
  CHECK(to_table(e).find("answers 2") != std::string::npos);
  CHECK_THROWS_AS(evaluate_main_directions(truth, {direction(0, 0, 1, 0, 0)}), Error);
}

TEST_CASE("the truth of a simulated recording follows its poses") {
  const char* data = std::getenv("SWEEPKIT_DATA");
  if (!data) {
    WARN("skipped: SWEEPKIT_DATA is unset");
    return;
  }
  const auto folder = std::filesystem::path(data) / "sweephome/dev01";
  const auto truth = read_true_directions(folder);
  CHECK(truth.size() > 1000);
  // truth.yaml says the angle at the first frame itself.
  const ScratchFolder scratch;
  std::filesystem::copy_file(folder / "truth.yaml", scratch.path() / "truth.yaml");
  const auto first = read_true_directions(scratch.path());
  REQUIRE(first.size() == 1);
  for (const TrueDirection& t : truth)
    if (t.t == first[0].t) CHECK(std::abs(wrap_quarter_turn(t.angle - first[0].angle)) < 0.01 * kDegree);
}
