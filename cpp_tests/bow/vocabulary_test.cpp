// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/vocabulary.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <set>

#include "bow/random_tree.hpp"
#include "scratch_folder.hpp"
#include "sweepkit/core/simd.hpp"

using namespace sweepkit;

namespace {

struct Found {
  std::uint32_t word;
  double weight;
  std::uint32_t node;
};

/// The walk as one would write it down, over a tree sorted by level.
template <int Bits>
Found walk(const VocabularyTree& tree, const BinaryDescriptor<Bits>& descriptor, int level) {
  std::uint32_t node = 0, passed = 0;
  for (int depth = 1;; ++depth) {
    int best_distance = Bits + 1;
    std::uint32_t best = 0;
    for (std::uint32_t i = node + 1; i < tree.size(); ++i) {
      if (tree.parent[i] != node) continue;
      BinaryDescriptor<Bits> child;
      std::copy_n(tree.descriptor(i).begin(), child.words.size(), child.words.begin());
      const int distance = hamming_distance(descriptor, child);
      if (distance < best_distance) {
        best_distance = distance;
        best = i;
      }
    }
    if (best == 0) break;
    node = best;
    if (depth <= level) passed = node;
  }
  return {tree.word[node], tree.word[node] == VocabularyTree::kNoWord ? 0.0 : tree.weight[node], passed};
}

template <int Bits>
void compare_with_walk(const RandomTreeShape& shape, std::uint64_t seed, std::size_t count) {
  const VocabularyTree tree = sorted_by_level(random_tree(shape, seed));
  const Vocabulary<Bits> vocabulary(tree);
  const auto descriptors = random_descriptors<Bits>(tree, count, seed + 1);
  for (int level : {0, 1, 2, 9}) {
    std::vector<std::uint32_t> words(count), nodes(count), words2(count), nodes2(count);
    std::vector<double> weights(count), weights2(count);
    vocabulary.find_words(descriptors, words, weights, level, nodes);
    {
      ScopedSimdLevel portable(SimdLevel::portable);
      vocabulary.find_words(descriptors, words2, weights2, level, nodes2);
    }
    CHECK(words == words2);
    CHECK(weights == weights2);
    CHECK(nodes == nodes2);
    int wrong = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const Found found = walk<Bits>(tree, descriptors[i], level);
      wrong += found.word != words[i] || found.weight != weights[i] || found.node != nodes[i];
    }
    CHECK(wrong == 0);
  }
}

}  // namespace

TEST_CASE("words, weights and nodes are those of a plain walk, on both paths", "[bow]") {
  compare_with_walk<256>({.branching = 10, .depth = 3}, 1, 300);
  compare_with_walk<256>({.branching = 9, .depth = 2, .full = false, .unnamed_leaves = true}, 2, 200);
  compare_with_walk<256>({.branching = 3, .depth = 4, .full = false}, 3, 200);
  compare_with_walk<256>({.branching = 20, .depth = 2, .alike = true}, 4, 200);
  compare_with_walk<64>({.bits = 64, .branching = 7, .depth = 2, .full = false}, 5, 200);
  compare_with_walk<512>({.bits = 512, .branching = 11, .depth = 2}, 6, 100);
  compare_with_walk<2048>({.bits = 2048, .branching = 5, .depth = 2}, 7, 50);
}

TEST_CASE("a bag sums, weights and normalises as the weighting and the score say", "[bow]") {
  for (int weighting = 0; weighting < 4; ++weighting)
    for (int score = 0; score < 6; ++score)
      for (const int branching : {10, 60}) {  // dense and sparse bags
        VocabularyTree tree = random_tree({.branching = branching, .depth = 2}, 11);
        tree.weighting = static_cast<BagWeighting>(weighting);
        tree.score = static_cast<BagScore>(score);
        const OrbVocabulary vocabulary(tree);
        const auto descriptors = random_descriptors<256>(tree, 400, 12);
        Bag bag;
        DirectIndex index;
        TransformBuffers buffers;
        vocabulary.transform(descriptors, 1, bag, index, buffers);
        CHECK(bag == vocabulary.transform(descriptors));
        CHECK(bag.dense().empty() == (branching == 60));

        std::vector<std::uint32_t> words(400), nodes(400);
        std::vector<double> weights(400);
        vocabulary.find_words(descriptors, words, weights, 1, nodes);
        std::map<std::uint32_t, double> expected;
        std::map<std::uint32_t, std::vector<std::uint32_t>> below;
        for (std::size_t i = 0; i < 400; ++i) {
          if (weights[i] <= 0) continue;
          if (weighting < 2)
            expected[words[i]] += weights[i];
          else
            expected[words[i]] = weights[i];
          below[nodes[i]].push_back(static_cast<std::uint32_t>(i));
        }
        double norm = 0;
        for (const auto& [word, weight] : expected) norm += score == 1 ? weight * weight : weight;
        if (score == 1) norm = std::sqrt(norm);
        if (score == 5) norm = weighting < 2 ? static_cast<double>(expected.size()) : 1.0;
        REQUIRE(bag.size() == expected.size());
        std::size_t i = 0;
        for (const auto& [word, weight] : expected) {
          CHECK(bag.words()[i] == word);
          CHECK(bag.weights()[i] == Approx(weight / norm).epsilon(1e-14));
          ++i;
        }
        REQUIRE(index.size() == below.size());
        i = 0;
        for (const auto& [node, features] : below) {
          CHECK(index.nodes[i] == node);
          const auto found = index.features_of(i);
          CHECK(std::vector<std::uint32_t>(found.begin(), found.end()) == features);
          ++i;
        }
      }
}

