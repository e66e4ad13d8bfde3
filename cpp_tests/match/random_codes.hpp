// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/match/match.hpp"

namespace sweepkit {

template <int Bits>
BinaryDescriptor<Bits> random_code(Random& random) {
  BinaryDescriptor<Bits> code;
  for (auto& word : code.words) word = random();
  return code;
}

/// The code with some bits turned over.
template <int Bits>
BinaryDescriptor<Bits> disturbed_code(Random& random, BinaryDescriptor<Bits> code, int most) {
  const auto flips = random.index(static_cast<std::uint64_t>(most) + 1);
  for (std::uint64_t i = 0; i < flips; ++i) {
    const auto bit = random.index(Bits);
    code.words[bit / 64] ^= std::uint64_t{1} << bit % 64;
  }
  return code;
}

/// Codes in clusters, as those of images are, with equal ones among them.
template <int Bits>
std::vector<BinaryDescriptor<Bits>> clustered_codes(Random& random, std::size_t count, int spread) {
  std::vector<BinaryDescriptor<Bits>> codes;
  while (codes.size() < count)
    codes.push_back(codes.empty() || random.index(8) == 0
                        ? random_code<Bits>(random)
                        : disturbed_code(random, codes[random.index(codes.size())], spread));
  return codes;
}

/// A set of codes with ids and its searches, as their definitions say.
template <int Bits>
struct PlainCodes {
  struct Item {
    std::int32_t id;
    BinaryDescriptor<Bits> code;
  };
  std::vector<Item> items;

  std::vector<Match> all(const BinaryDescriptor<Bits>& query) const {
    std::vector<Match> matches;
    for (const Item& item : items) matches.push_back({item.id, hamming_distance(item.code, query)});
    std::ranges::sort(matches, [](const Match& a, const Match& b) {
      return a.distance != b.distance ? a.distance < b.distance : a.index < b.index;
    });
    return matches;
  }
  std::vector<Match> within(const BinaryDescriptor<Bits>& query, int radius) const {
    std::vector<Match> matches = all(query);
    std::erase_if(matches, [&](const Match& m) { return m.distance > radius; });
    return matches;
  }
  std::vector<Match> nearest(const BinaryDescriptor<Bits>& query, std::size_t count) const {
    std::vector<Match> matches = all(query);
    matches.resize(std::min(matches.size(), count));
    return matches;
  }
};

}  // namespace sweepkit
