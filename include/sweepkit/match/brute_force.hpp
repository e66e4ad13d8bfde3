// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/match/match.hpp"
#include "sweepkit/match/orientation.hpp"

namespace sweepkit {

struct BruteForceOptions {
  int max_distance = 64;
  double ratio = 0.85;
  bool mutual = true;
  bool check_orientation = true;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(max_distance, "max_distance", "", range(0, 256), "largest Hamming distance of a match [bits]");
    v(ratio, "ratio", "", range(0.1, 1.0),
      "the best must lie below this part of the second best; 1 switches the test off");
    v(mutual, "mutual", "", any_value(), "keep a pair only if each is the other's nearest");
    v(check_orientation, "check_orientation", "", any_value(),
      "keep only matches that agree on how much the image turned");
  }
};

/// Nearest neighbours in descriptor among all features of two images, whatever their position: for when
/// nothing can be predicted. Of equally near ones the first wins. Keeps its buffers; not thread-safe.
class BruteForceMatcher {
 public:
  explicit BruteForceMatcher(const BruteForceOptions& options = {}) : options_(options) {
    check_options(options_);
  }
  const BruteForceOptions& options() const { return options_; }

  /// Matches descriptors alone: no test of orientation.
  /// @param matches one for each of a: an index into b
  /// Returns the number of matches. At most 65535 descriptors a side, else Error(argument).
  int match(std::span<const OrbDescriptor> a, std::span<const OrbDescriptor> b, std::vector<Match>& matches);

  /// Matches features; throws Error(argument) where key points and descriptors differ in number.
  int match(const Features<256>& a, const Features<256>& b, std::vector<Match>& matches);

 private:
  BruteForceOptions options_;
  std::vector<std::uint64_t> blocks_;        // b's words, eight descriptors interleaved
  std::vector<std::uint32_t> nearest_to_b_;  // for each of b: distance << 16 | index in a
  OrientationCheck orientation_;
};

/// One call without kept buffers.
inline std::vector<Match> match_brute_force(const Features<256>& a, const Features<256>& b,
                                            const BruteForceOptions& options = {}) {
  std::vector<Match> matches;
  BruteForceMatcher(options).match(a, b, matches);
  return matches;
}

}  // namespace sweepkit
