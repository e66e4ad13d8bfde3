// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/feature/fast.hpp"

namespace sweepkit {

/// Chooses corners that cover the image: best first, and evenly over the cells of a grid.
///
/// Each cell offers its corners in order of their score. All cells give their best, then their second, and so
/// on until enough are chosen; of the last round the highest scores win. In a cell with a corner above
/// `threshold`, weaker ones do not count: the low threshold of the detector is only for cells that would stay
/// empty. Linear in the number of corners; equal scores go by order of input. Keeps its buffers between
/// calls.
class SpreadSelector {
 public:
  /// @param corners within width x height
  /// @param wanted at most so many are chosen
  /// @param cell_size side of a cell, at least 1 [px]
  /// @param chosen receives the corners by rounds' order of score: the strongest first
  void select(std::span<const Corner> corners, int width, int height, int wanted, int cell_size,
              int threshold, std::vector<Corner>& chosen) {
    require(cell_size >= 1, "SpreadSelector::select", "a cell cannot be empty", cell_size);
    chosen.clear();
    if (wanted <= 0 || corners.empty()) return;
    const int columns = (width + cell_size - 1) / cell_size;
    const int rows = (height + cell_size - 1) / cell_size;
    column_of_.resize(width);
    for (int x = 0; x < width; ++x) column_of_[x] = static_cast<std::int16_t>(x / cell_size);
    sort_by_score(corners);

    // A corner's rank in its cell is the round in which it is up.
    taken_.assign(static_cast<std::size_t>(columns) * rows, 0);
    best_.assign(taken_.size(), 0);
    rank_.resize(corners.size());
    round_size_.assign(1, 0);
    for (const int i : order_) {
      const Corner& c = corners[i];
      const int cell = c.y / cell_size * columns + column_of_[c.x];
      const int rank = taken_[cell]++;
      if (rank == 0) best_[cell] = c.score;
      if (c.score <= threshold && best_[cell] > threshold) {
        rank_[i] = kNever;
        --taken_[cell];
        continue;
      }
      rank_[i] = rank;
      if (rank == static_cast<int>(round_size_.size())) round_size_.push_back(0);
      ++round_size_[rank];
    }
    int whole_rounds = 0;
    int left = wanted;
    while (whole_rounds < static_cast<int>(round_size_.size()) && round_size_[whole_rounds] <= left)
      left -= round_size_[whole_rounds++];
    for (const int i : order_) {
      if (rank_[i] > whole_rounds) continue;
      if (rank_[i] == whole_rounds && left-- <= 0) continue;
      chosen.push_back(corners[i]);
    }
  }

 private:
  static constexpr int kNever = 1 << 30;

  void sort_by_score(std::span<const Corner> corners) {
    std::array<int, 257> begin{};
    for (const Corner& c : corners) ++begin[256 - c.score];
    for (int s = 1; s <= 256; ++s) begin[s] += begin[s - 1];
    order_.resize(corners.size());
    for (std::size_t i = 0; i < corners.size(); ++i)
      order_[begin[255 - corners[i].score]++] = static_cast<int>(i);
  }

  std::vector<std::int16_t> column_of_;
  std::vector<int> order_, rank_, taken_, round_size_;
  std::vector<std::uint8_t> best_;
};

}  // namespace sweepkit
