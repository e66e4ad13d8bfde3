// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/vocabulary_file.hpp"

#include <unistd.h>
#include <zlib.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "sweepkit/core/error.hpp"
#include "text_window.hpp"
#include "vocabulary_formats.hpp"

namespace sweepkit {
namespace {

struct FormatName {
  VocabularyFormat format;
  std::string_view name;
};
constexpr std::array<FormatName, 7> kFormats{{{VocabularyFormat::sweepkit, "sweepkit"},
                                              {VocabularyFormat::dbow2_yaml, "dbow2_yaml"},
                                              {VocabularyFormat::orbslam_text, "orbslam_text"},
                                              {VocabularyFormat::dbow3_yaml, "dbow3_yaml"},
                                              {VocabularyFormat::dbow3_binary, "dbow3_binary"},
                                              {VocabularyFormat::dbow3_compressed, "dbow3_compressed"},
                                              {VocabularyFormat::fbow, "fbow"}}};

std::string read_all(const std::string& path) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file) throw Error(ErrorKind::io, path, "cannot be opened");
  std::string content(static_cast<std::size_t>(file.tellg()), '\0');
  file.seekg(0);
  file.read(content.data(), static_cast<std::streamsize>(content.size()));
  if (!file) throw Error(ErrorKind::io, path, "cannot be read");
  return content;
}

bool ends_with(std::string_view text, std::string_view end) {
  return text.size() >= end.size() && text.substr(text.size() - end.size()) == end;
}

/// A file that takes its name when it is complete.
class OutputFile {
 public:
  explicit OutputFile(const std::string& path)
      : path_(path), beside_(path + "." + std::to_string(::getpid()) + ".part") {
    // Without compression zlib hands bytes through.
    file_ = gzopen(beside_.c_str(), ends_with(path, ".gz") ? "wb3" : "wbT");
    if (!file_) throw Error(ErrorKind::io, path, "cannot be written", std::strerror(errno));
    gzbuffer(file_, 1u << 17);
  }
  ~OutputFile() {
    if (file_) gzclose(file_);
    if (!beside_.empty()) std::remove(beside_.c_str());
  }
  OutputFile(const OutputFile&) = delete;
  OutputFile& operator=(const OutputFile&) = delete;

  void write(std::string_view text) {
    while (!text.empty()) {
      const std::string_view part = text.substr(0, 1u << 24);
      if (gzwrite(file_, part.data(), static_cast<unsigned>(part.size())) <= 0) fail();
      text.remove_prefix(part.size());
    }
  }
  void finish() {
    const int code = gzclose(file_);
    file_ = nullptr;
    if (code != Z_OK || std::rename(beside_.c_str(), path_.c_str()) != 0) fail();
    beside_.clear();
  }

 private:
  [[noreturn]] void fail() const {
    throw Error(ErrorKind::io, path_, "cannot be written", std::strerror(errno));
  }

  std::string path_, beside_;
  gzFile file_ = nullptr;
};

}  // namespace

