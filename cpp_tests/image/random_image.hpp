// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <random>

#include "sweepkit/image/image.hpp"

namespace sweepkit {

/// White noise over all grey values.
inline GrayImage random_image(int width, int height, std::uint32_t seed) {
  std::mt19937 random(seed);
  GrayImage image(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) image(x, y) = static_cast<std::uint8_t>(random() >> 24);
  return image;
}

/// Rectangles of random grey over each other, with a little noise: corners of all sizes.
inline GrayImage random_scene(int width, int height, std::uint32_t seed, int noise = 3) {
  std::mt19937 random(seed);
  const auto below = [&](int n) { return static_cast<int>(random() % static_cast<std::uint32_t>(n)); };
  GrayImage image(width, height);
  image.fill(100);
  for (int i = 0; i < width * height / 300; ++i) {
    const int x0 = below(width), y0 = below(height), value = 10 + below(230);
    const int x1 = std::min(width, x0 + 3 + below(40)), y1 = std::min(height, y0 + 3 + below(40));
    for (int y = y0; y < y1; ++y)
      std::fill(image.row(y) + x0, image.row(y) + x1, static_cast<std::uint8_t>(value));
  }
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      image(x, y) = static_cast<std::uint8_t>(image(x, y) + below(2 * noise + 1) - noise);
  return image;
}

inline bool same(GrayView a, GrayView b) {
  if (a.width != b.width || a.height != b.height) return false;
  for (int y = 0; y < a.height; ++y)
    if (!std::equal(a.row(y), a.row(y) + a.width, b.row(y))) return false;
  return true;
}

}  // namespace sweepkit
