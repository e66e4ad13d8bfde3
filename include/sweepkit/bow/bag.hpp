// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "sweepkit/core/error.hpp"

namespace sweepkit {

/// How often a word occurs in an image, and what that is worth (Sivic and Zisserman 2003). The numbers are
/// those of DBoW2's files.
enum class BagWeighting {
  tf_idf = 0,  ///< occurrences times log(images / images with the word)
  tf = 1,      ///< occurrences
  idf = 2,     ///< log(images / images with the word), once
  binary = 3,  ///< one
};

/// How alike two bags are (Nister and Stewenius 2006; Galvez-Lopez and Tardos 2012). The numbers are those of
/// DBoW2's files.
enum class BagScore {
  l1 = 0,             ///< 1 - |v - w|_1 / 2, in [0, 1]
  l2 = 1,             ///< 1 - sqrt(1 - v . w), in [0, 1]
  chi_square = 2,     ///< 2 sum of v w / (v + w), in [0, 1]
  kl = 3,             ///< Kullback-Leibler divergence of w from v, at least 0: the smaller the more alike
  bhattacharyya = 4,  ///< sum of sqrt(v w), in [0, 1]
  dot = 5,            ///< v . w
};

/// The words of an image, sorted, each once, with their weights (not negative, finite). Bags of small
/// vocabularies also hold the weights of all words, for faster scores.
class Bag {
 public:
  /// Vocabularies of at most so many words give dense bags as well.
  static constexpr std::uint32_t kDenseWords = 2048;

  Bag() = default;
  /// @param words ascending, without repetition, below word_count
  /// @param weights one for each word
  /// @param word_count number of words of the vocabulary
  /// Throws Error(argument) where these do not hold.
  Bag(std::vector<std::uint32_t> words, std::vector<double> weights, std::uint32_t word_count);

  std::span<const std::uint32_t> words() const { return words_; }
  std::span<const double> weights() const { return weights_; }
  /// The weight of every word, zeros behind up to a multiple of 16; empty for large vocabularies.
  std::span<const double> dense() const { return dense_; }
  std::size_t size() const { return words_.size(); }
  bool empty() const { return words_.empty(); }

  friend bool operator==(const Bag&, const Bag&) = default;

 private:
  friend class BagMaker;

  std::vector<std::uint32_t> words_;
  std::vector<double> weights_;
  std::vector<double> dense_;
};

/// Which features of an image lie below which node on one level of the tree: only features of the same node
/// need be compared when two images are matched.
struct DirectIndex {
  std::vector<std::uint32_t> nodes;     ///< ascending, each once
  std::vector<std::uint32_t> begin;     ///< nodes.size() + 1 positions in `features`
  std::vector<std::uint32_t> features;  ///< node by node, ascending within one

  std::size_t size() const { return nodes.size(); }
  /// Features below nodes[i].
  std::span<const std::uint32_t> features_of(std::size_t i) const {
    return std::span(features).subspan(begin[i], begin[i + 1] - begin[i]);
  }
  void clear() {
    nodes.clear();
    begin.assign(1, 0);
    features.clear();
  }
  friend bool operator==(const DirectIndex&, const DirectIndex&) = default;
};

/// Makes bags and direct indices out of the words of features; keeps its buffers. Not thread-safe.
class BagMaker {
 public:
  /// @param words,weights word and weight of each feature; features of weight 0 are left out
  /// Sums, then normalises as the score wants it: L2 for BagScore::l2, for BagScore::dot divided by the
  /// number of words (with TF) or not at all, else L1.
  void make_bag(std::span<const std::uint32_t> words, std::span<const double> weights,
                std::uint32_t word_count, BagWeighting weighting, BagScore score, Bag& bag);
  /// @param nodes node of each feature
  void make_index(std::span<const std::uint32_t> nodes, std::span<const double> weights, DirectIndex& index);

 private:
  /// Leaves `order_` with the indices of the features of positive weight, by key, then by index.
  void sort(std::span<const std::uint32_t> keys, std::span<const double> weights);

  std::vector<std::uint64_t> order_, other_;  // key << 32 | feature
  std::vector<std::uint32_t> counts_;
};

}  // namespace sweepkit
