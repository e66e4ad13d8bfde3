// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/vocabulary_training.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <set>

#include "bow/random_tree.hpp"
#include "sweepkit/bow/impl/majority.hpp"

using namespace sweepkit;

namespace {

/// Images of descriptors about the leaves of a hidden tree.
template <int Bits>
std::vector<std::vector<BinaryDescriptor<Bits>>> images_about(const VocabularyTree& tree, std::size_t images,
                                                              std::size_t each, std::uint64_t seed) {
  std::vector<std::vector<BinaryDescriptor<Bits>>> result;
  for (std::size_t i = 0; i < images; ++i) result.push_back(random_descriptors<Bits>(tree, each, seed + i));
  return result;
}

/// Mean distance of descriptors to the leaves they reach.
template <int Bits>
double quantisation_error(const VocabularyTree& unsorted,
                          const std::vector<std::vector<BinaryDescriptor<Bits>>>& images) {
  const VocabularyTree tree = sorted_by_level(unsorted);
  const Vocabulary<Bits> vocabulary(tree);
  double sum = 0;
  std::size_t count = 0;
  for (const auto& image : images) {
    std::vector<std::uint32_t> words(image.size()), nodes(image.size());
    std::vector<double> weights(image.size());
    vocabulary.find_words(image, words, weights, 1000, nodes);
    for (std::size_t i = 0; i < image.size(); ++i) {
      BinaryDescriptor<Bits> leaf;
      std::copy_n(tree.descriptor(nodes[i]).begin(), leaf.words.size(), leaf.words.begin());
      sum += hamming_distance(image[i], leaf);
      ++count;
    }
  }
  return sum / static_cast<double>(count);
}

/// Hierarchical k-majority written down plainly: k-means++ seeds, rounds until nothing changes.
struct PlainTrainer {
  using Descriptor = OrbDescriptor;
  VocabularyTree tree;
  Random random;

  void split(std::uint32_t node, const std::vector<Descriptor>& own, int depth) {
    const auto k = static_cast<std::size_t>(tree.branching);
    std::vector<Descriptor> centres{own[random.index(own.size())]};
    std::vector<double> nearest(own.size(), 1e9);
    while (centres.size() < k) {
      double sum = 0;
      for (std::size_t i = 0; i < own.size(); ++i)
        sum += nearest[i] = std::min<double>(nearest[i], hamming_distance(own[i], centres.back()));
      if (sum == 0) break;
      double target = random.uniform() * sum;
      std::size_t i = 0;
      while (i + 1 < own.size() && (target -= nearest[i]) >= 0) ++i;
      centres.push_back(own[i]);
    }
    std::vector<std::size_t> label(own.size(), k);
    for (bool changed = true; changed;) {
      changed = false;
      for (std::size_t i = 0; i < own.size(); ++i) {
        std::size_t best = 0;
        for (std::size_t c = 1; c < centres.size(); ++c)
          if (hamming_distance(own[i], centres[c]) < hamming_distance(own[i], centres[best])) best = c;
        changed |= label[i] != best;
        label[i] = best;
      }
      for (std::size_t c = 0; c < centres.size(); ++c) {
        std::array<int, 256> votes{};
        int members = 0;
        for (std::size_t i = 0; i < own.size(); ++i) {
          if (label[i] != c) continue;
          ++members;
          for (std::size_t b = 0; b < 256; ++b) votes[b] += own[i].words[b / 64] >> (b % 64) & 1;
        }
        if (members == 0) continue;
        for (std::size_t b = 0; b < 256; ++b) {
          const std::uint64_t bit = std::uint64_t{1} << (b % 64);
          centres[c].words[b / 64] =
              2 * votes[b] >= members ? centres[c].words[b / 64] | bit : centres[c].words[b / 64] & ~bit;
        }
      }
    }
    for (std::size_t c = 0; c < centres.size(); ++c) {
      std::vector<Descriptor> members;
      for (std::size_t i = 0; i < own.size(); ++i)
        if (label[i] == c) members.push_back(own[i]);
      const auto child = tree.add(node, VocabularyTree::kNoWord, 1.0, centres[c].words);
      if (depth < tree.depth && members.size() > k) split(child, members, depth + 1);
    }
  }
};

}  // namespace

TEST_CASE("majority is that of a plain count", "[bow]") {
  Random random(1);
  for (const std::size_t count : {1, 2, 3, 4, 7, 8, 15, 16, 100, 1023}) {
    std::vector<BinaryDescriptor<128>> descriptors(count);
    impl::MajorityCounter<128> counter;
    for (auto& d : descriptors) {
      for (auto& word : d.words) word = random();
      counter.add(d);
    }
    BinaryDescriptor<128> tie;
    for (auto& word : tie.words) word = random();
    const auto majority = counter.majority(tie);
    for (std::size_t b = 0; b < 128; ++b) {
      std::size_t votes = 0;
      for (const auto& d : descriptors) votes += d.words[b / 64] >> (b % 64) & 1;
      const bool expected = 2 * votes == count ? tie.words[b / 64] >> (b % 64) & 1 : 2 * votes > count;
      CHECK((majority.words[b / 64] >> (b % 64) & 1) == expected);
    }
  }
}

