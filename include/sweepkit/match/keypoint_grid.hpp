// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <ranges>
#include <span>
#include <vector>

#include "sweepkit/core/error.hpp"

namespace sweepkit {

/// Anything with a rectified position u, v [px] and a pyramid octave.
template <class P>
concept RectifiedPosition = requires(const P p) {
  { p.u } -> std::convertible_to<float>;
  { p.v } -> std::convertible_to<float>;
  { p.octave } -> std::convertible_to<std::int32_t>;
};

/// Size of a grid's cells [px].
struct GridCell {
  float width = 32;
  float height = 32;
};

/// Key points of one image sorted into cells, for queries by area. Flat arrays: the points of a row of cells
/// follow one another (compressed rows, made by a counting sort), so that a rectangle is a few contiguous
/// ranges. The grid spans the bounding box of its points and grows to any size; buffers are kept between
/// builds. Points keep their order within a cell, so queries are deterministic.
class KeypointGrid {
 public:
  KeypointGrid() = default;
  explicit KeypointGrid(GridCell cell) : cell_(cell) {
    require(cell.width >= 1 && cell.height >= 1, "KeypointGrid cell", "must be at least 1 px wide and high",
            std::min(cell.width, cell.height));
  }

  /// Sorts points into cells; index i of the range is what queries give back. `skip[i]` != 0 leaves a point
  /// out. Positions must be finite.
  template <std::ranges::contiguous_range Points>
  requires RectifiedPosition<std::ranges::range_value_t<Points>>
  void build(const Points& points, std::span<const std::uint8_t> skip = {}) {
    const std::size_t count = std::ranges::size(points);
    require(skip.empty() || skip.size() == count, "KeypointGrid::build skip", "must be as long as points",
            skip.size());
    const auto* p = std::ranges::data(points);
    order_.clear();
    u_min_ = v_min_ = 0;
    float u_max = 0, v_max = 0;
    for (std::size_t i = 0; i < count; ++i) {
      if (!skip.empty() && skip[i]) continue;
      const float u = p[i].u, v = p[i].v;
      if (order_.empty()) {
        u_min_ = u_max = u;
        v_min_ = v_max = v;
      }
      u_min_ = std::min(u_min_, u);
      v_min_ = std::min(v_min_, v);
      u_max = std::max(u_max, u);
      v_max = std::max(v_max, v);
      order_.push_back(static_cast<std::int32_t>(i));
    }
    columns_ = 1 + std::min(kMaxCells, static_cast<int>((u_max - u_min_) / cell_.width));
    rows_ = 1 + std::min(kMaxCells, static_cast<int>((v_max - v_min_) / cell_.height));

    const std::size_t n = order_.size();
    start_.assign(static_cast<std::size_t>(rows_) * columns_ + 1, 0);
    cell_of_.resize(n);
    for (std::size_t k = 0; k < n; ++k) {
      const auto& q = p[order_[k]];
      cell_of_[k] = row(q.v) * columns_ + column(q.u);
      ++start_[cell_of_[k] + 1];
    }
    for (std::size_t c = 1; c < start_.size(); ++c) start_[c] += start_[c - 1];
    u_.resize(n + kPadding);
    v_.resize(n + kPadding);
    octave_.resize(n + kPadding);
    index_.resize(n);
    next_.assign(start_.begin(), start_.end() - 1);
    for (std::size_t k = 0; k < n; ++k) {
      const std::int32_t slot = next_[cell_of_[k]]++;
      const auto& q = p[order_[k]];
      u_[slot] = q.u;
      v_[slot] = q.v;
      octave_[slot] = q.octave;
      index_[slot] = order_[k];
    }
  }

  std::size_t size() const { return index_.size(); }
  bool empty() const { return index_.empty(); }
  const GridCell& cell() const { return cell_; }

  /// Points in the order of the cells: position, octave and index in the range given to build. Behind the
  /// last position and octave eight more values can be read, so that vector loads need not stop short.
  std::span<const float> u() const { return {u_.data(), index_.size()}; }
  std::span<const float> v() const { return {v_.data(), index_.size()}; }
  std::span<const std::int32_t> octave() const { return {octave_.data(), index_.size()}; }
  std::span<const std::int32_t> index() const { return index_; }

  /// Calls visit(first, last) for ranges of slots that together hold every point with u_low <= u <= u_high
  /// and v_low <= v <= v_high, and some of the surroundings: the caller tests the points.
  template <std::invocable<std::int32_t, std::int32_t> Visit>
  void for_each_range(float u_low, float u_high, float v_low, float v_high, Visit&& visit) const {
    if (empty() || !(u_low <= u_high) || !(v_low <= v_high)) return;
    const int c0 = column(u_low), c1 = column(u_high), r1 = row(v_high);
    for (int r = row(v_low); r <= r1; ++r) {
      const std::int32_t first = start_[static_cast<std::size_t>(r) * columns_ + c0];
      const std::int32_t last = start_[static_cast<std::size_t>(r) * columns_ + c1 + 1];
      if (first < last) visit(first, last);
    }
  }

  /// Appends the indices of points at most `radius` away in u and in v (a square) and of an octave within
  /// [min_octave, max_octave], in the order of the cells.
  void query(float u, float v, float radius, int min_octave, int max_octave,
             std::vector<std::int32_t>& found) const {
    for_each_range(u - radius, u + radius, v - radius, v + radius,
                   [&](std::int32_t first, std::int32_t last) {
                     for (std::int32_t k = first; k < last; ++k)
                       if (std::abs(u_[k] - u) <= radius && std::abs(v_[k] - v) <= radius &&
                           octave_[k] >= min_octave && octave_[k] <= max_octave)
                         found.push_back(index_[k]);
                   });
  }

 private:
  static constexpr std::size_t kPadding = 8;
  // Absurd positions must not ask for absurd memory: what lies beyond is kept in the last cell.
  static constexpr int kMaxCells = 1023;

  int column(float u) const { return cell_index(u - u_min_, cell_.width, columns_); }
  int row(float v) const { return cell_index(v - v_min_, cell_.height, rows_); }
  static int cell_index(float offset, float size, int count) {
    const float c = offset / size;
    if (!(c > 0)) return 0;
    return c < static_cast<float>(count) ? static_cast<int>(c) : count - 1;
  }

  GridCell cell_;
  float u_min_ = 0, v_min_ = 0;
  int columns_ = 1, rows_ = 1;
  std::vector<std::int32_t> start_, next_, cell_of_, order_, index_, octave_;
  std::vector<float> u_, v_;
};

}  // namespace sweepkit
