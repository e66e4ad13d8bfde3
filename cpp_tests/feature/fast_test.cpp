// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/feature/fast.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <cstdlib>
#include <vector>

#include "feature/scene.hpp"
#include "sweepkit/core/simd.hpp"

using namespace sweepkit;

namespace {

constexpr int kCircle[16][2] = {{0, 3},  {1, 3},   {2, 2},   {3, 1},   {3, 0},  {3, -1}, {2, -2}, {1, -3},
                                {0, -3}, {-1, -3}, {-2, -2}, {-3, -1}, {-3, 0}, {-3, 1}, {-2, 2}, {-1, 3}};

/// The segment test of the paper, word by word.
bool is_corner(GrayView image, int x, int y, int threshold) {
  for (const int sign : {1, -1})
    for (int first = 0; first < 16; ++first) {
      bool all = true;
      for (int i = 0; i < 9; ++i) {
        const auto [dx, dy] = kCircle[(first + i) % 16];
        all = all && sign * (image(x + dx, y + dy) - image(x, y)) > threshold;
      }
      if (all) return true;
    }
  return false;
}

int score_by_test(GrayView image, int x, int y) {
  int score = 0;
  while (is_corner(image, x, y, score)) ++score;
  return score;
}

std::vector<Corner> detect_slowly(GrayView image, int threshold, int border) {
  const auto score = [&](int x, int y) {
    if (x < border || y < border || x >= image.width - border || y >= image.height - border) return 0;
    const int s = score_by_test(image, x, y);
    return s > threshold ? s : 0;
  };
  std::vector<Corner> corners;
  for (int y = border; y < image.height - border; ++y)
    for (int x = border; x < image.width - border; ++x) {
      const int s = score(x, y);
      bool best = s > 0;
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) {
          const bool before = dy < 0 || (dy == 0 && dx < 0);
          if (dx != 0 || dy != 0)
            best = best && (before ? s > score(x + dx, y + dy) : s >= score(x + dx, y + dy));
        }
      if (best)
        corners.push_back(
            {static_cast<std::int16_t>(x), static_cast<std::int16_t>(y), static_cast<std::uint8_t>(s)});
    }
  return corners;
}

}  // namespace

TEST_CASE("The FAST score is the first threshold at which the segment test fails") {
  const GrayImage image = random_scene(60, 40, 1, 10);
  for (int y = 3; y < 37; ++y)
    for (int x = 3; x < 57; ++x) {
      const bool same = fast_score(image, x, y) == score_by_test(image, x, y);
      CHECK_FALSE(!same);
    }
}

TEST_CASE("Detected corners are those of the segment test, on every path") {
  const auto [width, height] = GENERATE(table<int, int>({{103, 41}, {64, 20}, {38, 38}, {20, 9}, {7, 7}}));
  const int threshold = GENERATE(0, 1, 7, 20, 60, 200, 254);
  const int border = GENERATE(3, 5);
  for (const bool noise : {false, true}) {
    const GrayImage image = noise ? random_image(width, height, 5) : random_scene(width, height, 6);
    std::vector<Corner> fast, portable;
    FastDetector().detect(image, threshold, border, fast);
    {
      const ScopedSimdLevel level(SimdLevel::portable);
      FastDetector().detect(image, threshold, border, portable);
    }
    const auto slow = detect_slowly(image, threshold, border);
    CHECK(fast == slow);
    CHECK(portable == slow);
  }
}

TEST_CASE("A detector used again forgets the image before, and reads through strides") {
  FastDetector detector;
  std::vector<Corner> first, part, copied;
  const GrayImage whole = random_scene(150, 90, 7);
  detector.detect(whole, 10, 3, first);
  const GrayView view{whole.row(13) + 29, 77, 51, whole.stride()};
  detector.detect(view, 10, 4, part);
  FastDetector().detect(GrayImage(view), 10, 4, copied);
  CHECK(part == copied);
  CHECK_FALSE(part.empty());
}

TEST_CASE("Images without room or without contrast have no corners") {
  std::vector<Corner> corners{{1, 2, 3}};
  FastDetector().detect(random_image(6, 50, 1), 5, 3, corners);
  CHECK(corners.empty());
  FastDetector().detect(GrayView{}, 5, 3, corners);
  CHECK(corners.empty());
  GrayImage flat(100, 100);
  for (const int value : {0, 128, 255}) {
    flat.fill(static_cast<std::uint8_t>(value));
    FastDetector().detect(flat, 0, 3, corners);
    CHECK(corners.empty());
  }
}

TEST_CASE("A detector refuses a border within the circle and impossible thresholds") {
  std::vector<Corner> corners;
  const GrayImage image(20, 20);
  CHECK_THROWS_AS(FastDetector().detect(image, 5, 2, corners), Error);
  CHECK_THROWS_AS(FastDetector().detect(image, -1, 3, corners), Error);
  CHECK_THROWS_AS(FastDetector().detect(image, 255, 3, corners), Error);
}

TEST_CASE("Refinement follows a spot that moves by parts of a pixel") {
  // A soft bright spot: the score peaks where the spot is.
  double error = 0, error_unrefined = 0;
  int found = 0;
  for (double dx = -0.4; dx <= 0.4; dx += 0.2)
    for (double dy = -0.4; dy <= 0.4; dy += 0.2) {
      GrayImage image(31, 31);
      for (int y = 0; y < 31; ++y)
        for (int x = 0; x < 31; ++x) {
          const double r2 = (x - 15 - dx) * (x - 15 - dx) + (y - 15 - dy) * (y - 15 - dy);
          image(x, y) = static_cast<std::uint8_t>(std::lround(40 + 180 * std::exp(-r2 / 4.5)));
        }
      FastDetector detector;
      std::vector<Corner> corners;
      detector.detect(image, 20, 3, corners);
      REQUIRE(corners.size() == 1);
      const SubPixel offset = detector.refine(corners[0]);
      CHECK(std::abs(offset.x) <= 0.5f);
      CHECK(std::abs(offset.y) <= 0.5f);
      error += std::hypot(corners[0].x + offset.x - 15 - dx, corners[0].y + offset.y - 15 - dy);
      error_unrefined += std::hypot(corners[0].x - 15 - dx, corners[0].y - 15 - dy);
      ++found;
    }
  CHECK(error / found < 0.5 * error_unrefined / found);
}
