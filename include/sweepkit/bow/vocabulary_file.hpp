// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <string_view>

#include "sweepkit/bow/vocabulary.hpp"
#include "sweepkit/bow/vocabulary_tree.hpp"

namespace sweepkit {

/// Files of vocabularies.
enum class VocabularyFormat {
  sweepkit,          ///< our own, mapped into memory: .swv
  dbow2_yaml,        ///< DBoW2's, as OpenCV's FileStorage writes it: .yml, .yml.gz
  orbslam_text,      ///< ORB-SLAM's version of DBoW2: .txt; a line for each node
  dbow3_yaml,        ///< DBoW3's: .yml, .yml.gz; descriptors carry type and length
  dbow3_binary,      ///< DBoW3's: .dbow3
  dbow3_compressed,  ///< the same in chunks of QuickLZ
  fbow,              ///< FBoW's: .fbow; weights of single precision, score L2
};

/// The name of a format as the command line and Python use it: "dbow2_yaml".
std::string_view to_string(VocabularyFormat format);
/// The format of that name. Throws Error(argument) that lists the names.
VocabularyFormat vocabulary_format(std::string_view name);
/// The format that a file name stands for when written: .swv, .yml and .yml.gz (dbow2_yaml), .txt
/// (orbslam_text), .dbow3 (dbow3_binary), .fbow. Throws Error(argument) for others.
VocabularyFormat vocabulary_format_of_name(std::string_view path);
/// The format of a file, by its content. Throws Error(io), or Error(data) if it is none of them.
VocabularyFormat detect_vocabulary_format(const std::string& path);

/// Reads a vocabulary of any format, by its content; text may be compressed by gzip. Words, weights and the
/// order of children are those of the file, so words and bags are the same as with the library that wrote
/// it. A leaf without a word and an inner node without children become leaves without a word.
///
/// From FBoW's files come TF-IDF and L2; descriptors are filled with zeros up to whole words of 64 bits. Of
/// DBoW3's compressed files those are read whose chunks are stored or of QuickLZ's level 1 without
/// streaming; others are refused with a message. Memory grows with what has been read, never by a number in
/// the file alone. Throws Error(io), or Error(data) with file and line (or byte) of what is wrong.
VocabularyTree read_vocabulary(const std::string& path);

/// Writes a vocabulary; with a name that ends in .gz text is compressed. `path` is replaced when all is
/// written.
///
/// DBoW2 and DBoW3 number words without gaps, each once, else Error(argument): see renumbered(). FBoW's files
/// hold no weighting and no score, and weights of single precision. Throws Error(io) where the file cannot be
/// written.
void write_vocabulary(const std::string& path, const VocabularyTree& tree, VocabularyFormat format);

/// The same tree with its words numbered level by level from 0 without gaps.
VocabularyTree renumbered(const VocabularyTree& tree);

/// A vocabulary from a file of any format; our own is mapped, others are read.
template <int Bits>
Vocabulary<Bits> load_vocabulary(const std::string& path) {
  if (detect_vocabulary_format(path) == VocabularyFormat::sweepkit) return Vocabulary<Bits>::open(path);
  const VocabularyTree tree = read_vocabulary(path);
  if (tree.bits != Bits)
    throw Error(ErrorKind::data, path, "the descriptors must have " + std::to_string(Bits) + " bits",
                std::to_string(tree.bits));
  return Vocabulary<Bits>(tree);
}

}  // namespace sweepkit
