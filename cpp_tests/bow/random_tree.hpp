// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "sweepkit/bow/vocabulary_tree.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/feature/descriptor.hpp"

// Trees and descriptors that the tests of this folder share.

struct RandomTreeShape {
  int bits = 256;
  int branching = 10;
  int depth = 3;
  bool full = true;             ///< every node has all children, else some are leaves before their time
  bool unnamed_leaves = false;  ///< some leaves have no word
  bool alike = false;           ///< many children lie equally near
};

inline sweepkit::VocabularyTree random_tree(const RandomTreeShape& shape, std::uint64_t seed) {
  using sweepkit::VocabularyTree;
  sweepkit::Random random(seed);
  VocabularyTree tree;
  tree.bits = shape.bits;
  tree.branching = shape.branching;
  tree.depth = shape.depth;
  std::vector<std::uint64_t> words(static_cast<std::size_t>(shape.bits / 64), 0);
  tree.add(0, VocabularyTree::kNoWord, 0.0, words);
  std::vector<std::uint32_t> level{0};
  std::uint32_t next_word = 0;
  const auto name_leaf = [&](std::uint32_t node) {
    if (shape.unnamed_leaves && random.index(5) == 0) return;
    tree.word[node] = next_word++;
    tree.weight[node] = random.index(6) == 0 ? 0.0 : random.uniform(0.1, 9.0);
  };
  for (int depth = 1; depth <= shape.depth; ++depth) {
    std::vector<std::uint32_t> below;
    for (const std::uint32_t parent : level) {
      if (!shape.full && depth > 1 && random.index(4) == 0) {
        name_leaf(parent);
        continue;
      }
      const int count = shape.full
                            ? shape.branching
                            : 1 + static_cast<int>(random.index(static_cast<std::uint64_t>(shape.branching)));
      for (int c = 0; c < count; ++c) {
        for (auto& word : words) word = shape.alike ? random() & 0x3u : random();
        below.push_back(tree.add(parent, VocabularyTree::kNoWord, 0.0, words));
      }
    }
    level = below;
  }
  for (const std::uint32_t node : level) name_leaf(node);
  return tree;
}

/// Descriptors near nodes of the tree, and some anywhere.
template <int Bits>
std::vector<sweepkit::BinaryDescriptor<Bits>> random_descriptors(const sweepkit::VocabularyTree& tree,
                                                                 std::size_t count, std::uint64_t seed) {
  sweepkit::Random random(seed);
  std::vector<sweepkit::BinaryDescriptor<Bits>> descriptors(count);
  for (auto& descriptor : descriptors) {
    const auto node = tree.descriptor(random.index(tree.size()));
    const bool anywhere = random.index(8) == 0;
    for (std::size_t w = 0; w < node.size(); ++w)
      descriptor.words[w] = anywhere ? random() : node[w] ^ (random() & random() & random());
  }
  return descriptors;
}
