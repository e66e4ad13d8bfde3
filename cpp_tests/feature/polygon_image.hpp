// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "sweepkit/core/random.hpp"
#include "sweepkit/image/image.hpp"

namespace sweepkit {

struct Corner2d {
  double x, y;
};

/// A bright convex quadrangle on dark ground, or the other way round; each pixel is the mean over its area
/// (8x8 samples), softened by nothing else. Corners run clockwise as displayed (y down).
inline GrayImage quadrangle_image(int width, int height, const std::array<Corner2d, 4>& corners, int inside,
                                  int outside, double noise = 0) {
  GrayImage image(width, height);
  Random random(3);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      int hits = 0;
      for (int i = 0; i < 64; ++i) {
        const double u = x - 0.5 + (i % 8 + 0.5) / 8, v = y - 0.5 + (i / 8 + 0.5) / 8;
        bool in = true;
        for (int k = 0; k < 4; ++k) {
          const Corner2d &a = corners[k], &b = corners[(k + 1) % 4];
          in = in && (b.x - a.x) * (v - a.y) - (b.y - a.y) * (u - a.x) >= 0;
        }
        hits += in;
      }
      const double value =
          outside + (inside - outside) * hits / 64.0 + (noise > 0 ? noise * random.normal() : 0);
      image(x, y) = static_cast<std::uint8_t>(std::clamp(std::lround(value), 0L, 255L));
    }
  return image;
}

/// A square about the middle of the image, turned by `angle` [rad].
inline std::array<Corner2d, 4> turned_square(double cx, double cy, double half, double angle) {
  std::array<Corner2d, 4> corners;
  for (int k = 0; k < 4; ++k) {
    const double px = k == 0 || k == 3 ? -half : half, py = k < 2 ? -half : half;
    corners[k] = {cx + std::cos(angle) * px - std::sin(angle) * py,
                  cy + std::sin(angle) * px + std::cos(angle) * py};
  }
  return corners;
}

}  // namespace sweepkit
