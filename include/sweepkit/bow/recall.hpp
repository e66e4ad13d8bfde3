// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <span>
#include <vector>

#include "sweepkit/core/error.hpp"

namespace sweepkit {

/// What an image of the database is to an image that is looked for.
enum class PlaceRelation : std::uint8_t {
  ignored,  ///< not to be found: itself, or too near in time to count
  wrong,    ///< another place
  right,    ///< the same place, by truth
};

/// Recall_N for several N.
struct Recall {
  std::vector<int> counts;            ///< the N
  std::vector<double> values;         ///< mean of Recall_N over the images, in [0, 1]; 0 without images
  std::vector<std::size_t> short_of;  ///< images with fewer than N true neighbours
  std::size_t images = 0;             ///< images that were looked for and have a true neighbour
  std::size_t without = 0;            ///< images left out, since they have none
};

/// Recall_N: for an image the N most similar ones are taken; with M of them right it is M / min(N, number of
/// right ones there are), and the mean over images is given. An image without any right one does not count.
/// Of equally similar ones the first are taken.
class RecallMeter {
 public:
  /// @param counts the N, each at least 1, else Error(argument)
  explicit RecallMeter(std::vector<int> counts = {1, 20, 40, 60}) {
    for (const int count : counts) require(count >= 1, "RecallMeter counts", "must be at least 1", count);
    recall_.values.assign(counts.size(), 0.0);
    recall_.short_of.assign(counts.size(), 0);
    recall_.counts = std::move(counts);
  }

  /// Counts one image that was looked for.
  /// @param scores how alike it is to each image of the database; the larger the more alike
  /// @param relations what each of these is to it
  void add(std::span<const double> scores, std::span<const PlaceRelation> relations) {
    require(scores.size() == relations.size(), "RecallMeter::add relations", "must be as many as scores",
            relations.size());
    order_.clear();
    std::size_t right = 0;
    for (std::size_t i = 0; i < scores.size(); ++i) {
      if (relations[i] == PlaceRelation::ignored) continue;
      order_.push_back(i);
      right += relations[i] == PlaceRelation::right;
    }
    if (right == 0) {
      ++recall_.without;
      return;
    }
    std::ranges::sort(order_, [&](std::size_t a, std::size_t b) {
      return scores[a] != scores[b] ? scores[a] > scores[b] : a < b;
    });
    ++recall_.images;
    for (std::size_t k = 0; k < recall_.counts.size(); ++k) {
      const auto wanted = static_cast<std::size_t>(recall_.counts[k]);
      const std::size_t taken = std::min(wanted, order_.size());
      const auto found = static_cast<std::size_t>(
          std::count_if(order_.begin(), order_.begin() + static_cast<std::ptrdiff_t>(taken),
                        [&](std::size_t i) { return relations[i] == PlaceRelation::right; }));
      recall_.values[k] += static_cast<double>(found) / static_cast<double>(std::min(wanted, right));
      recall_.short_of[k] += right < wanted;
    }
  }

  Recall result() const {
    Recall recall = recall_;
    if (recall.images > 0)
      for (double& value : recall.values) value /= static_cast<double>(recall.images);
    return recall;
  }

 private:
  Recall recall_;  // values are sums
  std::vector<std::size_t> order_;
};

}  // namespace sweepkit
