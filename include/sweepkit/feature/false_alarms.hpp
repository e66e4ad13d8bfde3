// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <vector>

namespace sweepkit {

/// log10 of the probability that of n independent trials, each a success with probability p, at least k
/// succeed. Sums the terms from k on and stops where they no longer count. 0 <= k <= n, 0 < p < 1.
inline double log10_binomial_tail(int n, int k, double p) {
  if (k <= 0) return 0;
  if (k >= n) return n * std::log10(p);
  const double log_first = std::lgamma(n + 1.0) - std::lgamma(k + 1.0) - std::lgamma(n - k + 1.0) +
                           k * std::log(p) + (n - k) * std::log1p(-p);
  // Each term is the one before times (n - i) / (i + 1) * p / (1 - p), which falls with i.
  const double odds = p / (1 - p);
  double term = 1, sum = 1;
  for (int i = k; i < n; ++i) {
    const double ratio = (n - i) / (i + 1.0) * odds;
    term *= ratio;
    sum += term;
    if (ratio < 1 && term * ratio < 1e-4 * sum * (1 - ratio)) break;
  }
  return std::min(0.0, (log_first + std::log(sum)) / std::log(10.0));
}

// A validation policy decides whether a stretch of edge is a segment. It offers
//   prepare(width, height, p)   the image to come, and the probability that the edge direction at a pixel of
//                               noise agrees with a given one
//   response(points, aligned)   a score for that many points of which `aligned` agree with the segment
//   accepts(response, max_false_alarms)
template <class V>
concept SegmentValidation = requires(V v, const V c) {
  v.prepare(1, 1, 0.125);
  { c.response(1, 1) } -> std::convertible_to<double>;
  { c.accepts(0.0, 1.0) } -> std::convertible_to<bool>;
};

/// A contrario: how many segments as good as this one are to be expected in an image of noise? (Desolneux,
/// Moisan, Morel, Meaningful alignments, IJCV 2000.) There are about (width height)^2 pairs of end points.
/// Neighbouring pixels share some of what was smoothed, so that fewer of them count: kIndependent is set so
/// that images of white noise hold fewer than max_false_alarms segments (see the tests).
class NumberOfFalseAlarms {
 public:
  static constexpr double kIndependent = 0.9;

  void prepare(int width, int height, double p) {
    p_ = p;
    log_tests_ = 2 * (std::log10(static_cast<double>(width)) + std::log10(static_cast<double>(height)));
  }
  /// -log10 of the expected number of false alarms.
  double response(int points, int aligned) const {
    return -(log_tests_ + log10_binomial_tail(static_cast<int>(kIndependent * points),
                                              static_cast<int>(kIndependent * aligned), p_));
  }
  bool accepts(double response, double max_false_alarms) const {
    return response >= -std::log10(max_false_alarms);
  }

 private:
  double p_ = 0.125, log_tests_ = 0;
};

/// Takes every stretch that is long and straight enough; the response is the number of aligned points.
struct NoValidation {
  void prepare(int, int, double) {}
  double response(int, int aligned) const { return aligned; }
  bool accepts(double, double) const { return true; }
};

}  // namespace sweepkit
