// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <concepts>
#include <cstddef>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/match/stereo_search.hpp"

namespace sweepkit {

/// A policy that removes wrong stereo matches by what the others say. It offers
/// - `Options`, a struct of options it is constructed from,
/// - `filter(matches)`, which clears matches with `clear_match` and moves nothing.
template <class F>
concept StereoFilter = HasOptions<typename F::Options> &&
    std::constructible_from<F, const typename F::Options&> &&
    requires(F filter, std::span<StereoMatch> matches) {
  filter.filter(matches);
};

/// Takes the pair away and leaves the rectified position of the left key point.
inline void clear_match(StereoMatch& match) {
  match = {.u_left = match.u_left, .v_left = match.v_left, .rectified = match.rectified};
}

/// Keeps every match.
struct NoFilter {
  struct Options {
    template <class Visitor>
    void visit_options(Visitor&) {}
  };

  NoFilter() = default;
  explicit NoFilter(const Options&) {}
  void filter(std::span<StereoMatch>) const {}
};

/// Removes matches whose descriptors differ by more than `factor` times the median of all. Cheap, and needs
/// no image.
class MedianFilter {
 public:
  struct Options {
    double factor = 4;

    template <class Visitor>
    void visit_options(Visitor& v) {
      v(factor, "factor", "", range(1.0, 100.0),
        "matches above this part of the median distance are removed");
    }
  };

  MedianFilter() = default;
  explicit MedianFilter(const Options& options) : options_(options) {}

  void filter(std::span<StereoMatch> matches) {
    distances_.clear();
    for (const StereoMatch& m : matches)
      if (m.found()) distances_.push_back(m.distance);
    if (distances_.empty()) return;
    const auto middle = distances_.begin() + static_cast<std::ptrdiff_t>(distances_.size() / 2);
    std::nth_element(distances_.begin(), middle, distances_.end());
    const double limit = options_.factor * *middle;
    for (StereoMatch& m : matches)
      if (m.found() && m.distance > limit) clear_match(m);
  }

 private:
  Options options_;
  std::vector<std::int32_t> distances_;
};

}  // namespace sweepkit
