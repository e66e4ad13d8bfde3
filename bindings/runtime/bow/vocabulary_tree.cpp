// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/vocabulary_tree.hpp"

#include <limits>

#include "sweepkit/core/error.hpp"

namespace sweepkit {

void check_vocabulary_tree(const VocabularyTree& tree) {
  const char* place = "VocabularyTree";
  constexpr double kLargest = 1e30;
  require(tree.bits >= 64 && tree.bits <= 16384 && tree.bits % 64 == 0, place,
          "bits must be a multiple of 64 and at most 16384", tree.bits);
  require(tree.branching >= 1 && tree.branching <= 65535, place, "branching must lie in [1, 65535]",
          tree.branching);
  require(tree.depth >= 1 && tree.depth <= 1000, place, "depth must lie in [1, 1000]", tree.depth);
  const auto weighting = static_cast<int>(tree.weighting), score = static_cast<int>(tree.score);
  require(weighting >= 0 && weighting <= 3, place, "there is no such weighting", weighting);
  require(score >= 0 && score <= 5, place, "there is no such score", score);
  const std::size_t size = tree.size();
  require(size >= 2, place, "must have a word", size);
  require(size < VocabularyTree::kNoWord, place, "has too many nodes", size);
  require(tree.word.size() == size && tree.weight.size() == size &&
              tree.descriptors.size() == size * static_cast<std::size_t>(tree.words_per_descriptor()),
          place, "must have a word, a weight and a descriptor for each node", tree.word.size());
  require(tree.parent[0] == 0, place, "the root must be its own parent", tree.parent[0]);
  std::vector<std::uint32_t> children(size, 0);
  for (std::size_t i = 1; i < size; ++i) {
    require(tree.parent[i] < i, place, "a parent must stand before its children; parent", tree.parent[i]);
    require(++children[tree.parent[i]] <= 65535, place, "too many children of node", tree.parent[i]);
  }
  bool any_word = false;
  for (std::size_t i = 0; i < size; ++i) {
    if (tree.word[i] == VocabularyTree::kNoWord) continue;
    any_word = true;
    require(children[i] == 0 && i > 0, place, "an inner node has a word; node", i);
    require(tree.word[i] < 0x7fffffffu, place, "a word is too large", tree.word[i]);
    require(tree.weight[i] >= 0 && tree.weight[i] <= kLargest, place,
            "weights must be finite and not negative", tree.weight[i]);
  }
  require(any_word, place, "must have a word", 0);
}

VocabularyTree sorted_by_level(const VocabularyTree& tree) {
  check_vocabulary_tree(tree);
  const std::size_t size = tree.size();
  // Children of each node, in their order.
  std::vector<std::uint32_t> begin(size + 1, 0), children(size - 1);
  for (std::size_t i = 1; i < size; ++i) ++begin[tree.parent[i] + 1];
  for (std::size_t i = 0; i < size; ++i) begin[i + 1] += begin[i];
  std::vector<std::uint32_t> next(begin.begin(), begin.end() - 1);
  for (std::size_t i = 1; i < size; ++i) children[next[tree.parent[i]]++] = static_cast<std::uint32_t>(i);

  VocabularyTree sorted;
  sorted.bits = tree.bits;
  sorted.branching = tree.branching;
  sorted.depth = tree.depth;
  sorted.weighting = tree.weighting;
  sorted.score = tree.score;
  sorted.parent.reserve(size);
  sorted.word.reserve(size);
  sorted.weight.reserve(size);
  sorted.descriptors.reserve(tree.descriptors.size());
  std::vector<std::uint32_t> order{0};
  order.reserve(size);
  const std::vector<std::uint64_t> zero(static_cast<std::size_t>(tree.words_per_descriptor()), 0);
  sorted.add(0, VocabularyTree::kNoWord, 0.0, zero);
  for (std::size_t k = 0; k < order.size(); ++k) {
    const std::uint32_t node = order[k];
    for (std::uint32_t c = begin[node]; c < begin[node + 1]; ++c) {
      const std::uint32_t child = children[c];
      order.push_back(child);
      const bool has_word = tree.word[child] != VocabularyTree::kNoWord;
      sorted.add(static_cast<std::uint32_t>(k), tree.word[child], has_word ? tree.weight[child] : 0.0,
                 tree.descriptor(child));
    }
  }
  return sorted;
}

}  // namespace sweepkit
