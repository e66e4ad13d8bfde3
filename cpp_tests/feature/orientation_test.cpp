// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/feature/orientation.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

#include "feature/scene.hpp"
#include "sweepkit/core/simd.hpp"

using namespace sweepkit;

TEST_CASE("Moments are sums over the disc, on every path") {
  for (std::uint32_t seed = 0; seed < 20; ++seed) {
    const GrayImage image = random_image(40, 33, seed);
    for (const int x : {15, 16, 20, 24}) {
      PatchMoments expected;
      for (int dy = -15; dy <= 15; ++dy)
        for (int dx = -15; dx <= 15; ++dx)
          if (dx * dx + dy * dy <= 15.5 * 15.5) {
            expected.x += dx * image(x + dx, 16 + dy);
            expected.y += dy * image(x + dx, 16 + dy);
          }
      CHECK(patch_moments(image, x, 16) == expected);
      const ScopedSimdLevel level(SimdLevel::portable);
      CHECK(patch_moments(image, x, 16) == expected);
    }
  }
  GrayImage bright(31, 31);
  bright.fill(255);
  CHECK(patch_moments(bright, 15, 15) == PatchMoments{0, 0});
  // The largest sums there can be.
  for (int y = 0; y < 31; ++y)
    for (int x = 0; x < 31; ++x) bright(x, y) = x > 15 ? 255 : 0;
  const PatchMoments half = patch_moments(bright, 15, 15);
  const ScopedSimdLevel level(SimdLevel::portable);
  CHECK(patch_moments(bright, 15, 15) == half);
  CHECK(half.y == 0);
}

TEST_CASE("The angle points to the bright side") {
  for (int degrees = -175; degrees <= 180; degrees += 5) {
    const double angle = degrees * std::numbers::pi / 180;
    GrayImage image(41, 41);
    for (int y = 0; y < 41; ++y)
      for (int x = 0; x < 41; ++x)
        image(x, y) = static_cast<std::uint8_t>(
            std::lround(120 + 5 * ((x - 20) * std::cos(angle) + (y - 20) * std::sin(angle))));
    CHECK(std::remainder(centroid_angle(patch_moments(image, 20, 20)) - angle, 2 * std::numbers::pi) ==
          Approx(0).margin(0.01));
  }
  CHECK(centroid_angle(PatchMoments{0, 0}) == 0);
}

TEST_CASE("Turning the image by 90 degrees turns the angle") {
  const GrayImage image = random_image(31, 31, 4);
  const PatchMoments before = patch_moments(image, 15, 15), after = patch_moments(turned(image), 15, 15);
  CHECK(after == PatchMoments{-before.y, before.x});
}
