// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/feature/orb.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <numbers>
#include <set>

#include "feature/scene.hpp"
#include "sweepkit/core/simd.hpp"

using namespace sweepkit;

namespace {

Features<256> extract(GrayView image, const OrbOptions& options = {}) {
  Features<256> features;
  OrbExtractor(options).extract(image, features);
  return features;
}

bool same_features(const Features<256>& a, const Features<256>& b) {
  if (a.size() != b.size()) return false;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const KeyPoint &p = a.keypoints[i], &q = b.keypoints[i];
    if (p.x != q.x || p.y != q.y || p.angle != q.angle || p.response != q.response || p.octave != q.octave ||
        a.descriptors[i] != b.descriptors[i])
      return false;
  }
  return true;
}

struct Pattern128 {
  static constexpr int kBits = 128;
  static constexpr auto kPairs = [] {
    std::array<PixelPair, kBits> pairs{};
    for (int i = 0; i < kBits; ++i) pairs[i] = OrbPattern::kPairs[i];
    return pairs;
  }();
};

}  // namespace

TEST_CASE("Both paths find identical features") {
  const auto [width, height] = GENERATE(table<int, int>({{640, 400}, {321, 203}, {97, 90}}));
  const GrayImage image = random_scene(width, height, 1);
  const Features<256> fast = extract(image);
  CHECK(fast.size() > 20);
  const ScopedSimdLevel level(SimdLevel::portable);
  CHECK(same_features(fast, extract(image)));
}

TEST_CASE("An extractor used again gives what a new one gives") {
  OrbExtractor extractor;
  Features<256> features;
  for (const std::uint32_t seed : {1, 2, 3}) {
    const GrayImage image = random_scene(300 + 20 * static_cast<int>(seed), 200, seed);
    extractor.extract(image, features);
    CHECK(same_features(features, extract(image)));
  }
}

TEST_CASE("As many key points as asked for, inside the image, on all levels") {
  const GrayImage image = random_scene(640, 400, 2);
  for (const int count : {1, 10, 500, 1000}) {
    OrbOptions options;
    options.count = count;
    const Features<256> f = extract(image, options);
    CHECK(f.size() == static_cast<std::size_t>(count));
    CHECK(f.descriptors.size() == f.keypoints.size());
    std::set<int> octaves;
    for (const KeyPoint& k : f.keypoints) {
      CHECK((k.x > 15 && k.y > 15 && k.x < 624 && k.y < 384));
      CHECK((k.angle > -4 && k.angle < 4));
      CHECK(k.response > 7);
      octaves.insert(k.octave);
    }
    if (count >= 500) CHECK(octaves.size() == 8);
  }
}

TEST_CASE("Key points cover the image evenly") {
  // Strong corners to the left, weak ones to the right.
  GrayImage image = random_scene(640, 400, 3);
  for (int y = 0; y < 400; ++y)
    for (int x = 320; x < 640; ++x) image(x, y) = static_cast<std::uint8_t>(100 + image(x, y) / 5);
  const Features<256> f = extract(image);
  int right = 0;
  for (const KeyPoint& k : f.keypoints) right += k.x >= 330;
  CHECK(right > 0.3 * f.size());
}

TEST_CASE("Turning the image by 90 degrees turns the key points") {
  const GrayImage image = random_scene(400, 300, 4);
  OrbOptions options;
  options.count = 2000;
  options.levels = 1;  // a turned image has other coarse levels
  const Features<256> a = extract(image, options), b = extract(turned(image), options);
  int found = 0, kept = 0;
  for (std::size_t i = 0; i < a.size(); ++i)
    for (std::size_t j = 0; j < b.size(); ++j) {
      const KeyPoint &p = a.keypoints[i], &q = b.keypoints[j];
      if (std::hypot(q.x - (299 - p.y), q.y - p.x) > 0.01) continue;
      ++found;
      const double turn = q.angle - p.angle - std::numbers::pi / 2;
      kept += std::abs(std::remainder(turn, 2 * std::numbers::pi)) < 1e-4 &&
              hamming_distance(a.descriptors[i], b.descriptors[j]) < 20;
    }
  // Of equal neighbours the first in reading order is kept, which is another one in a turned image.
  CHECK(found > 0.85 * a.size());
  CHECK(kept > 0.99 * found);
}

TEST_CASE("A brighter image has the same features") {
  GrayImage image = random_scene(320, 240, 5), brighter(320, 240);
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 320; ++x) {
      image(x, y) = static_cast<std::uint8_t>(image(x, y) / 2);
      brighter(x, y) = static_cast<std::uint8_t>(image(x, y) + 100);
    }
  const Features<256> a = extract(image), b = extract(brighter);
  REQUIRE(a.size() == b.size());
  int same_descriptor = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    CHECK((a.keypoints[i].x == b.keypoints[i].x && a.keypoints[i].y == b.keypoints[i].y));
    same_descriptor += hamming_distance(a.descriptors[i], b.descriptors[i]) <= 2;
  }
  // The disc of pixels is symmetric, so that the angle does not see the offset.
  CHECK(same_descriptor == static_cast<int>(a.size()));
}

TEST_CASE("Features come from a part of an image through its stride") {
  const GrayImage whole = random_scene(500, 400, 6);
  const GrayView part{whole.row(31) + 57, 333, 222, whole.stride()};
  CHECK(same_features(extract(part), extract(GrayImage(part))));
}

TEST_CASE("Flat, tiny and narrow images have no features") {
  GrayImage flat(640, 400);
  flat.fill(90);
  CHECK(extract(flat).size() == 0);
  CHECK(extract(random_image(10, 10, 1)).size() == 0);
  CHECK(extract(random_image(400, 30, 1)).size() == 0);
  CHECK(extract(random_image(1, 1, 1)).size() == 0);
  Features<256> features;
  CHECK_THROWS_AS(OrbExtractor().extract(GrayView{}, features), Error);
  OrbExtractor().extract(ImagePyramid(), features);
  CHECK(features.size() == 0);
}

TEST_CASE("Levels without room leave their share to the others") {
  OrbOptions options;
  options.count = 40;
  CHECK(extract(random_scene(100, 90, 1), options).size() == 40);
}

TEST_CASE("Noise of a dark image is no feature") {
  GrayImage dark(640, 400);
  const GrayImage noise = random_image(640, 400, 7);
  for (int y = 0; y < 400; ++y)
    for (int x = 0; x < 640; ++x) dark(x, y) = static_cast<std::uint8_t>(4 + noise(x, y) * 7 / 256);
  CHECK(extract(dark).size() == 0);
}

TEST_CASE("Options out of range are refused") {
  OrbOptions options;
  options.count = 0;
  CHECK_THROWS_AS(OrbExtractor(options), Error);
  options = {};
  options.scale_factor = std::numeric_limits<double>::quiet_NaN();
  CHECK_THROWS_AS(OrbExtractor(options), Error);
}

TEST_CASE("Other patterns give other descriptors of the same key points") {
  const GrayImage image = random_scene(320, 240, 8);
  Features<128> shorter;
  BasicOrbExtractor<Pattern128>().extract(image, shorter);
  const Features<256> full = extract(image);
  REQUIRE(shorter.size() == full.size());
  for (std::size_t i = 0; i < full.size(); ++i)
    for (int w = 0; w < 2; ++w) CHECK_FALSE(shorter.descriptors[i].words[w] != full.descriptors[i].words[w]);
}
