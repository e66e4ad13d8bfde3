// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <span>
#include <string>

#include "sweepkit/bow/vocabulary_tree.hpp"
#include "sweepkit/core/error.hpp"

namespace sweepkit {

namespace impl {

/// Start of a vocabulary's image, in memory and in files (little endian).
struct VocabularyHeader {
  static constexpr char kMagic[8] = {'s', 'w', 'k', 'v', 'o', 'c', '\r', '\n'};
  static constexpr std::uint32_t kVersion = 1;

  char magic[8];
  std::uint32_t version;
  std::uint32_t byte_order;  ///< 0x01020304
  std::uint64_t bytes;       ///< of the whole image
  std::uint64_t checksum;    ///< of all that follows the header
  std::uint32_t node_count, leaf_count, word_count;
  std::uint32_t bits, branching, depth, weighting, score;
  std::uint8_t reserved[64];
};
static_assert(sizeof(VocabularyHeader) == 128);

/// The children of one node. Blocks begin on cache lines:
///     u32 number of the first child, u16 count, u16 whether any child is a leaf
///     u32 link of each child: line of its block, or kLeaf | word
///     descriptors, from the next line: word 0 of all children, word 1 of all children, ...
///     f64 weight of each child, from the next line, if any child is a leaf
/// Lines are counted from the end of the header; the root's block is the first, and each block stands before
/// those it links to.
struct VocabularyBlock {
  static constexpr std::uint32_t kLeaf = 0x80000000u;
  static constexpr std::size_t kLine = 64;

  std::uint32_t first_child;
  std::uint32_t count;
  bool has_leaf;
  const std::uint32_t* links;
  const std::uint64_t* planes;
  const double* weights;

  static constexpr std::size_t up(std::size_t bytes) { return (bytes + kLine - 1) / kLine * kLine; }
  static constexpr std::size_t links_bytes(std::size_t count) { return up(8 + 4 * count); }
  static constexpr std::size_t planes_bytes(std::size_t count, std::size_t words) {
    return up(8 * count * words);
  }
  static constexpr std::size_t bytes(std::size_t count, std::size_t words, bool has_leaf) {
    return links_bytes(count) + planes_bytes(count, words) + (has_leaf ? up(8 * count) : 0);
  }
};

}  // namespace impl

/// What is known of a vocabulary without reading it.
struct VocabularyInfo {
  int bits = 0;  ///< of a descriptor
  int branching = 0;
  int depth = 0;
  BagWeighting weighting = BagWeighting::tf_idf;
  BagScore score = BagScore::l1;
  std::uint32_t node_count = 0;  ///< with the root
  std::uint32_t leaf_count = 0;
  std::uint32_t word_count = 0;  ///< the largest word and one
  std::uint64_t bytes = 0;       ///< of the image
  std::uint64_t checksum = 0;    ///< of its content, as the header has it: tells vocabularies apart
};

/// A vocabulary as one piece of memory, laid out for speed: the content of our own files, which are mapped,
/// not read. Copies share the memory; nothing in it changes, so threads may share it.
class VocabularyImage {
 public:
  /// Holds nothing.
  VocabularyImage() = default;
  /// Lays a tree out. Throws Error(argument) as check_vocabulary_tree does.
  explicit VocabularyImage(const VocabularyTree& tree);

  /// Maps a file of our own format; takes no time worth naming for any size. Only the header is checked
  /// here; every access to the rest is checked against the bounds of the file, and verify() checks all.
  /// The file must not be cut short while it is mapped. Throws Error(io) or Error(data).
  static VocabularyImage open(const std::string& path);
  /// The content of such a file that lies in memory already, aligned to 64 bytes, and stays there: it is not
  /// copied. Throws as open. @param place stands in messages
  static VocabularyImage of_bytes(std::span<const std::byte> bytes, std::string place);
  /// Writes the image; `path` is replaced at once when all is written. Throws Error(io).
  void save(const std::string& path) const;
  /// Reads everything: checksum, links, counts, words, weights. Throws Error(data) that says what is wrong.
  void verify() const;

  bool empty() const { return size_ == 0; }
  /// All fields are 0 where the image is empty.
  VocabularyInfo info() const;
  /// The tree, its nodes numbered as info and transforms number them. Throws Error(data) where the image is
  /// damaged.
  VocabularyTree tree() const;
  /// The file, or "vocabulary": stands in messages.
  const std::string& place() const { return place_; }

  /// The block on a line, checked to lie within the image.
  impl::VocabularyBlock block(std::uint32_t line, std::size_t words) const {
    using Block = impl::VocabularyBlock;
    const std::size_t offset = line * Block::kLine;
    if (offset >= size_) [[unlikely]]
      fail("a link leads out of the vocabulary", line);
    const std::byte* p = blocks_ + offset;
    std::uint32_t head[2];
    std::memcpy(head, p, sizeof(head));
    Block block;
    block.first_child = head[0];
    block.count = head[1] & 0xffffu;
    block.has_leaf = head[1] >> 16 != 0;
    const std::size_t links = Block::links_bytes(block.count);
    const std::size_t planes = Block::planes_bytes(block.count, words);
    if (block.count == 0 || Block::bytes(block.count, words, block.has_leaf) > size_ - offset) [[unlikely]]
      fail("a node has a wrong number of children", block.count);
    block.links = reinterpret_cast<const std::uint32_t*>(p + 8);
    block.planes = reinterpret_cast<const std::uint64_t*>(p + links);
    block.weights = reinterpret_cast<const double*>(p + links + planes);
    return block;
  }
  /// Where a block would be; for prefetching, never followed unchecked.
  const std::byte* line_address(std::uint32_t line) const {
    const std::size_t offset = line * impl::VocabularyBlock::kLine;
    return blocks_ + (offset < size_ ? offset : 0);
  }
  [[noreturn]] void fail(const char* what, std::uint64_t value) const {
    throw Error(ErrorKind::data, place_, what, std::to_string(value));
  }

 private:
  const impl::VocabularyHeader& header() const {
    return *reinterpret_cast<const impl::VocabularyHeader*>(memory_.get());
  }
  void take(std::shared_ptr<const std::byte> memory, std::size_t bytes, std::string place);

  std::shared_ptr<const std::byte> memory_;
  const std::byte* blocks_ = nullptr;
  std::size_t size_ = 0;  // of the blocks [bytes]
  std::string place_ = "vocabulary";
};

}  // namespace sweepkit