namespace impl {

void copy_descriptor(const std::uint8_t* bytes, std::size_t size, std::uint64_t* words) {
  std::memset(words, 0, (size + 7) / 8 * 8);
  std::memcpy(words, bytes, size);
}

VocabularyTree tree_of(const ListedNodes& listed, const std::string& path) {
  const auto fail = [&](const std::string& what, std::uint64_t value) {
    throw Error(ErrorKind::data, path, what, std::to_string(value));
  };
  const std::size_t size = listed.id.size();
  if (size == 0) fail("the vocabulary has no nodes", 0);
  if (listed.bytes % 8 != 0 || listed.bytes > 2048)
    fail("descriptors must be of whole 64-bit words; bytes", listed.bytes);
  if (listed.branching < 1 || listed.branching > 65535)
    throw Error(ErrorKind::data, path, "wrong branching", std::to_string(listed.branching));
  if (listed.depth < 1 || listed.depth > 1000)
    throw Error(ErrorKind::data, path, "wrong depth", std::to_string(listed.depth));
  if (listed.score < 0 || listed.score > 5)
    throw Error(ErrorKind::data, path, "unknown score", std::to_string(listed.score));
  if (listed.weighting < 0 || listed.weighting > 3)
    throw Error(ErrorKind::data, path, "unknown weighting", std::to_string(listed.weighting));

  // Numbers are 1 .. size, so a plain table holds them.
  std::vector<std::uint32_t> node_of(size + 1, 0), children(size + 1, 0);
  for (std::size_t i = 0; i < size; ++i) {
    const std::uint32_t id = listed.id[i];
    if (id < 1 || id > size) fail("a node has a wrong number", id);
    if (node_of[id] != 0) fail("two nodes have the same number", id);
    if (listed.parent[i] > size || (listed.parent[i] != 0 && node_of[listed.parent[i]] == 0))
      fail("a node stands before its parent", listed.parent[i]);
    node_of[id] = static_cast<std::uint32_t>(i + 1);
  }
  VocabularyTree tree;
  tree.bits = static_cast<int>(listed.bytes * 8);
  tree.branching = listed.branching;
  tree.depth = listed.depth;
  tree.score = static_cast<BagScore>(listed.score);
  tree.weighting = static_cast<BagWeighting>(listed.weighting);
  std::vector<std::uint64_t> words(listed.bytes / 8, 0);
  tree.add(0, VocabularyTree::kNoWord, 0.0, words);
  for (std::size_t i = 0; i < size; ++i) {
    copy_descriptor(listed.descriptors.data() + i * listed.bytes, listed.bytes, words.data());
    const std::uint32_t parent = listed.parent[i] == 0 ? 0 : node_of[listed.parent[i]];
    if (++children[parent] > 65535) fail("a node has too many children", listed.parent[i]);
    tree.add(parent, VocabularyTree::kNoWord, 0.0, words);
  }
  const std::size_t word_count = listed.word_id.size();
  if (word_count == 0) fail("the vocabulary has no words", 0);
  std::vector<bool> seen(word_count, false);
  for (std::size_t i = 0; i < word_count; ++i) {
    const std::uint32_t word = listed.word_id[i], id = listed.word_node[i];
    if (word >= word_count || seen[word]) fail("a word has a wrong number", word);
    seen[word] = true;
    if (id < 1 || id > size) fail("a word lies at a node that is not there", id);
    const std::uint32_t node = node_of[id];
    if (children[node] > 0) fail("a word lies at an inner node", id);
    if (tree.word[node] != VocabularyTree::kNoWord) fail("two words lie at the same node", id);
    const double weight = listed.weight[node - 1];
    if (!(weight >= 0 && weight <= 1e30)) fail("a weight is negative or no number; of word", word);
    tree.word[node] = word;
    tree.weight[node] = weight;
  }
  return tree;
}

std::vector<std::uint32_t> leaf_of_word(const VocabularyTree& tree) {
  check_vocabulary_tree(tree);
  constexpr std::uint32_t kNone = VocabularyTree::kNoWord;
  std::uint32_t words = 0;
  for (const std::uint32_t word : tree.word) words += word != kNone;
  std::vector<std::uint32_t> leaf(words, kNone);
  for (std::uint32_t i = 0; i < tree.size(); ++i) {
    if (tree.word[i] == kNone) continue;
    require(tree.word[i] < words && leaf[tree.word[i]] == kNone, "write_vocabulary",
            "this format numbers words without gaps, each once: renumber them; word", tree.word[i]);
    leaf[tree.word[i]] = i;
  }
  return leaf;
}

std::vector<std::uint32_t> order_by_word(const VocabularyTree& tree) {
  const std::size_t size = tree.size();
  const std::vector<std::uint32_t> leaf = leaf_of_word(tree);
  std::vector<std::uint32_t> begin(size + 1, 0), children(size - 1), rank(size, 0);
  for (std::size_t i = 1; i < size; ++i) ++begin[tree.parent[i] + 1];
  for (std::size_t i = 0; i < size; ++i) begin[i + 1] += begin[i];
  // What of each node's children is listed already is a prefix.
  std::vector<std::uint32_t> next(begin.begin(), begin.end() - 1);
  for (std::uint32_t i = 1; i < size; ++i) {
    rank[i] = next[tree.parent[i]]++;
    children[rank[i]] = i;
  }
  next.assign(begin.begin(), begin.end() - 1);
  std::vector<std::uint32_t> order{0}, way;
  order.reserve(size);
  std::uint32_t words = 0;
  const auto list_up_to = [&](std::uint32_t node) {
    for (std::uint32_t& n = next[tree.parent[node]]; n <= rank[node]; ++n) {
      const std::uint32_t sibling = children[n];
      if (tree.word[sibling] != VocabularyTree::kNoWord && tree.word[sibling] != words++) return false;
      order.push_back(sibling);
    }
    return true;
  };
  for (const std::uint32_t node : leaf) {
    way.clear();
    for (std::uint32_t n = node; n != 0; n = tree.parent[n]) way.push_back(n);
    for (auto it = way.rbegin(); it != way.rend(); ++it)
      if (!list_up_to(*it)) return {};
  }
  // Left are nodes without words below them.
  for (std::size_t k = 0; k < order.size(); ++k) {
    const std::uint32_t node = order[k];
    for (std::uint32_t& n = next[node]; n < begin[node + 1]; ++n) order.push_back(children[n]);
  }
  return order;
}

}  // namespace impl

