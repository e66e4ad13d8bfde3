// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "sweepkit/bow/bag.hpp"

namespace sweepkit {

/// A vocabulary as plain data: what training makes and what files of other libraries hold. Node 0 is the
/// root; a parent stands before its children, and the children of a node are in the order in which they
/// are compared (of equally near ones the first wins).
struct VocabularyTree {
  /// No word: inner nodes, and leaves that a file left without.
  static constexpr std::uint32_t kNoWord = 0xffffffffu;

  int bits = 256;  ///< of a descriptor, a multiple of 64
  int branching = 10;
  int depth = 6;  ///< levels below the root, as the maker asked for
  BagWeighting weighting = BagWeighting::tf_idf;
  BagScore score = BagScore::l1;

  std::vector<std::uint32_t> parent;       ///< for each node; parent[0] is 0
  std::vector<std::uint32_t> word;         ///< for each node; below 2^31 - 1, or kNoWord
  std::vector<double> weight;              ///< for each node; that of inner nodes is not used
  std::vector<std::uint64_t> descriptors;  ///< bits / 64 words a node; those of the root are not used

  std::size_t size() const { return parent.size(); }
  int words_per_descriptor() const { return bits / 64; }
  std::span<const std::uint64_t> descriptor(std::size_t node) const {
    const auto length = static_cast<std::size_t>(words_per_descriptor());
    return std::span(descriptors).subspan(node * length, length);
  }
  /// Appends a node and returns its number.
  std::uint32_t add(std::uint32_t parent_node, std::uint32_t word_id, double word_weight,
                    std::span<const std::uint64_t> words) {
    parent.push_back(parent_node);
    word.push_back(word_id);
    weight.push_back(word_weight);
    descriptors.insert(descriptors.end(), words.begin(), words.end());
    return static_cast<std::uint32_t>(parent.size() - 1);
  }

  friend bool operator==(const VocabularyTree&, const VocabularyTree&) = default;
};

/// Throws Error(argument) unless the tree is one that Vocabulary takes: at least one child of the root, at
/// most 65535 children a node, parents before children, words on leaves alone, weights finite and not
/// negative.
void check_vocabulary_tree(const VocabularyTree& tree);

/// The same tree with its nodes level by level and, within a level, family by family: the form in which two
/// trees can be compared, and the numbering of Vocabulary's nodes.
VocabularyTree sorted_by_level(const VocabularyTree& tree);

}  // namespace sweepkit