TEST_CASE("training gives a tree of the shape asked for, the same for any number of threads", "[bow]") {
  const auto images = images_about<256>(random_tree({.branching = 6, .depth = 3}, 1), 20, 600, 2);
  VocabularyTrainingOptions options;
  options.branching = 6;
  options.depth = 3;
  options.threads = 1;
  std::vector<double> progress;
  const auto tree = train_vocabulary<256>(images, options, [&](double part) { progress.push_back(part); });
  CHECK(std::is_sorted(progress.begin(), progress.end()));
  CHECK(progress.back() == 1.0);
  CHECK_NOTHROW(check_vocabulary_tree(tree));
  CHECK(OrbVocabulary(tree).word_count() <= 216);
  CHECK(OrbVocabulary(tree).word_count() > 150);
  for (const int threads : {2, 5}) {
    options.threads = threads;
    CHECK(train_vocabulary<256>(images, options) == tree);
  }
  {
    ScopedSimdLevel portable(SimdLevel::portable);
    CHECK(train_vocabulary<256>(images, options) == tree);
  }
  options.seed = 2;
  CHECK_FALSE(train_vocabulary<256>(images, options) == tree);
}

TEST_CASE("training loses no more than plain hierarchical k-majority", "[bow]") {
  const auto images = images_about<256>(random_tree({.branching = 8, .depth = 3}, 3), 10, 500, 4);
  VocabularyTrainingOptions options;
  options.branching = 8;
  options.depth = 2;
  std::vector<OrbDescriptor> all;
  for (const auto& image : images) all.insert(all.end(), image.begin(), image.end());
  double ours = 0, plain = 0;
  for (int seed = 1; seed <= 3; ++seed) {
    options.seed = seed;
    ours += quantisation_error<256>(train_vocabulary<256>(images, options), images);
    PlainTrainer trainer{{}, Random(static_cast<std::uint64_t>(seed))};
    trainer.tree.branching = 8;
    trainer.tree.depth = 2;
    const OrbDescriptor zero{};
    trainer.tree.add(0, VocabularyTree::kNoWord, 0.0, zero.words);
    trainer.split(0, all, 1);
    std::set<std::uint32_t> parents(trainer.tree.parent.begin(), trainer.tree.parent.end());
    for (std::uint32_t i = 1, word = 0; i < trainer.tree.size(); ++i)
      if (!parents.count(i)) trainer.tree.word[i] = word++;
    plain += quantisation_error<256>(trainer.tree, images);
  }
  CHECK(ours <= 1.01 * plain);
}

TEST_CASE("weights are the inverse document frequencies", "[bow]") {
  const auto images = images_about<64>(random_tree({.bits = 64, .branching = 5, .depth = 2}, 5), 12, 40, 6);
  VocabularyTrainingOptions options;
  options.branching = 4;
  options.depth = 2;
  const Vocabulary<64> vocabulary(train_vocabulary<64>(images, options));
  std::vector<std::set<std::uint32_t>> words_of;
  std::vector<double> weight_of(vocabulary.word_count());
  for (const auto& image : images) {
    std::vector<std::uint32_t> words(image.size());
    std::vector<double> weights(image.size());
    vocabulary.find_words(image, words, weights);
    words_of.emplace_back(words.begin(), words.end());
    for (std::size_t i = 0; i < words.size(); ++i) weight_of[words[i]] = weights[i];
  }
  for (std::uint32_t word = 0; word < vocabulary.word_count(); ++word) {
    int with = 0;
    for (const auto& words : words_of) with += words.count(word) > 0;
    if (with > 0) CHECK(weight_of[word] == Approx(std::log(12.0 / with)).margin(1e-15));
  }
  options.weighting = BagWeighting::tf;
  const auto plain = train_vocabulary<64>(images, options);
  for (std::size_t i = 0; i < plain.size(); ++i)
    if (plain.word[i] != VocabularyTree::kNoWord) CHECK(plain.weight[i] == 1.0);
}

TEST_CASE("few or equal descriptors make small trees", "[bow]") {
  std::vector<std::vector<OrbDescriptor>> images(2);
  images[0].resize(30);
  CHECK(OrbVocabulary(train_vocabulary<256>(images)).word_count() == 1);
  images[1].resize(5);
  for (std::size_t i = 0; i < 5; ++i) images[1][i].words[0] = i;
  // Five different ones, no more than branching: each is a word.
  CHECK(OrbVocabulary(train_vocabulary<256>(images)).word_count() == 5);
  CHECK_THROWS_AS(train_vocabulary<256>({}), Error);
  VocabularyTrainingOptions options;
  options.branching = 1;
  CHECK_THROWS_AS(train_vocabulary<256>(images, options), Error);
}

TEST_CASE("what the progress callback throws ends the training", "[bow]") {
  const auto images = images_about<256>(random_tree({}, 7), 4, 100, 8);
  CHECK_THROWS_AS(train_vocabulary<256>(images, {}, [](double) { throw std::runtime_error("enough"); }),
                  std::runtime_error);
}
