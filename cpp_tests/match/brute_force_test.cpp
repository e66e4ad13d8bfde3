// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/match/brute_force.hpp"

#include <catch2/catch.hpp>

#include "match/random_features.hpp"
#include "sweepkit/core/simd.hpp"
#include "sweepkit/match/impl/code_blocks.hpp"

using namespace sweepkit;

namespace {

/// The definition, without any cleverness.
std::vector<Match> slow_match(const Features<256>& a, const Features<256>& b,
                              const BruteForceOptions& options) {
  const auto nearest = [](const OrbDescriptor& d, const std::vector<OrbDescriptor>& all) {
    int best = -1;
    for (int j = 0; j < static_cast<int>(all.size()); ++j)
      if (best < 0 || hamming_distance(d, all[j]) < hamming_distance(d, all[best])) best = j;
    return best;
  };
  std::vector<Match> matches(a.size());
  for (int i = 0; i < static_cast<int>(a.size()); ++i) {
    const int j = nearest(a.descriptors[i], b.descriptors);
    if (j < 0) continue;
    const int distance = hamming_distance(a.descriptors[i], b.descriptors[j]);
    bool good = distance <= options.max_distance;
    for (int k = 0; k < static_cast<int>(b.size()); ++k)
      if (k != j && options.ratio < 1)
        good = good && distance <= options.ratio * hamming_distance(a.descriptors[i], b.descriptors[k]);
    if (options.mutual) good = good && nearest(b.descriptors[j], a.descriptors) == i;
    if (good) matches[i] = {j, distance};
  }
  return matches;
}

}  // namespace

TEST_CASE("brute force finds what the definition says, at every size and SIMD level") {
  Random random(7);
  for (const auto& [na, nb] :
       {std::pair{0, 0}, {0, 5}, {5, 0}, {1, 1}, {3, 7}, {20, 8}, {50, 57}, {200, 131}}) {
    const Features<256> a = random_features(random, na);
    const Features<256> b = disturbed(random, a, nb, 40);
    for (const bool mutual : {true, false})
      for (const double ratio : {0.8, 1.0}) {
        const BruteForceOptions options{
            .max_distance = 80, .ratio = ratio, .mutual = mutual, .check_orientation = false};
        const auto expected = slow_match(a, b, options);
        BruteForceMatcher matcher(options);
        std::vector<Match> fast, narrow, portable;
        const int count = matcher.match(a, b, fast);
        impl::avx512_allowed() = false;
        matcher.match(a, b, narrow);
        impl::avx512_allowed() = true;
        {
          const ScopedSimdLevel level(SimdLevel::portable);
          matcher.match(a, b, portable);
        }
        CHECK(fast == expected);
        CHECK(narrow == expected);
        CHECK(portable == expected);
        CHECK(count == std::ranges::count_if(expected, &Match::found));
      }
  }
}

TEST_CASE("of equal descriptors brute force takes the first, and the ratio test none") {
  Features<256> a, b;
  a.keypoints.resize(4);
  a.descriptors.resize(4);
  b.keypoints.resize(20);
  b.descriptors.resize(20);
  const auto first = match_brute_force(a, b, {.ratio = 1, .check_orientation = false});
  CHECK(first[0] == Match{0, 0});
  for (int i = 1; i < 4; ++i) CHECK_FALSE(first[i].found());  // b 0 belongs to a 0
  // 0 is not above any part of 0, so equal perfect matches pass; one bit makes the test bite.
  for (auto& d : a.descriptors) d.words[0] = 1;
  for (const Match& m : match_brute_force(a, b, {.check_orientation = false})) CHECK_FALSE(m.found());
}

TEST_CASE("the orientation check removes what turns otherwise") {
  Random random(3);
  Features<256> a = random_features(random, 100);
  Features<256> b = a;
  for (std::size_t i = 0; i < b.size(); ++i)
    b.keypoints[i].angle = a.keypoints[i].angle - (i % 5 == 0 ? 2.0f : 0.5f);
  BruteForceMatcher matcher;
  std::vector<Match> matches;
  CHECK(matcher.match(a, b, matches) == 80);
  for (std::size_t i = 0; i < a.size(); ++i) CHECK(matches[i].found() == (i % 5 != 0));
}

TEST_CASE("brute force refuses features whose numbers disagree") {
  Features<256> a;
  a.keypoints.resize(2);
  std::vector<Match> matches;
  CHECK_THROWS_AS(BruteForceMatcher().match(a, Features<256>{}, matches), Error);
  CHECK_THROWS_AS(BruteForceMatcher({.max_distance = 300}), Error);
}
