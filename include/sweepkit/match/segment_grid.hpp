// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "sweepkit/core/error.hpp"

namespace sweepkit {

/// A segment in the rectified image [px].
struct Segment2d {
  float u1 = 0, v1 = 0, u2 = 0, v2 = 0;

  float du() const { return u2 - u1; }
  float dv() const { return v2 - v1; }
  float length() const { return std::sqrt(du() * du() + dv() * dv()); }
  friend bool operator==(const Segment2d&, const Segment2d&) = default;
};

/// Segments of one image sorted into all cells that they pass, for queries by area. Keeps its memory between
/// builds. Queries are deterministic; a grid serves one thread at a time, as it remembers what a query met.
class SegmentGrid {
 public:
  static constexpr float kCell = 32;  ///< [px]

  /// Index i of the range is what queries give back. `skip[i]` != 0 leaves a segment out. What lies farther
  /// than 8192 px to the left of or above (0, 0), or 24576 to the right of or below it, is kept in the
  /// outermost cells.
  void build(std::span<const Segment2d> segments, std::span<const std::uint8_t> skip = {}) {
    require(skip.empty() || skip.size() == segments.size(), "SegmentGrid::build skip",
            "must be as long as segments", skip.size());
    seen_.assign(segments.size(), 0);
    query_ = 0;
    u_min_ = v_min_ = kHighest;
    float u_max = kLowest, v_max = kLowest;
    for (std::size_t i = 0; i < segments.size(); ++i) {
      if (!skip.empty() && skip[i]) continue;
      const Segment2d& s = segments[i];
      u_min_ = std::min(u_min_, limit(std::min(s.u1, s.u2)));
      v_min_ = std::min(v_min_, limit(std::min(s.v1, s.v2)));
      u_max = std::max(u_max, limit(std::max(s.u1, s.u2)));
      v_max = std::max(v_max, limit(std::max(s.v1, s.v2)));
    }
    columns_ = u_max < u_min_ ? 0 : 1 + static_cast<int>((u_max - u_min_) / kCell);
    rows_ = v_max < v_min_ ? 0 : 1 + static_cast<int>((v_max - v_min_) / kCell);
    start_.assign(static_cast<std::size_t>(columns_) * rows_ + 2, 0);
    if (columns_ == 0) return;
    const auto each = [&](const auto& visit) {
      for (std::size_t i = 0; i < segments.size(); ++i)
        if (skip.empty() || !skip[i])
          for_each_cell(segments[i], [&](int cell) { visit(cell, static_cast<std::int32_t>(i)); });
    };
    each([&](int cell, std::int32_t) { ++start_[cell + 2]; });
    for (std::size_t c = 2; c < start_.size(); ++c) start_[c] += start_[c - 1];
    index_.resize(static_cast<std::size_t>(start_.back()));
    each([&](int cell, std::int32_t i) { index_[start_[cell + 1]++] = i; });
  }

  /// Calls visit(index) once for each segment that passes a cell of the rectangle, cell by cell: all that
  /// cross the rectangle, and some around; the caller tests them.
  template <class Visit>
  void for_each(float u_low, float u_high, float v_low, float v_high, Visit&& visit) {
    if (columns_ == 0 || !(u_low <= u_high) || !(v_low <= v_high)) return;
    ++query_;
    const int c0 = column(u_low), c1 = column(u_high), r1 = row(v_high);
    for (int r = row(v_low); r <= r1; ++r) {
      const std::size_t first = static_cast<std::size_t>(r) * columns_;
      for (std::int32_t k = start_[first + c0]; k < start_[first + c1 + 1]; ++k) {
        const std::int32_t i = index_[k];
        if (seen_[i] == query_) continue;
        seen_[i] = query_;
        visit(i);
      }
    }
  }

 private:
  static constexpr float kLowest = -8192, kHighest = 24576;

  static float limit(float v) { return v > kLowest ? std::min(v, kHighest) : kLowest; }
  int column(float u) const {
    return std::clamp(static_cast<int>((limit(u) - u_min_) / kCell), 0, columns_ - 1);
  }
  int row(float v) const { return std::clamp(static_cast<int>((limit(v) - v_min_) / kCell), 0, rows_ - 1); }

  /// The cells of a segment, row of cells by row: those between where it enters and where it leaves the row.
  template <class Visit>
  void for_each_cell(const Segment2d& s, const Visit& visit) const {
    const bool down = s.v1 <= s.v2;
    const float u1 = down ? s.u1 : s.u2, v1 = down ? s.v1 : s.v2, u2 = down ? s.u2 : s.u1,
                v2 = down ? s.v2 : s.v1;
    const int r1 = row(v2);
    for (int r = row(v1); r <= r1; ++r) {
      const float top = std::clamp(v_min_ + static_cast<float>(r) * kCell, v1, v2);
      const float bottom = std::clamp(v_min_ + static_cast<float>(r + 1) * kCell, v1, v2);
      const float slope = v2 > v1 ? (u2 - u1) / (v2 - v1) : 0.0f;
      float ua = r == row(v1) ? u1 : u1 + (top - v1) * slope, ub = r == r1 ? u2 : u1 + (bottom - v1) * slope;
      if (ua > ub) std::swap(ua, ub);
      for (int c = column(ua - 0.01f); c <= column(ub + 0.01f); ++c) visit(r * columns_ + c);
    }
  }

  float u_min_ = 0, v_min_ = 0;
  int columns_ = 0, rows_ = 0;
  std::uint32_t query_ = 0;
  std::vector<std::int32_t> start_, index_;
  std::vector<std::uint32_t> seen_;
};

}  // namespace sweepkit
