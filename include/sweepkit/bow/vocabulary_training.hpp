// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <numeric>
#include <span>
#include <vector>

#include "sweepkit/bow/bag.hpp"
#include "sweepkit/bow/impl/k_majority.hpp"
#include "sweepkit/bow/vocabulary.hpp"
#include "sweepkit/bow/vocabulary_tree.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/core/options.hpp"
#include "sweepkit/core/parallel.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/feature/descriptor.hpp"

namespace sweepkit {

struct VocabularyTrainingOptions {
  int branching = 10;
  int depth = 3;
  BagWeighting weighting = BagWeighting::tf_idf;
  BagScore score = BagScore::l1;
  int iterations = 30;
  int candidates = 3;
  int seed = 1;
  int threads = 0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(branching, "branching", "", range(2, 1000), "children of a node");
    v(depth, "depth", "", range(1, 12), "levels below the root; words are at most branching ^ depth");
    v.choice(weighting, "weighting",
             {{BagWeighting::tf_idf, "tf_idf"},
              {BagWeighting::tf, "tf"},
              {BagWeighting::idf, "idf"},
              {BagWeighting::binary, "binary"}},
             "weight of a word in a bag");
    v.choice(score, "score",
             {{BagScore::l1, "l1"},
              {BagScore::l2, "l2"},
              {BagScore::chi_square, "chi_square"},
              {BagScore::kl, "kl"},
              {BagScore::bhattacharyya, "bhattacharyya"},
              {BagScore::dot, "dot"}},
             "how bags are compared");
    v(iterations, "iterations", "", range(0, 10000), "most rounds of clustering a node");
    v(candidates, "candidates", "", range(1, 100), "descriptors tried for each seed of a cluster");
    v(seed, "seed", "", range(0, 2147483647), "seed of the random numbers");
    v(threads, "threads", "", range(0, 1024), "0: as many as the machine has; the result is the same");
  }
};

/// Called with the part done, in [0, 1], from the thread that trains; what it throws ends the training.
using TrainingProgress = std::function<void(double)>;

