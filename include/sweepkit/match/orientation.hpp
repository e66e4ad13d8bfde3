// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <span>
#include <vector>

namespace sweepkit {

/// Which of many turns agree with one another: between two images a camera rolls by one angle, so matches
/// whose key points turned by something else are wrong. Turns are counted in a circular histogram of 36 bins;
/// the most frequent window of three bins (30 degrees) wins. Keeps its buffers.
class OrientationCheck {
 public:
  void clear() { bins_.clear(); }
  /// Adds a match whose key points have these orientations [rad].
  void add(float angle_a, float angle_b) {
    constexpr float kTurn = 2 * std::numbers::pi_v<float>;
    float turn = (angle_a - angle_b) / kTurn;
    turn -= std::floor(turn);
    // Rounding can give exactly 1.
    const int bin = static_cast<int>(turn * kBins);
    bins_.push_back(static_cast<std::uint8_t>(bin < kBins ? bin : 0));
  }
  /// Finds the winning window; call once after the last add.
  void finish() {
    std::array<int, kBins> count{};
    for (const std::uint8_t bin : bins_) ++count[bin];
    int best = -1;
    for (int b = 0; b < kBins; ++b) {
      const int sum = count[(b + kBins - 1) % kBins] + count[b] + count[(b + 1) % kBins];
      if (sum > best) {
        best = sum;
        center_ = b;
      }
    }
  }
  /// Whether the i-th match added lies in the winning window.
  bool agrees(std::size_t i) const {
    const int away = (bins_[i] - center_ + kBins) % kBins;
    return away <= 1 || away == kBins - 1;
  }

 private:
  static constexpr int kBins = 36;

  std::vector<std::uint8_t> bins_;
  int center_ = 0;
};

}  // namespace sweepkit