std::string_view to_string(VocabularyFormat format) {
  for (const FormatName& entry : kFormats)
    if (entry.format == format) return entry.name;
  return "unknown";
}

VocabularyFormat vocabulary_format(std::string_view name) {
  std::string names;
  for (const FormatName& entry : kFormats) {
    if (entry.name == name) return entry.format;
    names += (names.empty() ? "" : ", ") + std::string(entry.name);
  }
  throw Error(ErrorKind::argument, "vocabulary format", "must be one of " + names, std::string(name));
}

VocabularyFormat vocabulary_format_of_name(std::string_view path) {
  if (ends_with(path, ".swv")) return VocabularyFormat::sweepkit;
  if (ends_with(path, ".dbow3")) return VocabularyFormat::dbow3_binary;
  if (ends_with(path, ".fbow")) return VocabularyFormat::fbow;
  if (ends_with(path, ".gz")) path.remove_suffix(3);
  if (ends_with(path, ".yml") || ends_with(path, ".yaml")) return VocabularyFormat::dbow2_yaml;
  if (ends_with(path, ".txt")) return VocabularyFormat::orbslam_text;
  throw Error(ErrorKind::argument, std::string(path),
              "the name tells no format: use .swv, .yml, .yml.gz, .txt, .dbow3 or .fbow, or name the format");
}

