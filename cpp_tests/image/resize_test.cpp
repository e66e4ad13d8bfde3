// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/image/resize.hpp"

#include <catch2/catch.hpp>
#include <cmath>

#include "image/random_image.hpp"
#include "sweepkit/core/simd.hpp"
#include "sweepkit/image/image.hpp"

using namespace sweepkit;

namespace {

/// Bilinear interpolation in double, straight from the definition.
double bilinear(GrayView image, double x, double y) {
  x = std::min(std::max(x, 0.0), image.width - 1.0);
  y = std::min(std::max(y, 0.0), image.height - 1.0);
  const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
  const int x1 = std::min(x0 + 1, image.width - 1), y1 = std::min(y0 + 1, image.height - 1);
  const double u = x - x0, v = y - y0;
  return (1 - v) * ((1 - u) * image(x0, y0) + u * image(x1, y0)) +
         v * ((1 - u) * image(x0, y1) + u * image(x1, y1));
}

}  // namespace

TEST_CASE("A resized image is the bilinear interpolation at mapped pixel centres") {
  const auto [from_w, from_h, to_w, to_h] = GENERATE(table<int, int, int, int>({{640, 400, 533, 333},
                                                                                {97, 31, 81, 26},
                                                                                {64, 64, 32, 32},
                                                                                {50, 7, 20, 7},
                                                                                {33, 5, 33, 5},
                                                                                {20, 20, 47, 51},
                                                                                {3, 2, 1, 1},
                                                                                {1, 1, 5, 5}}));
  const GrayImage source = random_image(from_w, from_h, 1);
  GrayImage fast(to_w, to_h), portable(to_w, to_h);
  BilinearResizer()(source, fast.view());
  {
    const ScopedSimdLevel level(SimdLevel::portable);
    BilinearResizer()(source, portable.view());
  }
  double worst = 0;
  for (int y = 0; y < to_h; ++y)
    for (int x = 0; x < to_w; ++x) {
      CHECK_FALSE(fast(x, y) != portable(x, y));
      const double expected =
          bilinear(source, (x + 0.5) * from_w / to_w - 0.5, (y + 0.5) * from_h / to_h - 0.5);
      worst = std::max(worst, std::abs(expected - fast(x, y)));
    }
  // Half a grey level of rounding, and weights along a row that are up to 1/128 off.
  CHECK(worst < 0.5 + 255.0 / 128 + 0.02);
}

TEST_CASE("A constant image stays constant when resized") {
  for (const int value : {0, 1, 127, 255}) {
    GrayImage source(123, 45);
    source.fill(static_cast<std::uint8_t>(value));
    GrayImage target(77, 31);
    BilinearResizer()(source, target.view());
    for (int y = 0; y < 31; ++y)
      for (int x = 0; x < 77; ++x) CHECK_FALSE(target(x, y) != value);
  }
}

TEST_CASE("Resizing reads a part of a larger image through its stride") {
  const GrayImage whole = random_image(200, 90, 2);
  const GrayView part{whole.row(11) + 17, 101, 53, whole.stride()};
  const GrayImage copy(part);
  GrayImage a(84, 44), b(84, 44);
  BilinearResizer()(part, a.view());
  BilinearResizer()(copy, b.view());
  CHECK(same(a, b));
}

TEST_CASE("Resizing from or to nothing is an error") {
  GrayImage image(4, 4);
  CHECK_THROWS_AS(BilinearResizer()(GrayView{}, image.view()), Error);
  CHECK_THROWS_AS(BilinearResizer()(image, View2d<std::uint8_t>{}), Error);
}
