// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "sweepkit/bow/bag.hpp"
#include "sweepkit/bow/bag_score.hpp"
#include "sweepkit/bow/impl/nearest_child.hpp"
#include "sweepkit/bow/vocabulary_image.hpp"
#include "sweepkit/bow/vocabulary_tree.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/feature/descriptor.hpp"

namespace sweepkit {

/// Buffers of Vocabulary::transform, for callers that keep them. Not thread-safe.
struct TransformBuffers {
  std::vector<std::uint32_t> words, nodes;
  std::vector<double> weights;
  BagMaker maker;
};

/// A tree of visual words for binary descriptors (Nister and Stewenius 2006; Galvez-Lopez and Tardos 2012). A
/// descriptor goes down from the root, at each node to the nearest child, and of equally near ones to the
/// first; the leaf is its word. Words, weights and scores are those of DBoW2 for the same tree. Copies share
/// their memory; threads may share one.
template <int Bits>
class Vocabulary {
  static_assert(Bits % 64 == 0 && Bits >= 64 && Bits <= 16384);

 public:
  using Descriptor = BinaryDescriptor<Bits>;

  /// Has no words.
  Vocabulary() = default;
  /// Throws Error(argument) where the tree is none or has descriptors of other length.
  explicit Vocabulary(const VocabularyTree& tree) : Vocabulary(VocabularyImage(tree)) {}
  /// Throws Error(data) where the image has descriptors of other length.
  explicit Vocabulary(VocabularyImage image) : image_(std::move(image)), info_(image_.info()) {
    if (!image_.empty() && info_.bits != Bits)
      throw Error(ErrorKind::data, image_.place(),
                  "the descriptors must have " + std::to_string(Bits) + " bits", std::to_string(info_.bits));
  }
  /// Maps a file of our own format; see VocabularyImage::open. For files of other libraries see
  /// vocabulary_file.hpp.
  static Vocabulary open(const std::string& path) { return Vocabulary(VocabularyImage::open(path)); }
  void save(const std::string& path) const { image_.save(path); }

  bool empty() const { return image_.empty(); }
  const VocabularyInfo& info() const { return info_; }
  std::uint32_t word_count() const { return info_.word_count; }
  VocabularyTree tree() const { return image_.tree(); }
  const VocabularyImage& image() const { return image_; }

  /// The word of each descriptor and its weight: VocabularyTree::kNoWord and 0 where the tree has a leaf
  /// without a word.
  /// @param words,weights as many as descriptors
  /// @param level depth of `nodes`, 0 the root (DBoW2 counts from below: level = depth - levels up)
  /// @param nodes empty, or as many as descriptors: the node passed on that level, or the leaf if it lies
  ///   higher; numbered level by level
  /// Throws Error(argument) on an empty vocabulary or wrong lengths, Error(data) where the file is damaged.
  void find_words(std::span<const Descriptor> descriptors, std::span<std::uint32_t> words,
                  std::span<double> weights, int level = 0, std::span<std::uint32_t> nodes = {}) const {
    require(!empty(), "Vocabulary", "has no words", 0);
    require(words.size() == descriptors.size() && weights.size() == descriptors.size() &&
                (nodes.empty() || nodes.size() == descriptors.size()),
            "Vocabulary::find_words", "must give as many words, weights and nodes as descriptors",
            words.size());
    require(level >= 0, "Vocabulary::find_words level", "must not be negative", level);
    for (std::size_t from = 0; from < descriptors.size(); from += kBatch) {
      const std::size_t size = std::min(kBatch, descriptors.size() - from);
      descend(descriptors.data() + from, size, words.data() + from, weights.data() + from, level,
              nodes.empty() ? nullptr : nodes.data() + from);
    }
  }

  /// The bag of an image, normalised for the vocabulary's score.
  void transform(std::span<const Descriptor> descriptors, Bag& bag, TransformBuffers& buffers) const {
    buffers.words.resize(descriptors.size());
    buffers.weights.resize(descriptors.size());
    find_words(descriptors, buffers.words, buffers.weights);
    buffers.maker.make_bag(buffers.words, buffers.weights, info_.word_count, info_.weighting, info_.score,
                           bag);
  }