VocabularyFormat detect_vocabulary_format(const std::string& path) {
  std::error_code ignored;
  if (std::filesystem::is_directory(path, ignored)) throw Error(ErrorKind::io, path, "is a folder");
  std::ifstream file(path, std::ios::binary);
  if (!file) throw Error(ErrorKind::io, path, "cannot be opened");
  char head[9] = {};
  file.read(head, sizeof(head));
  const auto got = static_cast<std::size_t>(file.gcount());
  std::uint64_t signature = 0;
  std::memcpy(&signature, head, 8);
  if (got == 9 && signature == impl::kDbow3Signature)
    return head[8] != 0 ? VocabularyFormat::dbow3_compressed : VocabularyFormat::dbow3_binary;
  if (got >= 8 && signature == impl::kFbowSignature) return VocabularyFormat::fbow;
  if (got >= 8 && std::memcmp(head, impl::VocabularyHeader::kMagic, 8) == 0)
    return VocabularyFormat::sweepkit;
  impl::TextWindow text(path);
  text.skip_space();
  const char first = text.peek();
  if (first >= '0' && first <= '9') return VocabularyFormat::orbslam_text;
  if (first != '%') throw Error(ErrorKind::data, path, "is no vocabulary of a known format");
  // Up to the first descriptor; DBoW3's carry a mark, or type and length.
  for (int line = 0; line < 100 && !text.at_end(); ++line) {
    const std::string_view content = text.take_line();
    const std::size_t at = content.find("descriptor:");
    if (at == std::string_view::npos) continue;
    const std::string_view descriptor = content.substr(at + 11);
    if (descriptor.find("dbw3") != std::string_view::npos) return VocabularyFormat::dbow3_yaml;
    std::size_t numbers = 0;
    for (std::size_t i = 1; i < descriptor.size(); ++i) {
      const auto digit = [](char c) { return c >= '0' && c <= '9'; };
      numbers += digit(descriptor[i]) && !digit(descriptor[i - 1]);
    }
    return numbers % 8 == 2 ? VocabularyFormat::dbow3_yaml : VocabularyFormat::dbow2_yaml;
  }
  throw Error(ErrorKind::data, path, "is no vocabulary: there is no descriptor");
}

VocabularyTree read_vocabulary(const std::string& path) {
  bool dbow3 = false;
  VocabularyTree tree;
  switch (detect_vocabulary_format(path)) {
    case VocabularyFormat::sweepkit:
      tree = VocabularyImage::open(path).tree();
      break;
    case VocabularyFormat::dbow2_yaml:
    case VocabularyFormat::dbow3_yaml:
      tree = impl::read_yaml(path, &dbow3);
      break;
    case VocabularyFormat::orbslam_text:
      tree = impl::read_orbslam_text(path);
      break;
    case VocabularyFormat::dbow3_binary:
    case VocabularyFormat::dbow3_compressed:
      tree = impl::read_dbow3_binary(path, read_all(path));
      break;
    case VocabularyFormat::fbow:
      tree = impl::read_fbow(path, read_all(path));
      break;
  }
  try {
    check_vocabulary_tree(tree);
  } catch (const Error& error) {
    throw Error(ErrorKind::data, path, error.what());
  }
  return tree;
}

void write_vocabulary(const std::string& path, const VocabularyTree& tree, VocabularyFormat format) {
  check_vocabulary_tree(tree);
  if (format == VocabularyFormat::sweepkit) return VocabularyImage(tree).save(path);
  const bool text = format == VocabularyFormat::dbow2_yaml || format == VocabularyFormat::dbow3_yaml ||
                    format == VocabularyFormat::orbslam_text;
  require(text || !ends_with(path, ".gz"), "write_vocabulary", "only text is compressed by gzip", path);
  OutputFile file(path);
  const impl::Sink sink = [&](std::string_view part) { file.write(part); };
  switch (format) {
    case VocabularyFormat::sweepkit:
      break;
    case VocabularyFormat::dbow2_yaml:
    case VocabularyFormat::dbow3_yaml:
      impl::write_yaml(tree, format == VocabularyFormat::dbow3_yaml, sink);
      break;
    case VocabularyFormat::orbslam_text:
      impl::write_orbslam_text(tree, sink);
      break;
    case VocabularyFormat::dbow3_binary:
    case VocabularyFormat::dbow3_compressed:
      impl::write_dbow3_binary(tree, format == VocabularyFormat::dbow3_compressed, sink);
      break;
    case VocabularyFormat::fbow:
      impl::write_fbow(tree, sink);
      break;
  }
  file.finish();
}

VocabularyTree renumbered(const VocabularyTree& tree) {
  VocabularyTree result = sorted_by_level(tree);
  std::uint32_t words = 0;
  for (std::uint32_t& word : result.word)
    if (word != VocabularyTree::kNoWord) word = words++;
  return result;
}

}  // namespace sweepkit
