// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/feature/brief.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

#include "feature/scene.hpp"

using namespace sweepkit;

namespace {

struct ShortPattern {
  static constexpr int kBits = 64;
  static constexpr auto kPairs = [] {
    std::array<PixelPair, kBits> pairs{};
    for (int i = 0; i < kBits; ++i)
      pairs[i] = {static_cast<std::int8_t>(i % 8 - 4), static_cast<std::int8_t>(i / 8 - 4),
                  static_cast<std::int8_t>(3 - i % 5), static_cast<std::int8_t>(i % 7 - 3)};
    return pairs;
  }();
};

}  // namespace

TEMPLATE_TEST_CASE("A descriptor compares the turned pairs of its pattern", "", OrbPattern, ShortPattern) {
  const GrayImage image = random_image(60, 50, 1);
  RotatedBrief<TestType> brief;
  brief.prepare(image.stride());
  CHECK(brief.radius() <= 19);
  constexpr int kAngles = RotatedBrief<TestType>::kAngles;
  for (int a = -kAngles; a <= kAngles; a += 3) {
    const double angle = 2 * std::numbers::pi * a / kAngles;
    const auto descriptor = brief.describe(image, 28, 25, static_cast<float>(angle));
    for (int i = 0; i < TestType::kBits; ++i) {
      const auto value = [&](int x, int y) {
        const int u = static_cast<int>(std::lround(std::cos(angle) * x - std::sin(angle) * y));
        const int v = static_cast<int>(std::lround(std::sin(angle) * x + std::cos(angle) * y));
        return image(28 + u, 25 + v);
      };
      const PixelPair p = TestType::kPairs[i];
      const bool bit = descriptor.words[i / 64] >> (i % 64) & 1;
      CHECK_FALSE(bit != value(p.x1, p.y1) < value(p.x2, p.y2));
    }
  }
}

TEST_CASE("A patch turned with its angle keeps its descriptor") {
  const GrayImage image = random_image(51, 51, 2);
  RotatedBrief<> brief;
  brief.prepare(image.stride());
  const GrayImage other = turned(image);
  REQUIRE(other.stride() == image.stride());
  const auto quarter = static_cast<float>(std::numbers::pi / 2);
  for (int a = 0; a < 16; ++a) {
    const float angle = 0.35f * static_cast<float>(a);
    // Rounding of halves may move single samples.
    CHECK(hamming_distance(brief.describe(image, 25, 25, angle),
                           brief.describe(other, 25, 25, angle + quarter)) <= 4);
  }
}

TEST_CASE("Brightness and contrast leave a descriptor as it is") {
  GrayImage image = random_image(51, 51, 3);
  for (int y = 0; y < 51; ++y)
    for (int x = 0; x < 51; ++x) image(x, y) /= 4;
  GrayImage other = image;
  for (int y = 0; y < 51; ++y)
    for (int x = 0; x < 51; ++x) other(x, y) = static_cast<std::uint8_t>(3 * image(x, y) + 20);
  RotatedBrief<> brief;
  brief.prepare(image.stride());
  CHECK(brief.describe(image, 25, 25, 1.0f) == brief.describe(other, 25, 25, 1.0f));
}
