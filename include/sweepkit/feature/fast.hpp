// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/view.hpp"
#include "sweepkit/feature/impl/fast_rows.hpp"
#include "sweepkit/image/image.hpp"

namespace sweepkit {

/// A corner of one pyramid level, in whole pixels of that level.
struct Corner {
  std::int16_t x = 0;
  std::int16_t y = 0;
  std::uint8_t score = 0;

  friend bool operator==(const Corner&, const Corner&) = default;
};

/// FAST-9 corners (E. Rosten and T. Drummond, "Machine learning for high-speed corner detection", ECCV 2006).
///
/// The score of a pixel is the largest s for which nine neighbouring pixels of its circle of 16 are all at
/// least s brighter, or all at least s darker. It is a corner for threshold t if s > t, and if no pixel of
/// its 3x3 neighbourhood scores higher (of equal neighbours the first in reading order is kept). Scores are
/// exact, so corners for a higher threshold are those with a higher score. Keeps its buffers between calls.
class FastDetector {
 public:
  static constexpr int kRadius = 3;  ///< of the circle [px]

  /// Corners at least `border` (3 or more) pixels from each side of the image, in reading order.
  /// @param threshold 0 to 254
  void detect(GrayView image, int threshold, int border, std::vector<Corner>& corners) {
    require(border >= kRadius, "FastDetector::detect", "the circle does not fit into the border", border);
    require(threshold >= 0 && threshold < 255, "FastDetector::detect", "threshold out of range", threshold);
    require(image.width <= INT16_MAX && image.height <= INT16_MAX, "FastDetector::detect",
            "image too large, larger side", std::max(image.width, image.height));
    corners.clear();
    const int columns = image.width - 2 * border;
    const int rows = image.height - 2 * border;
    if (columns <= 0 || rows <= 0) return;
    // A frame of zeros around the scores spares the comparison its special cases.
    scores_.resize(columns + 2, rows + 2);
    std::fill_n(scores_.row(0), columns + 2, std::uint8_t{0});
    std::fill_n(scores_.row(rows + 1), columns + 2, std::uint8_t{0});
    positions_.resize(static_cast<std::size_t>(columns) + 1);
    for (int y = 0; y <= rows; ++y) {
      if (y < rows) {
        std::uint8_t* scores = scores_.row(y + 1);
        impl::fast_score_row(image.row(y + border) + border, image.stride, columns, threshold, scores + 1);
        scores[0] = scores[columns + 1] = 0;
      }
      if (y == 0) continue;
      const std::uint8_t* centre = scores_.row(y) + 1;
      const int found = impl::local_maxima(centre, scores_.stride(), columns, positions_.data());
      for (int i = 0; i < found; ++i)
        corners.push_back({static_cast<std::int16_t>(positions_[i] + border),
                           static_cast<std::int16_t>(y - 1 + border), centre[positions_[i]]});
    }
  }

 private:
  GrayImage scores_;
  std::vector<std::int16_t> positions_;
};

/// The FAST-9 score of one pixel at least 3 px inside the image, see FastDetector.
inline int fast_score(GrayView image, int x, int y) {
  return impl::fast_score(image.row(y) + x, impl::circle_offsets(image.stride));
}

}  // namespace sweepkit
