// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/core/stage_clock.hpp"

#include <catch2/catch.hpp>
#include <thread>
#include <vector>

#include "sweepkit/core/memory.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

TEST_CASE("median and 95th percentile are those of the sorted times to 0.6 %, the maximum is exact") {
  StageClock clock;
  Random random(2);
  std::vector<double> times;
  for (int i = 0; i < 2001; ++i) {
    times.push_back(std::exp(random.normal(1.0, 1.5)));
    clock.add(Stage::extract, times.back());
  }
  std::sort(times.begin(), times.end());
  const StageTimes measured = clock.times(Stage::extract);
  CHECK(measured.count == 2001);
  CHECK(measured.median_ms == Approx(times[1000]).epsilon(0.006));
  CHECK(measured.p95_ms == Approx(times[1900]).epsilon(0.006));
  CHECK(measured.max_ms == times.back());
  CHECK(clock.times(Stage::grid).count == 0);
}

TEST_CASE("times beyond the histogram are kept in its ends") {
  StageClock clock;
  for (const double ms : {0.0, 1e-9, 1e12}) clock.add(Stage::loop, ms);
  CHECK(clock.times(Stage::loop).count == 3);
  CHECK(clock.times(Stage::loop).max_ms == 1e12);
}

TEST_CASE("a scope measures from its making to its end, from any thread") {
  StageClock clock;
  {
    std::vector<std::jthread> threads;
    for (int i = 0; i < 4; ++i)
      threads.emplace_back([&clock] {
        for (int k = 0; k < 50; ++k) const auto scope = clock.time(Stage::local_ba);
      });
  }
  {
    const auto scope = clock.time(Stage::frame);
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  CHECK(clock.times(Stage::local_ba).count == 200);
  CHECK(clock.times(Stage::frame).median_ms >= 20.0);
}

TEST_CASE("stages have the names of summary.json") {
  CHECK(to_string(Stage::read) == "read");
  CHECK(to_string(Stage::local_ba) == "local_ba");
  CHECK(to_string(Stage::grid) == "grid");
}

TEST_CASE("peak memory grows with what is used and never falls") {
  const double before = peak_memory_mb();
  CHECK(before > 1.0);
  {
    std::vector<char> block(50'000'000, 1);
    CHECK(peak_memory_mb() > before + 30.0);
  }
  CHECK(peak_memory_mb() > before + 30.0);
}
