// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/image/pyramid.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>

#include "image/random_image.hpp"

using namespace sweepkit;

TEST_CASE("Level 0 of a pyramid is the image, the others shrink by the factor") {
  const GrayImage image = random_image(641, 403, 1);
  ImagePyramid pyramid;
  CHECK(pyramid.empty());
  pyramid.build(image, 8, 1.2);
  REQUIRE(pyramid.levels() == 8);
  CHECK(same(pyramid.level(0), image));
  for (int l = 0; l < 8; ++l) {
    CHECK(pyramid.level(l).width == std::lround(641 / std::pow(1.2, l)));
    CHECK(pyramid.level(l).height == std::lround(403 / std::pow(1.2, l)));
    CHECK(pyramid.level(l).stride == pyramid.stride());
    CHECK(pyramid.scale(l) == Approx(std::pow(1.2, l)));
    // Both outer corners of the image are those of each level.
    CHECK(pyramid.to_full_x(l, -0.5f) == Approx(-0.5f).margin(1e-5));
    CHECK(pyramid.to_full_x(l, pyramid.level(l).width - 0.5f) == Approx(640.5f));
    CHECK(pyramid.to_full_y(l, pyramid.level(l).height - 0.5f) == Approx(402.5f));
    CHECK(pyramid.to_level_x(l, pyramid.to_full_x(l, 12.25f)) == Approx(12.25f));
    CHECK(pyramid.to_level_y(l, pyramid.to_full_y(l, 12.25f)) == Approx(12.25f));
  }
}

TEST_CASE("A place keeps its coordinates through all levels") {
  // On a slope the grey value tells the coordinate.
  GrayImage image(240, 160);
  for (int y = 0; y < 160; ++y)
    for (int x = 0; x < 240; ++x) image(x, y) = static_cast<std::uint8_t>(x);
  ImagePyramid pyramid;
  pyramid.build(image, 8, 1.2);
  for (int l = 1; l < 8; ++l) {
    const GrayView level = pyramid.level(l);
    double sum = 0;
    for (int x = 2; x < level.width - 2; ++x) sum += level(x, level.height / 2) - pyramid.to_full_x(l, x);
    // Each level rounds halves up.
    CHECK(std::abs(sum / (level.width - 4)) < 0.2);
  }
}

TEST_CASE("A pyramid keeps its memory for images of one size") {
  ImagePyramid pyramid;
  pyramid.build(random_image(200, 150, 1), 4, 1.5);
  const std::uint8_t* before[4];
  for (int l = 0; l < 4; ++l) before[l] = pyramid.level(l).data;
  const GrayImage other = random_image(200, 150, 2);
  pyramid.build(other, 4, 1.5);
  for (int l = 0; l < 4; ++l) CHECK(pyramid.level(l).data == before[l]);
  CHECK(same(pyramid.level(0), other));
}

TEST_CASE("A pyramid of a tiny image ends in single pixels") {
  ImagePyramid pyramid;
  pyramid.build(random_image(3, 2, 1), 8, 2.0);
  CHECK(pyramid.level(7).width == 1);
  CHECK(pyramid.level(7).height == 1);
}

TEST_CASE("A pyramid refuses what it cannot build") {
  ImagePyramid pyramid;
  const GrayImage image = random_image(10, 10, 1);
  CHECK_THROWS_AS(pyramid.build(GrayView{}, 8, 1.2), Error);
  CHECK_THROWS_AS(pyramid.build(image, 0, 1.2), Error);
  CHECK_THROWS_AS(pyramid.build(image, 1000, 1.2), Error);
  CHECK_THROWS_AS(pyramid.build(image, 8, 1.0), Error);
  CHECK_THROWS_AS(pyramid.build(image, 8, std::numeric_limits<double>::quiet_NaN()), Error);
}
