// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "sweepkit/match/match.hpp"

namespace sweepkit {

/// The codes that were found for each of several queries, nearest first, of equally near ones the lowest id
/// first.
struct NeighbourLists {
  std::vector<Match> matches;             ///< all lists, one after the other; `index` is the code's id
  std::vector<std::size_t> begins = {0};  ///< list i is matches[begins[i]] up to matches[begins[i + 1]]

  std::size_t size() const { return begins.size() - 1; }
  std::span<const Match> operator[](std::size_t i) const {
    return std::span(matches).subspan(begins[i], begins[i + 1] - begins[i]);
  }
  void clear() {
    matches.clear();
    begins.assign(1, 0);
  }
  /// Ends the list that `matches` was filled for.
  void finish_list() { begins.push_back(matches.size()); }
  void append(const NeighbourLists& more) {
    const std::size_t offset = matches.size();
    matches.insert(matches.end(), more.matches.begin(), more.matches.end());
    for (std::size_t i = 1; i < more.begins.size(); ++i) begins.push_back(offset + more.begins[i]);
  }

  friend bool operator==(const NeighbourLists&, const NeighbourLists&) = default;
};

}  // namespace sweepkit
