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

/// From a pixel's centre to a place within the pixel [px].
struct SubPixel {
  float x = 0;
  float y = 0;
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
    border_ = border;
    const int columns = image.width - 2 * border;
    const int rows = image.height - 2 * border;
    if (columns <= 0 || rows <= 0) return;
    // A frame of zeros around the scores spares the comparison its special cases.
    scores_.resize(columns + 2, rows + 2);
    std::fill_n(scores_.row(0), columns + 2, std::uint8_t{0});
    std::fill_n(scores_.row(rows + 1), columns + 2, std::uint8_t{0});
    positions_.resize(static_cast<std::size_t>(columns) + impl::kMaximaSlack);
    for (int y = 0; y <= rows; ++y) {
      if (y < rows) {
        std::uint8_t* scores = scores_.row(y + 1);
        impl::fast_score_row(image.row(y + border) + border, image.stride, columns, threshold, scores + 1);
        scores[0] = scores[columns + 1] = 0;
      }
      if (y == 0) continue;
      const std::uint8_t* centre = scores_.row(y) + 1;
      const int found = impl::local_maxima(centre, scores_.stride(), columns, positions_.data());
      const std::size_t before = corners.size();
      corners.resize(before + found);
      for (int i = 0; i < found; ++i)
        corners[before + i] = {static_cast<std::int16_t>(positions_[i] + border),
                               static_cast<std::int16_t>(y - 1 + border), centre[positions_[i]]};
    }
  }

  /// Where the score peaks around a corner that the last detect() gave: the top of the quadratic fitted to
  /// its 3x3 scores by least squares, at most half a pixel off in x and y. Scores not above the threshold
  /// count as zero; on made pairs of images this halves the error of matched corners.
  SubPixel refine(const Corner& corner) const {
    const std::uint8_t* centre = scores_.row(corner.y - border_ + 1) + corner.x - border_ + 1;
    float s[3][3];
    for (int y = 0; y < 3; ++y)
      for (int x = 0; x < 3; ++x) s[y][x] = centre[(y - 1) * scores_.stride() + x - 1];
    // Gradient and Hessian at the centre, times six.
    const float g_x = s[0][2] + s[1][2] + s[2][2] - s[0][0] - s[1][0] - s[2][0];
    const float g_y = s[2][0] + s[2][1] + s[2][2] - s[0][0] - s[0][1] - s[0][2];
    const float middle_column = s[0][1] + s[1][1] + s[2][1];
    const float middle_row = s[1][0] + s[1][1] + s[1][2];
    const float all = middle_row + s[0][0] + s[0][1] + s[0][2] + s[2][0] + s[2][1] + s[2][2];
    const float h_xx = 2 * (all - 3 * middle_column);
    const float h_yy = 2 * (all - 3 * middle_row);
    const float h_xy = 1.5f * (s[0][0] + s[2][2] - s[0][2] - s[2][0]);
    const float determinant = h_xx * h_yy - h_xy * h_xy;
    if (h_xx >= 0 || determinant <= 0) return {};  // not a peak
    return {std::clamp((h_xy * g_y - h_yy * g_x) / determinant, -0.5f, 0.5f),
            std::clamp((h_xy * g_x - h_xx * g_y) / determinant, -0.5f, 0.5f)};
  }

 private:
  GrayImage scores_;
  int border_ = 0;
  std::vector<std::int16_t> positions_;
};

/// The FAST-9 score of one pixel at least 3 px inside the image, see FastDetector.
inline int fast_score(GrayView image, int x, int y) {
  return impl::fast_score(image.row(y) + x, impl::circle_offsets(image.stride));
}

}  // namespace sweepkit
