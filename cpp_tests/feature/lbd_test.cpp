// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/feature/lbd.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "feature/scene.hpp"
#include "sweepkit/feature/line_extractor.hpp"

using namespace sweepkit;

namespace {

LineDescriptor describe(GrayView image, float x1, float y1, float x2, float y2) {
  EdgeMap map;
  map.build<std::uint8_t>(image, EdgeMap::kNoRidges);
  return Lbd().describe(map, x1, y1, x2, y2);
}

/// Means and spreads of the paper, pixel by pixel, in double precision; sorted out into bits as documented.
LineDescriptor describe_slowly(GrayView image, double x1, double y1, double x2, double y2) {
  EdgeMap map;
  map.build<std::uint8_t>(image, EdgeMap::kNoRidges);
  const double length = std::hypot(x2 - x1, y2 - y1), c = (x2 - x1) / length, s = (y2 - y1) / length;
  const int columns = std::min(Lbd::kMaxColumns, (static_cast<int>(length) + 7) / 8 * 8);
  double rows[63][4] = {};
  for (int r = 0; r < 63; ++r)
    for (int k = 0; k < columns; ++k) {
      const double t = length * (k + 0.5) / columns, off = r - 31;
      const int x = std::clamp(static_cast<int>(std::floor(x1 + t * c - off * s + 0.5)), 0, image.width - 1);
      const int y = std::clamp(static_cast<int>(std::floor(y1 + t * s + off * c + 0.5)), 0, image.height - 1);
      const auto g = map.gradient()(x, y);
      const double along = g.x * c + g.y * s, across = -g.x * s + g.y * c;
      rows[r][0] += std::max(across, 0.0);
      rows[r][1] += std::max(-across, 0.0);
      rows[r][2] += std::max(along, 0.0);
      rows[r][3] += std::max(-along, 0.0);
    }
  double bands[9][8];
  for (int b = 0; b < 9; ++b)
    for (int i = 0; i < 4; ++i) {
      double sum = 0, squares = 0;
      int count = 0;
      for (int r = std::max(0, 7 * b - 7); r < std::min(63, 7 * b + 14); ++r, ++count) {
        const double global = (r - 31) / 31.0, local = (r - (7 * b + 3)) / 7.0;
        const double v = std::exp(-0.5 * (global * global + local * local)) * rows[r][i];
        sum += v;
        squares += v * v;
      }
      bands[b][i] = sum / count;
      bands[b][4 + i] = std::sqrt(std::max(0.0, squares / count - bands[b][i] * bands[b][i]));
    }
  std::vector<bool> bits;
  for (const auto& v : bands)
    for (const bool more : {v[0] > v[1], v[2] > v[3], v[0] > v[2], v[0] > v[3], v[1] > v[2], v[1] > v[3],
                            v[2] + v[3] > v[0] + v[1], v[4] > v[5], v[6] > v[7]})
      bits.push_back(more);
  for (int apart = 1; apart <= 4; ++apart)
    for (int b = 0; b + apart < 9; ++b)
      for (int i = 0; i < 8; ++i) bits.push_back(bands[b][i] > bands[b + apart][i]);
  LineDescriptor descriptor;
  for (int i = 0; i < 256; ++i) descriptor.words[i / 64] |= static_cast<std::uint64_t>(bits[i]) << (i % 64);
  return descriptor;
}

struct Ends {
  float x1, y1, x2, y2;
};

std::vector<Ends> some_ends(int width, int height) {
  std::vector<Ends> ends;
  for (int i = 0; i < 40; ++i) {
    const double angle = i * 0.7, length = 5 + 3.3 * i;
    const float x = static_cast<float>(width * (0.1 + 0.021 * i)),
                y = static_cast<float>(height * (0.9 - 0.02 * i));
    ends.push_back({x, y, x + static_cast<float>(length * std::cos(angle)),
                    y + static_cast<float>(length * std::sin(angle))});
  }
  return ends;
}

}  // namespace

TEST_CASE("A descriptor is as defined, on every path, inside the image and beyond its sides") {
  const GrayImage image = random_scene(230, 170, 4);
  int bits = 0, count = 0;
  for (const Ends& e : some_ends(230, 170)) {
    const LineDescriptor fast = describe(image, e.x1, e.y1, e.x2, e.y2);
    {
      const ScopedSimdLevel level(SimdLevel::portable);
      CHECK(fast == describe(image, e.x1, e.y1, e.x2, e.y2));
    }
    // Numbers rounded to integers and nearly equal ones may differ in a bit.
    const int distance = hamming_distance(fast, describe_slowly(image, e.x1, e.y1, e.x2, e.y2));
    CHECK(distance <= 12);
    bits += distance;
    ++count;
  }
  CHECK(bits <= 3 * count);
}

TEST_CASE("A turned image gives nearly the same descriptor, the other direction quite another") {
  const GrayImage image = random_scene(200, 160, 9), other = turned(image);
  for (const Ends& e : {Ends{60, 70, 100, 80}, Ends{120, 40, 90, 90}, Ends{50, 100, 130, 101}}) {
    const LineDescriptor here = describe(image, e.x1, e.y1, e.x2, e.y2);
    CHECK(hamming_distance(here, describe(other, 159 - e.y1, e.x1, 159 - e.y2, e.x2)) <= 24);
    CHECK(hamming_distance(here, describe(image, e.x2, e.y2, e.x1, e.y1)) >= 60);
  }
}

