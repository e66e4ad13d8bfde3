// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/feature/segments.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "feature/polygon_image.hpp"
#include "feature/scene.hpp"

using namespace sweepkit;

namespace {

std::vector<LineSegment> segments_of(GrayView image, const SegmentOptions& options = {}) {
  std::vector<LineSegment> segments;
  SegmentDetector(options).detect(image, segments);
  return segments;
}

double off_line(const LineSegment& s, double x, double y) {
  return ((x - s.x1) * s.dy() - (y - s.y1) * s.dx()) / s.length();
}

GrayImage noise_image(int width, int height, std::uint64_t seed, double sigma) {
  GrayImage image(width, height);
  Random random(seed);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      image(x, y) =
          static_cast<std::uint8_t>(std::clamp(std::lround(128 + sigma * random.normal()), 0L, 255L));
  return image;
}

}  // namespace

TEST_CASE("The sides of a square are found to a part of a pixel, dark on their left") {
  const bool bright = GENERATE(true, false);
  for (int degrees = 0; degrees < 90; degrees += 7) {
    const auto corners = turned_square(80.3, 74.6, 45, degrees * std::numbers::pi / 180);
    const GrayImage image = quadrangle_image(160, 150, corners, bright ? 180 : 60, bright ? 60 : 180);
    const auto segments = segments_of(image);
    CAPTURE(degrees, bright);
    REQUIRE(segments.size() == 4);
    for (int k = 0; k < 4; ++k) {
      // Clockwise the inside lies on the right hand.
      Corner2d a = corners[k], b = corners[(k + 1) % 4];
      if (!bright) std::swap(a, b);
      bool found = false;
      for (const LineSegment& s : segments) {
        if (std::hypot(s.x1 - a.x, s.y1 - a.y) > 6 || std::hypot(s.x2 - b.x, s.y2 - b.y) > 6) continue;
        found = true;
        // The whole line to a tenth of a pixel; corners are rounded by smoothing.
        CHECK(std::abs(off_line(s, a.x, a.y)) < 0.12);
        CHECK(std::abs(off_line(s, b.x, b.y)) < 0.12);
        CHECK(s.length() > 82);
        CHECK(s.width < 0.5f);
        CHECK(s.contrast > 20);
        CHECK(s.response > 0);
        CHECK(s.octave == 0);
      }
      CHECK(found);
    }
  }
}

TEST_CASE("Noise on the edge costs little of its place") {
  double sum = 0;
  int count = 0;
  for (int degrees = 3; degrees < 90; degrees += 20) {
    const auto corners = turned_square(80, 75, 45, degrees * std::numbers::pi / 180);
    for (const LineSegment& s : segments_of(quadrangle_image(160, 150, corners, 170, 90, 8))) {
      if (s.length() < 40) continue;
      double best = 1e9;
      for (int k = 0; k < 4; ++k) {
        const Corner2d &a = corners[k], &b = corners[(k + 1) % 4];
        best = std::min(best, std::max(std::abs(off_line(s, a.x, a.y)), std::abs(off_line(s, b.x, b.y))));
      }
      sum += best;
      ++count;
    }
  }
  CHECK(count >= 20);
  CHECK(sum / count < 0.35);
}

TEST_CASE("White noise holds hardly any segment") {
  for (const double sigma : {5.0, 20.0, 60.0}) {
    std::size_t count = 0;
    for (int i = 0; i < 10; ++i) count += segments_of(noise_image(320, 240, i, sigma)).size();
    CAPTURE(sigma);
    CHECK(count <= 10);  // max_false_alarms = 1 in an image
  }
  // Without the control there are many.
  std::size_t count = 0;
  for (int i = 0; i < 10; ++i) {
    std::vector<LineSegment> segments;
    BasicSegmentDetector<std::uint8_t, NoValidation>().detect(noise_image(320, 240, i, 20), segments);
    count += segments.size();
  }
  CHECK(count > 50);
}

TEST_CASE("Segments are the same on every path, through strides, and for every type of pixel") {
  for (const int width : {37, 64, 163}) {
    const GrayImage whole = random_scene(width + 30, 90, 7);
    const GrayView view{whole.row(9) + 13, width, 71, whole.stride()};
    SegmentOptions options;
    options.min_length = 8;
    options.max_false_alarms = 1e3;
    const auto segments = segments_of(view, options);
    CHECK_FALSE(segments.empty());
    CHECK(segments == segments_of(GrayImage(view), options));
    {
      const ScopedSimdLevel level(SimdLevel::portable);
      CHECK(segments == segments_of(view, options));
    }
    Image<std::uint16_t> sixteen(width, 71);
    Image<float> real(width, 71);
    for (int y = 0; y < 71; ++y)
      for (int x = 0; x < width; ++x) {
        sixteen(x, y) = static_cast<std::uint16_t>(257 * view(x, y));
        real(x, y) = view(x, y);
      }
    std::vector<LineSegment> others;
    BasicSegmentDetector<std::uint16_t, NumberOfFalseAlarms>(options).detect(sixteen, others);
    CHECK(others == segments);
    BasicSegmentDetector<float, NumberOfFalseAlarms>(options).detect(real, others);
    CHECK(others == segments);
    {
      const ScopedSimdLevel level(SimdLevel::portable);
      BasicSegmentDetector<float, NumberOfFalseAlarms>(options).detect(real, others);
      CHECK(others == segments);
    }
  }
}

