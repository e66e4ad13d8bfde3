// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/core/random.hpp"

#include <algorithm>
#include <array>
#include <catch2/catch.hpp>
#include <map>
#include <numeric>
#include <vector>

using namespace sweepkit;

TEST_CASE("the sequence is that of xoshiro256** and the same for the same seed") {
  // The reference code of Blackman and Vigna (prng.di.unimi.it), written out: state s of four words.
  std::uint64_t x = 42, s[4];
  for (auto& word : s) {
    std::uint64_t z = (x += 0x9e3779b97f4a7c15);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9;
    z = (z ^ (z >> 27)) * 0x94d049bb133111eb;
    word = z ^ (z >> 31);
  }
  const auto rotl = [](std::uint64_t v, int k) { return (v << k) | (v >> (64 - k)); };
  Random random(42), again(42), other(43);
  for (int i = 0; i < 1000; ++i) {
    const std::uint64_t expected = rotl(s[1] * 5, 7) * 9;
    const std::uint64_t t = s[1] << 17;
    s[2] ^= s[0], s[3] ^= s[1], s[1] ^= s[2], s[0] ^= s[3], s[2] ^= t, s[3] = rotl(s[3], 45);
    const std::uint64_t drawn = random();
    REQUIRE(drawn == expected);
    REQUIRE(again() == drawn);
    REQUIRE(other() != drawn);
  }
}

TEST_CASE("uniform and normal numbers have their moments") {
  Random random(1);
  constexpr int kCount = 200000;
  double sum = 0, square = 0, fourth = 0, low = 1, high = 0, mean = 0;
  for (int i = 0; i < kCount; ++i) {
    const double u = random.uniform();
    low = std::min(low, u);
    high = std::max(high, u);
    mean += u / kCount;
    const double n = random.normal();
    sum += n / kCount;
    square += n * n / kCount;
    fourth += n * n * n * n / kCount;
  }
  CHECK(low >= 0.0);
  CHECK(high < 1.0);
  CHECK(mean == Approx(0.5).margin(0.003));
  CHECK(sum == Approx(0.0).margin(0.01));
  CHECK(square == Approx(1.0).margin(0.02));
  CHECK(fourth == Approx(3.0).margin(0.15));
}

TEST_CASE("an index is uniform, also where the count is no power of two") {
  Random random(9);
  std::array<int, 7> hits{};
  for (int i = 0; i < 70000; ++i) ++hits[random.index(7)];
  for (const int count : hits) CHECK(count == Approx(10000).margin(400));
  CHECK_THROWS_AS(random.index(0), Error);
}

TEST_CASE("a shuffle is a permutation, a sample has distinct numbers, and all are alike") {
  Random random(3);
  std::map<std::vector<int>, int> orders, samples;
  for (int i = 0; i < 24000; ++i) {
    std::vector<int> values{0, 1, 2, 3};
    random.shuffle(std::span<int>(values));
    ++orders[values];
    std::vector<int> chosen(2);
    random.sample(4, std::span<int>(chosen));
    REQUIRE(chosen[0] != chosen[1]);
    ++samples[chosen];
  }
  CHECK(orders.size() == 24);
  for (const auto& [order, count] : orders) CHECK(count == Approx(1000).margin(150));
  CHECK(samples.size() == 12);
  for (const auto& [chosen, count] : samples) CHECK(count == Approx(2000).margin(220));
  std::vector<int> all(5);
  random.sample(5, std::span<int>(all));
  std::sort(all.begin(), all.end());
  CHECK(all == std::vector<int>{0, 1, 2, 3, 4});
  CHECK_THROWS_AS(random.sample(4, std::span<int>(all)), Error);
}