TEST_CASE("Contrast and brightness hardly change a descriptor") {
  const GrayImage image = random_scene(200, 160, 10);
  GrayImage dim(200, 160);
  for (int y = 0; y < 160; ++y)
    for (int x = 0; x < 200; ++x) dim(x, y) = static_cast<std::uint8_t>(40 + image(x, y) / 3);
  int bits = 0, count = 0;
  for (const Ends& e : some_ends(200, 160)) {
    const int distance =
        hamming_distance(describe(image, e.x1, e.y1, e.x2, e.y2), describe(dim, e.x1, e.y1, e.x2, e.y2));
    CHECK(distance <= 48);
    bits += distance;
    ++count;
  }
  CHECK(bits <= 16 * count);
}

TEST_CASE("What cannot be described has no bit set, and nothing is read outside") {
  const GrayImage image = random_scene(64, 48, 2);
  const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
  for (const Ends& e : {Ends{5, 5, 5, 5}, Ends{5, 5, 5.5f, 5.5f}, Ends{nan, 5, 20, 20}, Ends{5, 5, inf, 20},
                        Ends{5, -inf, 20, 20}, Ends{5, 5, 20000, 20}})
    CHECK(describe(image, e.x1, e.y1, e.x2, e.y2) == LineDescriptor{});
  CHECK(describe(GrayView{}, 5, 5, 20, 20) == LineDescriptor{});
  for (const Ends& e : {Ends{-500, -500, -400, -450}, Ends{16000, 16000, -16000, -16000}, Ends{0, 0, 63, 47},
                        Ends{-3, 20, 80, 20}, Ends{16384, 16384, 16300, 16384}}) {
    const LineDescriptor fast = describe(image, e.x1, e.y1, e.x2, e.y2);
    const ScopedSimdLevel level(SimdLevel::portable);
    CHECK(fast == describe(image, e.x1, e.y1, e.x2, e.y2));
  }
}

TEST_CASE("Lines of all octaves stand in the coordinates of the image") {
  const GrayImage image = random_scene(320, 240, 5, 0);
  LineExtractor extractor;
  LineFeatures<256> lines;
  extractor.extract(image, lines);
  REQUIRE(lines.size() == lines.descriptors.size());
  // Coarse segments lie on fine ones.
  int coarse = 0, near = 0;
  for (const LineSegment& s : lines.segments) {
    if (s.octave == 0 || s.length() < 25) continue;
    ++coarse;
    bool found = false;
    for (const LineSegment& t : lines.segments) {
      const float cross = s.dx() * t.dy() - s.dy() * t.dx(), dot = s.dx() * t.dx() + s.dy() * t.dy();
      if (t.octave != 0 || dot <= 0 || std::abs(cross) > 0.1f * dot) continue;
      const float mx = 0.5f * (s.x1 + s.x2) - t.x1, my = 0.5f * (s.y1 + s.y2) - t.y1;
      found = found || std::abs(mx * t.dy() - my * t.dx()) < 1.0f * t.length();
    }
    near += found;
  }
  CHECK(coarse > 10);
  CHECK(near > 0.8 * coarse);
  // The same segments described again have the same descriptors but for what their coordinates were rounded.
  ImagePyramid pyramid;
  pyramid.build(image, extractor.options().octaves, extractor.options().scale_factor);
  std::vector<LineDescriptor> again;
  extractor.describe(pyramid, lines.segments, again);
  REQUIRE(again.size() == lines.size());
  int bits = 0;
  for (std::size_t i = 0; i < again.size(); ++i) bits += hamming_distance(again[i], lines.descriptors[i]);
  CHECK(bits <= static_cast<int>(again.size()));
  extractor.describe(pyramid, {}, again);
  CHECK(again.empty());
}

TEST_CASE("An image at two sizes gives lines that match where they lie") {
  const GrayImage image = random_scene(480, 360, 6, 1);
  ImagePyramid pyramid;
  pyramid.build(image, 2, 1.5);
  LineFeatures<256> first, second;
  LineExtractor extractor;
  extractor.extract(image, first);
  extractor.extract(GrayImage(pyramid.level(1)), second);
  int right = 0, tried = 0;
  for (std::size_t j = 0; j < second.size(); ++j) {
    if (second.segments[j].octave != 0 || second.segments[j].length() < 20) continue;
    std::size_t best = 0;
    for (std::size_t i = 1; i < first.size(); ++i)
      if (hamming_distance(second.descriptors[j], first.descriptors[i]) <
          hamming_distance(second.descriptors[j], first.descriptors[best]))
        best = i;
    const LineSegment &s = second.segments[j], &t = first.segments[best];
    const float mx = pyramid.to_full_x(1, 0.5f * (s.x1 + s.x2)) - t.x1,
                my = pyramid.to_full_y(1, 0.5f * (s.y1 + s.y2)) - t.y1;
    right += std::abs(mx * t.dy() - my * t.dx()) < 3 * t.length();
    ++tried;
  }
  CHECK(tried > 20);
  CHECK(right > 0.9 * tried);
}

TEST_CASE("Extraction of lines copes with images that have none") {
  LineExtractor extractor;
  LineFeatures<256> lines;
  lines.segments.resize(3);
  extractor.extract(GrayView{}, lines);
  CHECK(lines.size() == 0);
  GrayImage flat(50, 40);
  flat.fill(255);
  extractor.extract(flat, lines);
  CHECK(lines.size() == 0);
  extractor.extract(random_image(2, 2, 1), lines);
  CHECK(lines.size() == 0);
  CHECK(lines.descriptors.empty());
  LineOptions options;
  options.octaves = 0;
  CHECK_THROWS_AS(LineExtractor(options), Error);
  options = {};
  options.segments.tolerance = -1;
  CHECK_THROWS_AS(LineExtractor(options), Error);
}