TEST_CASE("A detector used again forgets the image before") {
  SegmentDetector detector;
  std::vector<LineSegment> segments, again;
  const GrayImage image = random_scene(200, 150, 3), other = random_scene(230, 90, 4);
  detector.detect(image, segments);
  detector.detect(other, again);
  detector.detect(image, again);
  CHECK(segments == again);
}

TEST_CASE("A gap in an edge is bridged where it is shorter than max_gap") {
  GrayImage image(200, 60);
  for (int y = 0; y < 60; ++y)
    for (int x = 0; x < 200; ++x) image(x, y) = y < 30 || (x >= 97 && x < 103) ? 60 : 180;
  SegmentOptions options;
  options.max_gap = 0;
  const auto apart = segments_of(image, options);
  const auto joined = segments_of(image);
  const auto longest = [](const std::vector<LineSegment>& segments) {
    float most = 0;
    for (const LineSegment& s : segments) most = std::max(most, s.length());
    return most;
  };
  CHECK(longest(apart) < 100);
  CHECK(longest(joined) > 185);
}

TEST_CASE("Images without edges, without room, or with absurd pixels give no segments and no crash") {
  std::vector<LineSegment> segments(3);
  SegmentDetector detector;
  for (const int value : {0, 128, 255}) {
    GrayImage flat(100, 80);
    flat.fill(static_cast<std::uint8_t>(value));
    detector.detect(flat, segments);
    CHECK(segments.empty());
  }
  for (const auto& [w, h] : {std::pair{1, 1}, {4, 100}, {100, 4}, {5, 5}, {3, 300}}) {
    detector.detect(random_image(w, h, 1), segments);
    CHECK(segments.empty());
  }
  detector.detect(GrayView{}, segments);
  CHECK(segments.empty());
  detector.detect(GrayView{nullptr, -3, 10, 0}, segments);
  CHECK(segments.empty());
  Image<float> absurd(60, 60);
  for (int y = 0; y < 60; ++y)
    for (int x = 0; x < 60; ++x)
      absurd(x, y) = x % 3 == 0   ? std::numeric_limits<float>::quiet_NaN()
                     : x % 3 == 1 ? std::numeric_limits<float>::infinity()
                                  : -1e30f;
  BasicSegmentDetector<float, NumberOfFalseAlarms>().detect(absurd, segments);
  for (const LineSegment& s : segments) CHECK(std::isfinite(s.length()));
  // Black and white as far apart as they can be: nothing overflows.
  GrayImage board(96, 96);
  for (int y = 0; y < 96; ++y)
    for (int x = 0; x < 96; ++x) board(x, y) = (x / 32 + y / 32) % 2 ? 255 : 0;
  detector.detect(board, segments);
  CHECK(segments.size() >= 4);
  for (const LineSegment& s : segments) CHECK(s.contrast > 40);
}

TEST_CASE("A single line gives one segment, parallel ones one each") {
  const auto stripes = [](int count) {
    GrayImage image(120, 120);
    for (int y = 0; y < 120; ++y)
      for (int x = 0; x < 120; ++x)
        image(x, y) = static_cast<std::uint8_t>(40 + 40 * std::min(x / 20, count));
    return image;
  };
  CHECK(segments_of(stripes(0)).empty());
  CHECK(segments_of(stripes(1)).size() == 1);
  const auto five = segments_of(stripes(5));
  REQUIRE(five.size() == 5);
  for (const LineSegment& s : five) {
    CHECK(std::abs(s.dx()) < 0.01f);
    CHECK(s.dy() < -100);  // bright on the right hand: upwards
  }
}

TEST_CASE("The detector refuses impossible options") {
  SegmentOptions options;
  options.threshold = 0;
  CHECK_THROWS_AS(SegmentDetector(options), Error);
  options = {};
  options.max_false_alarms = std::numeric_limits<double>::quiet_NaN();
  CHECK_THROWS_AS(SegmentDetector(options), Error);
}
