// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/core/parallel.hpp"

#include <atomic>
#include <catch2/catch.hpp>
#include <mutex>
#include <stdexcept>
#include <string>
#include <tuple>

using namespace sweepkit;

TEST_CASE("every index is visited once, whatever the number of threads") {
  for (const int threads : {0, 1, 2, 3, 8})
    for (const std::size_t count : {0u, 1u, 2u, 7u, 1000u}) {
      std::vector<std::atomic<int>> visits(count);
      parallel_for(count, threads, [&](std::size_t i) { ++visits[i]; });
      for (const auto& visit : visits) REQUIRE(visit == 1);
    }
}

TEST_CASE("blocks follow one another and are alike in length") {
  std::mutex mutex;
  std::vector<std::tuple<std::size_t, std::size_t, std::size_t>> blocks(3);
  parallel_blocks(10, 3, [&](std::size_t begin, std::size_t end, std::size_t block) {
    const std::scoped_lock lock(mutex);
    blocks[block] = {begin, end, block};
  });
  CHECK(blocks[0] == std::tuple<std::size_t, std::size_t, std::size_t>(0, 3, 0));
  CHECK(blocks[1] == std::tuple<std::size_t, std::size_t, std::size_t>(3, 6, 1));
  CHECK(blocks[2] == std::tuple<std::size_t, std::size_t, std::size_t>(6, 10, 2));
}

TEST_CASE("the exception of the lowest block is thrown on, after all have ended") {
  for (int trial = 0; trial < 20; ++trial) {
    std::atomic<int> ended = 0;
    try {
      parallel_blocks(4, 4, [&](std::size_t, std::size_t, std::size_t block) {
        ++ended;
        if (block > 0) throw std::runtime_error(std::to_string(block));
      });
      FAIL("no exception");
    } catch (const std::runtime_error& error) {
      CHECK(std::string(error.what()) == "1");
    }
    CHECK(ended == 4);
  }
}