/// Trains a vocabulary: descriptors are clustered, then those of each cluster, and so on `depth` levels down
/// (hierarchical k-majority). A cluster of one descriptor, or of several alike, is a leaf. The same input,
/// options and binary give the same tree, whatever the number of threads.
/// @param images descriptors of each training image: with TF-IDF and IDF a word's weight is
///   log(images / images that have it)
/// Throws Error(argument) without descriptors, Error(option) for options out of range.
template <int Bits>
VocabularyTree train_vocabulary(std::span<const std::vector<BinaryDescriptor<Bits>>> images,
                                const VocabularyTrainingOptions& options = {},
                                const TrainingProgress& progress = {}) {
  using Descriptor = BinaryDescriptor<Bits>;
  check_options(options);
  // Descriptors of one node lie together; each level sorts them anew.
  std::vector<Descriptor> descriptors, sorted;
  for (const auto& image : images) descriptors.insert(descriptors.end(), image.begin(), image.end());
  require(!descriptors.empty(), "train_vocabulary images", "must have descriptors", descriptors.size());
  require(descriptors.size() < 0x7fffffffu, "train_vocabulary images", "have too many descriptors",
          descriptors.size());
  sorted.resize(descriptors.size());

  VocabularyTree tree;
  tree.bits = Bits;
  tree.branching = options.branching;
  tree.depth = options.depth;
  tree.weighting = options.weighting;
  tree.score = options.score;
  const Descriptor zero{};
  tree.add(0, VocabularyTree::kNoWord, 0.0, zero.words);

  struct Family {
    std::uint32_t node;
    std::size_t begin, end;           // its descriptors
    std::vector<Descriptor> centres;  // its children
    std::vector<std::size_t> sizes;   // their numbers of descriptors
  };
  std::vector<Family> level{{0, 0, descriptors.size(), {}, {}}};
  const int threads = thread_count(options.threads);
  std::vector<impl::KMajority<Bits>> clusterers(static_cast<std::size_t>(threads));
  for (int depth = 1; depth <= options.depth && !level.empty(); ++depth) {
    const auto split = [&](Family& family, impl::KMajority<Bits>& clusterer, int inner_threads) {
      const auto own = std::span(descriptors).subspan(family.begin, family.end - family.begin);
      // Each node has random numbers of its own, so that the order of work does not matter.
      Random random(static_cast<std::uint64_t>(options.seed) * 0x9e3779b97f4a7c15u ^ family.node);
      clusterer.run(own, {options.branching, options.iterations, options.candidates, inner_threads}, random);
      const auto centres = clusterer.centres();
      const auto labels = clusterer.labels();
      family.centres.assign(centres.begin(), centres.end());
      family.sizes.assign(centres.size(), 0);
      for (const std::uint16_t label : labels) ++family.sizes[label];
      std::vector<std::size_t> next(centres.size(), family.begin);
      for (std::size_t c = 1; c < centres.size(); ++c) next[c] = next[c - 1] + family.sizes[c - 1];
      for (std::size_t i = 0; i < own.size(); ++i) sorted[next[labels[i]]++] = own[i];
    };
    // Few large nodes: threads share each. Many: each thread takes whole ones.
    const bool few = level.size() < 4 * static_cast<std::size_t>(threads);
    const std::size_t chunk = few ? 1 : 64 * static_cast<std::size_t>(threads);
    for (std::size_t from = 0; from < level.size(); from += chunk) {
      const std::size_t size = std::min(chunk, level.size() - from);
      if (few)
        split(level[from], clusterers[0], threads);
      else
        parallel_blocks(size, threads, [&](std::size_t begin, std::size_t end, std::size_t block) {
          for (std::size_t i = begin; i < end; ++i) split(level[from + i], clusterers[block], 1);
        });
      if (progress)
        progress((depth - 1 + static_cast<double>(from + size) / static_cast<double>(level.size())) /
                 options.depth);
    }
    descriptors.swap(sorted);
    std::vector<Family> below;
    for (const Family& family : level) {
      // Nothing to tell apart: the node itself is the leaf.
      if (family.centres.size() < 2 && family.node != 0) continue;
      std::size_t begin = family.begin;
      for (std::size_t c = 0; c < family.centres.size(); ++c) {
        const std::uint32_t child =
            tree.add(family.node, VocabularyTree::kNoWord, 0.0, family.centres[c].words);
        if (family.sizes[c] > 1) below.push_back({child, begin, begin + family.sizes[c], {}, {}});
        begin += family.sizes[c];
      }
    }
    level = std::move(below);
  }

  // Leaves are words, in their order.
  std::vector<std::uint8_t> inner(tree.size(), 0);
  for (std::size_t i = 1; i < tree.size(); ++i) inner[tree.parent[i]] = 1;
  std::vector<std::uint32_t> leaves;
  for (std::size_t i = 1; i < tree.size(); ++i)
    if (!inner[i]) {
      tree.word[i] = static_cast<std::uint32_t>(leaves.size());
      tree.weight[i] = 1.0;
      leaves.push_back(static_cast<std::uint32_t>(i));
    }
  if (options.weighting == BagWeighting::tf_idf || options.weighting == BagWeighting::idf) {
    const Vocabulary<Bits> vocabulary(tree);
    std::vector<std::uint32_t> images_with(leaves.size(), 0), last(leaves.size(), 0), words;
    std::vector<double> weights;
    for (std::size_t image = 0; image < images.size(); ++image) {
      words.resize(images[image].size());
      weights.resize(words.size());
      vocabulary.find_words(images[image], words, weights);
      for (const std::uint32_t word : words)
        if (last[word] != image + 1) {
          last[word] = static_cast<std::uint32_t>(image + 1);
          ++images_with[word];
        }
    }
    // A word that no descriptor reaches tells nothing.
    for (std::size_t word = 0; word < leaves.size(); ++word)
      tree.weight[leaves[word]] =
          images_with[word] > 0
              ? std::log(static_cast<double>(images.size()) / static_cast<double>(images_with[word]))
              : 0.0;
  }
  return tree;
}

}  // namespace sweepkit
