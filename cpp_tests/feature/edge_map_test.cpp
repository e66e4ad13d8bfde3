// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/feature/edge_map.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <vector>

#include "feature/scene.hpp"

using namespace sweepkit;

namespace {

/// The definition, pixel by pixel: 16 times the smoothed grey level.
int smooth(GrayView image, int x, int y) {
  constexpr int kWeights[5] = {1, 4, 6, 4, 1};
  int sum = 0;
  for (int j = -2; j <= 2; ++j)
    for (int i = -2; i <= 2; ++i)
      sum += kWeights[j + 2] * kWeights[i + 2] *
             image(std::clamp(x + i, 0, image.width - 1), std::clamp(y + j, 0, image.height - 1));
  return (sum + 8) >> 4;
}

struct Slow {
  std::vector<int> gx, gy, magnitude;
};

Slow slow_gradient(GrayView image) {
  const auto s = [&](int x, int y) {
    return smooth(image, std::clamp(x, 0, image.width - 1), std::clamp(y, 0, image.height - 1));
  };
  Slow result;
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) {
      int gx = 0, gy = 0;
      for (int i = -1; i <= 1; ++i) {
        gx += (2 - std::abs(i)) * (s(x + 1, y + i) - s(x - 1, y + i));
        gy += (2 - std::abs(i)) * (s(x + i, y + 1) - s(x + i, y - 1));
      }
      const int u = std::abs(gx), v = std::abs(gy);
      result.gx.push_back(gx);
      result.gy.push_back(gy);
      result.magnitude.push_back(std::max(u, v) + 3 * std::min(u, v) / 8);
    }
  return result;
}

}  // namespace

TEST_CASE("Gradient and ridges are as defined, on every path") {
  const auto [width, height] =
      GENERATE(table<int, int>({{103, 41}, {64, 20}, {33, 17}, {17, 9}, {5, 5}, {6, 30}}));
  const bool portable = GENERATE(false, true);
  const double threshold = GENERATE(0.1, 3.0, 30.0);
  const ScopedSimdLevel level(portable ? SimdLevel::portable : simd_level());
  GrayImage image = width % 2 ? random_scene(width, height, 6) : random_image(width, height, 5);
  if (width == 64)
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) image(x, y) = image(x, y) > 127 ? 255 : 0;
  EdgeMap map;
  map.build<std::uint8_t>(random_image(120, 50, 1), 1.0);  // what was there before must not matter
  map.build<std::uint8_t>(image, threshold);
  const Slow slow = slow_gradient(image);
  const auto at = [&](int x, int y) { return slow.magnitude[y * width + x]; };
  int wrong = 0, ridges = 0;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const std::size_t i = static_cast<std::size_t>(y) * width + x;
      wrong += map.gradient()(x, y).x != slow.gx[i] || map.gradient()(x, y).y != slow.gy[i] ||
               map.magnitude()(x, y) != at(x, y);
      int expected = 0;
      const int margin = EdgeMap::kMargin;
      if (x >= margin && y >= margin && x < width - margin && y < height - margin &&
          at(x, y) >= std::ceil(threshold * EdgeMap::kUnit)) {
        const bool steep = std::abs(slow.gx[i]) >= std::abs(slow.gy[i]);
        const int before = steep ? at(x - 1, y) : at(x, y - 1), after = steep ? at(x + 1, y) : at(x, y + 1);
        if (at(x, y) > before && at(x, y) >= after)
          expected = steep ? impl::kSteepRidge : impl::kShallowRidge;
      }
      wrong += map.ridge()(x, y) != expected;
      ridges += expected != 0;
    }
  CHECK(wrong == 0);
  if (width > 30 && threshold < 10) CHECK(ridges > 10);
}

TEST_CASE("A ramp has its slope as gradient") {
  GrayImage image(40, 30);
  for (int y = 0; y < 30; ++y)
    for (int x = 0; x < 40; ++x) image(x, y) = static_cast<std::uint8_t>(3 * x + 2 * y);
  EdgeMap map;
  map.build<std::uint8_t>(image, 1.0);
  for (int y = 4; y < 26; ++y)
    for (int x = 4; x < 36; ++x) {
      CHECK(map.gradient()(x, y).x == 3 * EdgeMap::kUnit);
      CHECK(map.gradient()(x, y).y == 2 * EdgeMap::kUnit);
    }
}

TEST_CASE("An edge map refuses a threshold that is no positive number") {
  EdgeMap map;
  const GrayImage image(20, 20);
  CHECK_THROWS_AS(map.build<std::uint8_t>(image, 0.0), Error);
  CHECK_THROWS_AS(map.build<std::uint8_t>(image, std::nan("")), Error);
}
