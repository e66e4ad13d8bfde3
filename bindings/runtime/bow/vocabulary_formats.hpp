// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "sweepkit/bow/vocabulary_file.hpp"

// The readers and writers behind vocabulary_file.hpp, one source file for each family of formats.

namespace sweepkit::impl {

constexpr std::uint64_t kDbow3Signature = 88877711233;
constexpr std::uint64_t kFbowSignature = 55824124;

/// What files of DBoW2 and DBoW3 list: nodes with numbers of their own, then words.
struct ListedNodes {
  int branching = 0, depth = 0, score = 0, weighting = 0;
  std::size_t bytes = 0;  ///< of a descriptor; 0 until the first is known
  std::vector<std::uint32_t> id, parent;
  std::vector<double> weight;
  std::vector<std::uint8_t> descriptors;
  std::vector<std::uint32_t> word_id, word_node;
};

/// Makes a tree of them; throws Error(data) that names `path` where they are none.
VocabularyTree tree_of(const ListedNodes& listed, const std::string& path);

/// Copies the bytes of a descriptor into words, zeros behind.
void copy_descriptor(const std::uint8_t* bytes, std::size_t size, std::uint64_t* words);

/// The nodes of a tree in an order in which parents and elder siblings come first and words ascend; empty if
/// there is none.
std::vector<std::uint32_t> order_by_word(const VocabularyTree& tree);

/// Throws Error(argument) unless words are 0 .. n - 1, each once; returns the leaf of each.
std::vector<std::uint32_t> leaf_of_word(const VocabularyTree& tree);

VocabularyTree read_yaml(const std::string& path, bool* dbow3);
VocabularyTree read_orbslam_text(const std::string& path);
VocabularyTree read_dbow3_binary(const std::string& path, std::string_view content);
VocabularyTree read_fbow(const std::string& path, std::string_view content);

/// Writers hand on pieces of the file.
using Sink = std::function<void(std::string_view)>;
void write_yaml(const VocabularyTree& tree, bool dbow3, const Sink& sink);
void write_orbslam_text(const VocabularyTree& tree, const Sink& sink);
void write_dbow3_binary(const VocabularyTree& tree, bool compressed, const Sink& sink);
void write_fbow(const VocabularyTree& tree, const Sink& sink);

/// One chunk of QuickLZ 1.5. Appends what it holds to `out`, at most `limit` bytes, and returns the length of
/// the chunk. Throws Error(data) that names `place`.
std::size_t unpack_quicklz(std::string_view chunk, std::size_t limit, const std::string& place,
                           std::string& out);

/// Packs at least one byte into a chunk; stores it where packing gains nothing.
std::string pack_quicklz(std::string_view piece);

}  // namespace sweepkit::impl