  /// The bag, and which features lie below which node of a level.
  void transform(std::span<const Descriptor> descriptors, int level, Bag& bag, DirectIndex& index,
                 TransformBuffers& buffers) const {
    buffers.words.resize(descriptors.size());
    buffers.weights.resize(descriptors.size());
    buffers.nodes.resize(descriptors.size());
    find_words(descriptors, buffers.words, buffers.weights, level, buffers.nodes);
    buffers.maker.make_bag(buffers.words, buffers.weights, info_.word_count, info_.weighting, info_.score,
                           bag);
    buffers.maker.make_index(buffers.nodes, buffers.weights, index);
  }

  /// One call without kept buffers.
  Bag transform(std::span<const Descriptor> descriptors) const {
    Bag bag;
    TransformBuffers buffers;
    transform(descriptors, bag, buffers);
    return bag;
  }

  /// By the vocabulary's own score; see bag_score.
  double score(const Bag& a, const Bag& b) const { return bag_score(a, b, info_.score); }

 private:
  static constexpr int kWords = Descriptor::kWords;
  /// So many descriptors go down together: while one is compared, the children of the others are fetched.
  static constexpr std::size_t kBatch = 64;
  /// Smaller trees stay in the second-level cache, where fetching ahead gains nothing.
  static constexpr std::uint64_t kCached = 512 * 1024;

  void prefetch(std::uint32_t line) const {
#ifdef __GNUC__
    const std::byte* p = image_.line_address(line);
    const auto count = static_cast<std::size_t>(info_.branching);
    const std::size_t bytes = std::min<std::size_t>(impl::VocabularyBlock::bytes(count, kWords, false), 1024);
    for (std::size_t i = 0; i < bytes; i += impl::VocabularyBlock::kLine) __builtin_prefetch(p + i);
#endif
  }

  void descend(const Descriptor* descriptors, std::size_t size, std::uint32_t* words, double* weights,
               int level, std::uint32_t* nodes) const {
    using Block = impl::VocabularyBlock;
    std::array<impl::ChildSearch, kBatch> searches;
    std::array<Block, kBatch> blocks;
    std::array<std::uint32_t, kBatch> active, line;
    std::array<const double*, kBatch> weight;
    const std::size_t total = size;
    const bool large = info_.bytes > kCached;
    for (std::size_t i = 0; i < size; ++i) {
      active[i] = static_cast<std::uint32_t>(i);
      line[i] = 0;
      if (nodes) nodes[i] = 0;
    }
    for (int depth = 1; size > 0; ++depth) {
      for (std::size_t k = 0; k < size; ++k) {
        const std::uint32_t i = active[k];
        blocks[k] = image_.block(line[i], kWords);
        searches[k] = {descriptors[i].words.data(), blocks[k].planes, blocks[k].count, 0, 0};
      }
      impl::nearest_children<kWords>(searches.data(), size);
      std::size_t left = 0;
      for (std::size_t k = 0; k < size; ++k) {
        const std::uint32_t i = active[k], best = searches[k].best, link = blocks[k].links[best];
        if (nodes && depth <= level) {
          nodes[i] = blocks[k].first_child + best;
          if (nodes[i] >= info_.node_count) [[unlikely]]
            image_.fail("a node has too large a number", nodes[i]);
        }
        if (link & Block::kLeaf) {
          words[i] = link ^ Block::kLeaf;
          if (!blocks[k].has_leaf) image_.fail("a leaf has no weight", line[i]);
          weight[i] = blocks[k].weights + best;
#ifdef __GNUC__
          __builtin_prefetch(weight[i]);
#endif
          continue;
        }
        // Links lead forward: no way down is without end.
        if (link <= line[i]) [[unlikely]]
          image_.fail("a link leads back", link);
        line[i] = link;
        if (large) prefetch(link);
        active[left++] = i;
      }
      size = left;
    }
    for (std::size_t i = 0; i < total; ++i) {
      weights[i] = *weight[i];
      if (words[i] == (VocabularyTree::kNoWord ^ Block::kLeaf)) {
        words[i] = VocabularyTree::kNoWord;
        weights[i] = 0;
      } else if (words[i] >= info_.word_count) {
        image_.fail("a word is too large", words[i]);
      }
      if (!(weights[i] >= 0 && weights[i] <= 1e30)) [[unlikely]]
        image_.fail("a weight is negative or too large; of word", words[i]);
    }
  }

  VocabularyImage image_;
  VocabularyInfo info_;
};

/// For ORB and other descriptors of 256 bits.
using OrbVocabulary = Vocabulary<256>;

}  // namespace sweepkit
