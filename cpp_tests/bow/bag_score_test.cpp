// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/bag_score.hpp"

#include <catch2/catch.hpp>
#include <cfloat>
#include <cmath>
#include <map>

#include "sweepkit/core/random.hpp"
#include "sweepkit/core/simd.hpp"

using namespace sweepkit;

namespace {

Bag random_bag(Random& random, std::uint32_t word_count, int features, BagScore score) {
  std::vector<std::uint32_t> words;
  std::vector<double> weights;
  for (int i = 0; i < features; ++i) {
    words.push_back(static_cast<std::uint32_t>(random.index(word_count)));
    weights.push_back(random.uniform(0.1, 3.0));
  }
  Bag bag;
  BagMaker().make_bag(words, weights, word_count, BagWeighting::tf_idf, score, bag);
  return bag;
}

/// The definitions, word by word.
double plain_score(const Bag& a, const Bag& b, BagScore score) {
  std::map<std::uint32_t, std::pair<double, double>> both;
  for (std::size_t i = 0; i < a.size(); ++i) both[a.words()[i]].first = a.weights()[i];
  for (std::size_t i = 0; i < b.size(); ++i) both[b.words()[i]].second = b.weights()[i];
  double l1 = 0, l2 = 0, chi = 0, kl = 0, bhattacharyya = 0, dot = 0;
  for (const auto& [word, pair] : both) {
    const auto [v, w] = pair;
    l1 += std::abs(v - w);
    l2 += (v - w) * (v - w);
    chi += (v - w) * (v - w) / (v + w);
    if (v > 0) kl += w > 0 ? v * std::log(v / w) : v * (std::log(v) - std::log(DBL_EPSILON));
    bhattacharyya += std::sqrt(v * w);
    dot += v * w;
  }
  switch (score) {
    case BagScore::l1:
      return 1 - l1 / 2;
    case BagScore::l2:
      return 1 - std::sqrt(l2 / 2);
    case BagScore::chi_square:
      return 1 - chi / 2;
    case BagScore::kl:
      return kl;
    case BagScore::bhattacharyya:
      return bhattacharyya;
    case BagScore::dot:
      return dot;
  }
  return 0;
}

}  // namespace

TEST_CASE("scores are those of their definitions, on both paths", "[bow]") {
  Random random(1);
  for (const std::uint32_t word_count : {40u, 1000u, 5000u, 400000u})
    for (int k = 0; k < 6; ++k)
      for (const int features : {1, 7, 100, 1000}) {
        const auto score = static_cast<BagScore>(k);
        const Bag a = random_bag(random, word_count, features, score);
        const Bag b = random_bag(random, word_count, 1000, score);
        const double found = bag_score(a, b, score);
        CHECK(found == Approx(plain_score(a, b, score)).margin(1e-9));
        if (k != 3) CHECK(found == Approx(bag_score(b, a, score)).margin(1e-12));
        // chi-square of a bag with itself: 2 sum of v / 2; dot is not normalised to 1
        if (k != 5 && k != 3) CHECK(bag_score(b, b, score) == Approx(1.0).margin(1e-7));
        if (k == 3) CHECK(bag_score(b, b, score) == Approx(0.0).margin(1e-12));
        ScopedSimdLevel portable(SimdLevel::portable);
        CHECK(bag_score(a, b, score) == found);
      }
}

TEST_CASE("bags without common words", "[bow]") {
  for (const std::uint32_t word_count : {100u, 100000u}) {
    const Bag a({1, 5, 70}, {0.5, 0.25, 0.25}, word_count), b({0, 6, 71}, {0.5, 0.25, 0.25}, word_count);
    for (const auto score :
         {BagScore::l1, BagScore::l2, BagScore::chi_square, BagScore::bhattacharyya, BagScore::dot})
      CHECK(bag_score(a, b, score) == 0.0);
    CHECK(bag_score(a, b, BagScore::kl) > 30);
    CHECK(bag_score(a, Bag(), BagScore::l1) == 0.0);
    CHECK(bag_score(a, Bag(), BagScore::kl) == DBL_MAX);
  }
}
