// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/view.hpp"
#include "sweepkit/image/impl/resize_rows.hpp"

namespace sweepkit {

/// Bilinear resize of 8-bit images in fixed point, keeping its tables and row buffers between calls.
///
/// Pixel centres map as x_source = (x + 0.5) * source.width / target.width - 0.5 (rows alike), clamped at the
/// border. Weights have 7 bits along a row (kept within 1/128 and 127/128) and 15 bits across rows; a
/// constant image stays constant.
class BilinearResizer {
 public:
  /// Fills `target` from `source`; the views must not overlap.
  void operator()(GrayView source, View2d<std::uint8_t> target) {
    require(!source.empty() && !target.empty(), "BilinearResizer", "images cannot be empty",
            source.empty() ? "source" : "target");
    prepare(source.width, target.width);
    const std::size_t padded = columns_.padded_width();
    for (auto& row : rows_) row.resize(padded);
    // Which source rows the two buffers hold; consecutive target rows share most of them.
    int held[2] = {-1, -1};
    const double scale = static_cast<double>(source.height) / target.height;
    for (int y = 0; y < target.height; ++y) {
      const double centre = std::clamp((y + 0.5) * scale - 0.5, 0.0, source.height - 1.0);
      const int upper = std::min(static_cast<int>(centre), source.height - 1);
      const int lower = std::min(upper + 1, source.height - 1);
      const int weight = std::min(static_cast<int>((centre - upper) * 32768.0 + 0.5), 32767);
      if (held[0] != upper) {
        std::swap(held[0], held[1]);
        rows_[0].swap(rows_[1]);
        if (held[0] != upper) fill(0, upper, source, held);
      }
      if (held[1] != lower) fill(1, lower, source, held);
      impl::blend_rows(rows_[0].data(), rows_[1].data(), weight, target.width, target.row(y));
    }
  }

 private:
  void prepare(int source_width, int target_width) {
    if (source_width == source_width_ && target_width == target_width_) return;
    columns_.build(source_width, target_width);
    source_width_ = source_width;
    target_width_ = target_width;
  }

  void fill(int buffer, int y, GrayView source, int (&held)[2]) {
    impl::resize_row(source.row(y), columns_, rows_[buffer].data());
    held[buffer] = y;
  }

  int source_width_ = 0;
  int target_width_ = 0;
  impl::ColumnTable columns_;
  std::vector<std::int16_t> rows_[2];
};

}  // namespace sweepkit
