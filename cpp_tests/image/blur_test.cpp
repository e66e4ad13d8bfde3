// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/image/blur.hpp"

#include <catch2/catch.hpp>
#include <cmath>

#include "image/random_image.hpp"
#include "sweepkit/core/simd.hpp"
#include "sweepkit/image/image.hpp"

using namespace sweepkit;

TEST_CASE("The blur is a Gaussian of sigma 2 in a window of 7x7") {
  const auto [width, height] =
      GENERATE(table<int, int>({{100, 37}, {64, 64}, {31, 9}, {33, 1}, {1, 12}, {2, 2}}));
  const GrayImage source = random_image(width, height, 3);
  GrayImage fast(width, height), portable(width, height);
  GaussianBlur7()(source, fast.view());
  {
    const ScopedSimdLevel level(SimdLevel::portable);
    GaussianBlur7()(source, portable.view());
  }
  CHECK(same(fast, portable));
  double weights[7], sum = 0;
  for (int i = 0; i < 7; ++i) sum += weights[i] = std::exp(-(i - 3) * (i - 3) / 8.0);
  double worst = 0;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      double expected = 0;
      for (int j = 0; j < 7; ++j)
        for (int i = 0; i < 7; ++i)
          expected += weights[i] * weights[j] / (sum * sum) *
                      source(std::clamp(x + i - 3, 0, width - 1), std::clamp(y + j - 3, 0, height - 1));
      worst = std::max(worst, std::abs(expected - fast(x, y)));
    }
  // Two roundings, and weights of 7 bits that are up to 0.3 % of a pixel off.
  CHECK(worst < 3);
}

TEST_CASE("A constant image stays constant when blurred") {
  GrayImage source(70, 10);
  source.fill(255);
  GrayImage target(70, 10);
  GaussianBlur7()(source, target.view());
  CHECK(same(source, target));
}

TEST_CASE("Blurring into another size is an error") {
  GrayImage a(10, 10), b(10, 11);
  CHECK_THROWS_AS(GaussianBlur7()(a, b.view()), Error);
  CHECK_THROWS_AS(GaussianBlur7()(GrayView{}, b.view()), Error);
}
