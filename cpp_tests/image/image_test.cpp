// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/image/image.hpp"

#include <catch2/catch.hpp>
#include <cstdint>

#include "image/random_image.hpp"

using namespace sweepkit;

TEST_CASE("Rows of an image are aligned and hold at least the stride asked for") {
  for (const int width : {1, 63, 64, 65, 641}) {
    Image<float> image(width, 3);
    CHECK(image.stride() >= width);
    for (int y = 0; y < 3; ++y) CHECK(reinterpret_cast<std::uintptr_t>(image.row(y)) % 64 == 0);
  }
  GrayImage image;
  image.resize(10, 10, 300);
  CHECK(image.stride() >= 300);
}

TEST_CASE("An image that shrinks and grows back keeps its memory") {
  GrayImage image(100, 100);
  const auto* memory = image.row(0);
  image.resize(10, 10);
  image.resize(100, 100);
  CHECK(image.row(0) == memory);
}

TEST_CASE("Images copy and move as values") {
  const GrayImage a = random_image(50, 20, 1);
  GrayImage b = a;
  CHECK(same(a, b));
  b(3, 4) = static_cast<std::uint8_t>(b(3, 4) + 1);
  CHECK_FALSE(same(a, b));
  const auto* memory = b.row(0);
  GrayImage c = std::move(b);
  CHECK(c.row(0) == memory);
  b = a;
  CHECK(same(a, b));
}

TEST_CASE("An empty image has no pixels, and no size is negative") {
  CHECK(GrayImage().empty());
  CHECK(GrayImage(0, 5).empty());
  CHECK_THROWS_AS(GrayImage(-1, 5), Error);
}
