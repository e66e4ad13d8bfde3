// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <vector>

#include "sweepkit/core/view.hpp"
#include "sweepkit/image/image.hpp"

namespace sweepkit {

/// A squared distance farther than any in an image; where nothing is marked.
inline constexpr std::int64_t kNoDistance = std::numeric_limits<std::int64_t>::max();

/// The squared distance of each pixel's centre to that of the nearest marked (not zero) pixel, exact and in
/// whole numbers, in time proportional to the pixels: Meijster, Roerdink and Hesselink, A general algorithm
/// for computing distance transforms in linear time (2000). kNoDistance everywhere if no pixel is marked.
/// @param marked of any size below 2^30 in each direction
inline void distance_transform(GrayView marked, Image<std::int64_t>& squared) {
  const int width = std::max(marked.width, 0), height = std::max(marked.height, 0);
  squared.resize(width, height);
  if (marked.empty()) return;
  constexpr std::int64_t kFar = std::int64_t{1} << 31;
  // Along columns: the distance to the nearest marked pixel of the column; kept in the result.
  for (int x = 0; x < width; ++x) squared(x, 0) = marked(x, 0) ? 0 : kFar;
  for (int y = 1; y < height; ++y)
    for (int x = 0; x < width; ++x) squared(x, y) = marked(x, y) ? 0 : std::min(kFar, squared(x, y - 1) + 1);
  for (int y = height - 2; y >= 0; --y)
    for (int x = 0; x < width; ++x) squared(x, y) = std::min(squared(x, y), squared(x, y + 1) + 1);
  // Along rows: the lower envelope of parabolas (x - i)^2 + g(i)^2.
  std::vector<std::int64_t> column(static_cast<std::size_t>(width)), start(column.size()), g(column.size());
  for (int y = 0; y < height; ++y) {
    std::int64_t* row = squared.row(y);
    std::copy_n(row, width, g.begin());
    const auto value = [&](std::int64_t x, std::int64_t i) {
      const std::int64_t h = g[static_cast<std::size_t>(i)];
      return h >= kFar ? kNoDistance : (x - i) * (x - i) + h * h;
    };
    // The first place where the parabola of u is lower than that of i < u.
    const auto crossing = [&](std::int64_t i, std::int64_t u) {
      const std::int64_t a = g[static_cast<std::size_t>(i)], b = g[static_cast<std::size_t>(u)];
      const std::int64_t over = u * u - i * i + b * b - a * a, twice = 2 * (u - i);
      return (over >= 0 ? over / twice : -((-over + twice - 1) / twice)) + 1;
    };
    int top = -1;
    for (std::int64_t u = 0; u < width; ++u) {
      if (g[static_cast<std::size_t>(u)] >= kFar) continue;
      while (top >= 0 && value(start[top], column[top]) > value(start[top], u)) --top;
      const std::int64_t from = top < 0 ? 0 : crossing(column[top], u);
      if (from >= width) continue;
      ++top;
      column[top] = u;
      start[top] = std::max<std::int64_t>(from, 0);
    }
    if (top < 0) {
      std::fill_n(row, width, kNoDistance);
      continue;
    }
    for (std::int64_t x = width - 1; x >= 0; --x) {
      row[x] = value(x, column[top]);
      if (x == start[top]) --top;
    }
  }
}

}  // namespace sweepkit