TEST_CASE("no features give an empty bag", "[bow]") {
  const OrbVocabulary vocabulary(random_tree({}, 3));
  const Bag bag = vocabulary.transform({});
  CHECK(bag.empty());
  CHECK(vocabulary.score(bag, bag) == 0);
}

TEST_CASE("a vocabulary survives its own file and its tree", "[bow]") {
  const ScratchFolder folder;
  const std::string path = (folder.path() / "vocabulary.swv").string();
  for (const std::uint64_t seed : {1, 2, 3}) {
    const VocabularyTree tree =
        random_tree({.branching = 8, .depth = 3, .full = seed == 1, .unnamed_leaves = seed == 3}, seed);
    const OrbVocabulary vocabulary(tree);
    CHECK(vocabulary.tree() == sorted_by_level(tree));
    CHECK_NOTHROW(vocabulary.image().verify());
    vocabulary.save(path);
    const auto opened = OrbVocabulary::open(path);
    CHECK(opened.tree() == vocabulary.tree());
    CHECK_NOTHROW(opened.image().verify());
    const auto descriptors = random_descriptors<256>(tree, 100, seed);
    CHECK(opened.transform(descriptors) == vocabulary.transform(descriptors));
    CHECK_THROWS_AS(Vocabulary<512>::open(path), Error);
  }
}

TEST_CASE("damaged files of our own format give errors, never more", "[bow]") {
  const ScratchFolder folder;
  const std::string path = (folder.path() / "vocabulary.swv").string();
  const VocabularyTree tree = random_tree({.branching = 4, .depth = 3, .full = false}, 5);
  OrbVocabulary(tree).save(path);
  std::ifstream in(path, std::ios::binary);
  const std::string whole((std::istreambuf_iterator<char>(in)), {});
  const auto descriptors = random_descriptors<256>(tree, 50, 6);
  Random random(7);
  int refused = 0, unnoticed = 0;
  for (int trial = 0; trial < 600; ++trial) {
    std::string damaged = whole;
    if (trial % 4 == 0) {
      damaged.resize(random.index(whole.size()));
    } else {
      const std::size_t reach = trial % 4 == 1 ? 128 : whole.size();
      for (std::uint64_t k = 0; k <= random.index(4); ++k)
        damaged[random.index(reach)] = static_cast<char>(random());
      if (damaged == whole) continue;
    }
    const std::string file = (folder.path() / ("d" + std::to_string(trial))).string();
    std::ofstream(file, std::ios::binary) << damaged;
    try {
      const auto opened = OrbVocabulary::open(file);
      try {
        const Bag bag = opened.transform(descriptors);
        for (const double weight : bag.weights()) CHECK(std::isfinite(weight));
        opened.score(bag, bag);
        (void)opened.tree();
      } catch (const Error& error) {
        CHECK(error.kind() == ErrorKind::data);
      }
      opened.image().verify();
      // Bytes of the header that nothing reads.
      ++unnoticed;
    } catch (const Error& error) {
      CHECK((error.kind() == ErrorKind::data || error.kind() == ErrorKind::io));
      ++refused;
    }
    std::filesystem::remove(file);
  }
  CHECK(refused > 450);
  CHECK(unnoticed < 100);
  CHECK_THROWS_AS(OrbVocabulary::open((folder.path() / "absent.swv").string()), Error);
}

TEST_CASE("wrong trees and wrong calls are refused", "[bow]") {
  const auto refused = [](auto change) {
    VocabularyTree tree = random_tree({.branching = 3, .depth = 2}, 1);
    change(tree);
    CHECK_THROWS_AS(OrbVocabulary(tree), Error);
  };
  refused([](VocabularyTree& t) { t.parent[2] = 5; });
  refused([](VocabularyTree& t) { t.word[1] = 3; });
  refused([](VocabularyTree& t) { t.weight.back() = -1; });
  refused([](VocabularyTree& t) { t.weight.back() = std::nan(""); });
  refused([](VocabularyTree& t) { t.word.back() = 0x7fffffffu; });
  refused([](VocabularyTree& t) { t.descriptors.pop_back(); });
  refused([](VocabularyTree& t) { t.bits = 100; });
  refused([](VocabularyTree& t) { t.branching = 0; });
  refused([](VocabularyTree& t) { t = VocabularyTree(); });

  const OrbVocabulary none;
  CHECK_THROWS_AS(none.transform({}), Error);
  const OrbVocabulary vocabulary(random_tree({}, 1));
  std::vector<OrbDescriptor> two(2);
  std::vector<std::uint32_t> words(1);
  std::vector<double> weights(2);
  CHECK_THROWS_AS(vocabulary.find_words(two, words, weights), Error);
  CHECK_THROWS_AS(Bag({1, 1}, {1, 1}, 5), Error);
  CHECK_THROWS_AS(Bag({1, 7}, {1, 1}, 5), Error);
  CHECK_THROWS_AS(Bag({1}, {1, 1}, 5), Error);
}
