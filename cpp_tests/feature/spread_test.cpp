// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/feature/spread.hpp"

#include <algorithm>
#include <catch2/catch.hpp>
#include <map>
#include <random>

using namespace sweepkit;

namespace {

std::vector<Corner> random_corners(int count, int width, int height, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::vector<Corner> corners;
  for (int i = 0; i < count; ++i) {
    // Crowded to the left, stronger there as well.
    const int x = static_cast<int>(random() % width * (random() % width) / width);
    corners.push_back({static_cast<std::int16_t>(x), static_cast<std::int16_t>(random() % height),
                       static_cast<std::uint8_t>(8 + random() % (200 - 150 * x / width))});
  }
  return corners;
}

/// Rounds over the cells, as the text has it.
std::vector<Corner> select_slowly(const std::vector<Corner>& corners, int wanted, int cell_size,
                                  int threshold) {
  std::map<std::pair<int, int>, std::vector<int>> cells;
  for (int i = 0; i < static_cast<int>(corners.size()); ++i)
    cells[{corners[i].y / cell_size, corners[i].x / cell_size}].push_back(i);
  const auto stronger = [&](int a, int b) {
    return std::pair(-corners[a].score, a) < std::pair(-corners[b].score, b);
  };
  for (auto& [place, list] : cells) {
    std::sort(list.begin(), list.end(), stronger);
    if (corners[list.front()].score > threshold)
      std::erase_if(list, [&](int i) { return corners[i].score <= threshold; });
  }
  std::vector<int> chosen;
  for (std::size_t round = 0; static_cast<int>(chosen.size()) < wanted; ++round) {
    std::vector<int> up;
    for (const auto& [place, list] : cells)
      if (round < list.size()) up.push_back(list[round]);
    if (up.empty()) break;
    std::sort(up.begin(), up.end(), stronger);
    up.resize(std::min<std::size_t>(up.size(), wanted - chosen.size()));
    chosen.insert(chosen.end(), up.begin(), up.end());
  }
  std::sort(chosen.begin(), chosen.end(), stronger);
  std::vector<Corner> result;
  for (const int i : chosen) result.push_back(corners[i]);
  return result;
}

}  // namespace

TEST_CASE("Cells give their corners in rounds") {
  SpreadSelector selector;
  std::vector<Corner> chosen;
  for (const int count : {1, 50, 2000})
    for (const int wanted : {1, 10, 137, 5000})
      for (const int cell : {8, 35, 1000}) {
        const auto corners = random_corners(count, 300, 200, static_cast<std::uint32_t>(count + wanted));
        selector.select(corners, 300, 200, wanted, cell, 60, chosen);
        CHECK(chosen == select_slowly(corners, wanted, cell, 60));
      }
}

TEST_CASE("Crowded corners are spread") {
  const auto corners = random_corners(5000, 600, 400, 9);
  std::vector<Corner> chosen;
  SpreadSelector().select(corners, 600, 400, 500, 40, 20, chosen);
  CHECK(chosen.size() == 500);
  // Half of the input lies in the left sixth; of the chosen a little more than a sixth does.
  const auto left = std::count_if(chosen.begin(), chosen.end(), [](const Corner& c) { return c.x < 100; });
  CHECK(left < 500 / 4);
}

TEST_CASE("Nothing in, nothing wanted: nothing out") {
  std::vector<Corner> chosen{{1, 1, 1}};
  SpreadSelector().select({}, 100, 100, 10, 30, 20, chosen);
  CHECK(chosen.empty());
  SpreadSelector().select(random_corners(10, 100, 100, 1), 100, 100, 0, 30, 20, chosen);
  CHECK(chosen.empty());
  CHECK_THROWS_AS(SpreadSelector().select({}, 100, 100, 10, 0, 20, chosen), Error);
}
