// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/view.hpp"
#include "sweepkit/image/impl/blur_rows.hpp"

namespace sweepkit {

/// Smooths an 8-bit image by a 7x7 Gaussian with sigma 2 px, as ORB wants it before its comparisons.
/// Separable, weights of 7 bits, rounded to 8 bits after each direction; the border repeats the outermost
/// pixel. Keeps its row buffer between calls.
class GaussianBlur7 {
 public:
  static constexpr int kRadius = 3;

  /// `target` has the size of `source`; the views must not overlap.
  void operator()(GrayView source, View2d<std::uint8_t> target) {
    require(!source.empty(), "GaussianBlur7", "the image is empty", source.width);
    require(source.width == target.width && source.height == target.height, "GaussianBlur7",
            "sizes differ, target width", target.width);
    const int width = source.width;
    row_.resize(static_cast<std::size_t>(width) + 2 * kRadius);
    const auto row_at = [&](int y) {
      return source.row(y < 0 ? 0 : y < source.height ? y : source.height - 1);
    };
    for (int y = 0; y < source.height; ++y) {
      const std::uint8_t* rows[7];
      for (int i = 0; i < 7; ++i) rows[i] = row_at(y + i - kRadius);
      std::uint8_t* middle = row_.data() + kRadius;
      impl::blur_7_rows(rows, width, middle);
      for (int i = 1; i <= kRadius; ++i) {
        middle[-i] = middle[0];
        middle[width - 1 + i] = middle[width - 1];
      }
      const std::uint8_t* shifted[7];
      for (int i = 0; i < 7; ++i) shifted[i] = row_.data() + i;
      impl::blur_7_rows(shifted, width, target.row(y));
    }
  }

 private:
  std::vector<std::uint8_t> row_;
};

}  // namespace sweepkit
