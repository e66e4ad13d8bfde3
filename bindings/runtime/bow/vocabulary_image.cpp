// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/vocabulary_image.hpp"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <new>
#include <utility>

namespace sweepkit {
namespace {

using impl::VocabularyBlock;
using impl::VocabularyHeader;
static_assert(std::endian::native == std::endian::little, "images are little endian");

constexpr std::uint32_t kByteOrder = 0x01020304;

/// Of whole 64-bit words, in four lanes that do not wait for each other.
std::uint64_t checksum_of(const std::byte* data, std::size_t bytes) {
  constexpr std::uint64_t kFactor = 0x9e3779b97f4a7c15u;
  std::uint64_t lanes[4] = {1, 2, 3, 4};
  for (std::size_t i = 0; i < bytes; i += 8) {
    std::uint64_t word;
    std::memcpy(&word, data + i, 8);
    std::uint64_t& lane = lanes[i / 8 % 4];
    lane = (std::rotl(lane, 29) ^ word) * kFactor;
  }
  std::uint64_t sum = bytes;
  for (const std::uint64_t lane : lanes) sum = (std::rotl(sum, 23) ^ lane ^ lane >> 32) * kFactor;
  return sum;
}

std::string system_error() { return std::strerror(errno); }

struct FileHandle {
  int fd = -1;
  ~FileHandle() {
    if (fd >= 0) ::close(fd);
  }
};

}  // namespace

VocabularyImage::VocabularyImage(const VocabularyTree& unsorted) {
  const VocabularyTree tree = sorted_by_level(unsorted);
  const std::size_t size = tree.size();
  const auto words = static_cast<std::size_t>(tree.words_per_descriptor());

  // Families follow each other: the children of the k-th inner node are one run.
  std::vector<std::uint32_t> first(size, 0), count(size, 0);
  for (std::size_t i = size; i-- > 1;) {
    first[tree.parent[i]] = static_cast<std::uint32_t>(i);
    ++count[tree.parent[i]];
  }
  std::vector<std::uint64_t> line(size, 0);
  std::vector<std::uint8_t> has_leaf(size, 0);
  std::uint32_t leaf_count = 0, word_count = 0;
  std::size_t bytes = 0;
  for (std::size_t i = 0; i < size; ++i) {
    if (count[i] == 0) {
      ++leaf_count;
      if (tree.word[i] != VocabularyTree::kNoWord) word_count = std::max(word_count, tree.word[i] + 1);
      continue;
    }
    for (std::uint32_t c = first[i]; c < first[i] + count[i]; ++c) has_leaf[i] |= count[c] == 0;
    line[i] = bytes / VocabularyBlock::kLine;
    bytes += VocabularyBlock::bytes(count[i], words, has_leaf[i] != 0);
    require(line[i] < VocabularyBlock::kLeaf, "VocabularyImage", "the vocabulary is too large", size);
  }

  const std::size_t total = sizeof(VocabularyHeader) + bytes;
  auto* memory = static_cast<std::byte*>(::operator new (total, std::align_val_t{VocabularyBlock::kLine}));
  std::shared_ptr<const std::byte> owner(memory, [](const std::byte* p) {
    ::operator delete (const_cast<std::byte*>(p), std::align_val_t{VocabularyBlock::kLine});
  });
  std::memset(memory, 0, total);
  std::byte* blocks = memory + sizeof(VocabularyHeader);
  for (std::size_t i = 0; i < size; ++i) {
    if (count[i] == 0) continue;
    std::byte* p = blocks + line[i] * VocabularyBlock::kLine;
    const std::uint32_t head[2] = {first[i], count[i] | std::uint32_t{has_leaf[i]} << 16};
    std::memcpy(p, head, sizeof(head));
    std::byte* planes = p + VocabularyBlock::links_bytes(count[i]);
    std::byte* weights = planes + VocabularyBlock::planes_bytes(count[i], words);
    for (std::uint32_t c = 0; c < count[i]; ++c) {
      const std::uint32_t child = first[i] + c;
      const std::uint32_t link = count[child] > 0 ? static_cast<std::uint32_t>(line[child])
                                                  : VocabularyBlock::kLeaf | tree.word[child];
      std::memcpy(p + 8 + 4 * c, &link, 4);
      const auto descriptor = tree.descriptor(child);
      for (std::size_t w = 0; w < words; ++w) std::memcpy(planes + 8 * (w * count[i] + c), &descriptor[w], 8);
      if (count[child] == 0) std::memcpy(weights + 8 * c, &tree.weight[child], 8);
    }
  }
  VocabularyHeader header{};
  std::copy(std::begin(VocabularyHeader::kMagic), std::end(VocabularyHeader::kMagic), header.magic);
  header.version = VocabularyHeader::kVersion;
  header.byte_order = kByteOrder;
  header.bytes = total;
  header.checksum = checksum_of(blocks, bytes);
  header.node_count = static_cast<std::uint32_t>(size);
  header.leaf_count = leaf_count;
  header.word_count = word_count;
  header.bits = static_cast<std::uint32_t>(tree.bits);
  header.branching = static_cast<std::uint32_t>(tree.branching);
  header.depth = static_cast<std::uint32_t>(tree.depth);
  header.weighting = static_cast<std::uint32_t>(tree.weighting);
  header.score = static_cast<std::uint32_t>(tree.score);
  std::memcpy(memory, &header, sizeof(header));
  take(std::move(owner), total, "vocabulary");
}

void VocabularyImage::take(std::shared_ptr<const std::byte> memory, std::size_t bytes, std::string place) {
  const auto wrong = [&](const char* what, std::uint64_t value) {
    throw Error(ErrorKind::data, place, what, std::to_string(value));
  };
  if (bytes < sizeof(VocabularyHeader) + VocabularyBlock::kLine)
    wrong("is too short for a vocabulary", bytes);
  VocabularyHeader header;
  std::memcpy(&header, memory.get(), sizeof(header));
  if (!std::equal(std::begin(header.magic), std::end(header.magic), std::begin(VocabularyHeader::kMagic)))
    throw Error(ErrorKind::data, place, "is no vocabulary of sweepkit's own format");
  if (header.byte_order != kByteOrder) wrong("has another byte order", header.byte_order);
  if (header.version != VocabularyHeader::kVersion) wrong("has an unknown version", header.version);
  if (header.bytes != bytes) wrong("is cut short or too long: bytes as its header says", header.bytes);
  if (header.bits < 64 || header.bits > 16384 || header.bits % 64 != 0)
    wrong("has descriptors of a wrong length", header.bits);
  if (header.branching < 1 || header.branching > 65535) wrong("has a wrong branching", header.branching);
  if (header.depth < 1 || header.depth > 1000) wrong("has a wrong depth", header.depth);
  if (header.weighting > 3) wrong("has an unknown weighting", header.weighting);
  if (header.score > 5) wrong("has an unknown score", header.score);
  if (header.word_count < 1 || header.word_count > 0x7fffffffu)
    wrong("has a wrong number of words", header.word_count);
  blocks_ = memory.get() + sizeof(VocabularyHeader);
  size_ = bytes - sizeof(VocabularyHeader);
  memory_ = std::move(memory);
  place_ = std::move(place);
}

VocabularyImage VocabularyImage::open(const std::string& path) {
  FileHandle file{::open(path.c_str(), O_RDONLY | O_CLOEXEC)};
  if (file.fd < 0) throw Error(ErrorKind::io, path, "cannot be opened", system_error());
  struct stat status = {};
  if (::fstat(file.fd, &status) != 0) throw Error(ErrorKind::io, path, "cannot be read", system_error());
  if (!S_ISREG(status.st_mode)) throw Error(ErrorKind::io, path, "is no file");
  const auto bytes = static_cast<std::size_t>(status.st_size);
  if (bytes < sizeof(VocabularyHeader))
    throw Error(ErrorKind::data, path, "is too short for a vocabulary", std::to_string(bytes));
  void* mapped = ::mmap(nullptr, bytes, PROT_READ, MAP_SHARED, file.fd, 0);
  if (mapped == MAP_FAILED) throw Error(ErrorKind::io, path, "cannot be mapped", system_error());
  VocabularyImage image;
  image.take(std::shared_ptr<const std::byte>(
                 static_cast<const std::byte*>(mapped),
                 [bytes](const std::byte* p) { ::munmap(const_cast<std::byte*>(p), bytes); }),
             bytes, path);
  return image;
}

VocabularyImage VocabularyImage::of_bytes(std::span<const std::byte> bytes, std::string place) {
  if (reinterpret_cast<std::uintptr_t>(bytes.data()) % VocabularyBlock::kLine != 0)
    throw Error(ErrorKind::argument, place, "must be aligned to 64 bytes");
  VocabularyImage image;
  image.take({std::shared_ptr<const void>(), bytes.data()}, bytes.size(), std::move(place));
  return image;
}

void VocabularyImage::save(const std::string& path) const {
  require(!empty(), "VocabularyImage::save", "there is nothing to save", path);
  // Written beside it first: who has the old file mapped keeps it, and nobody sees half a file.
  const std::string beside = path + "." + std::to_string(::getpid()) + ".part";
  {
    std::ofstream file(beside, std::ios::binary | std::ios::trunc);
    file.write(reinterpret_cast<const char*>(memory_.get()),
               static_cast<std::streamsize>(size_ + sizeof(VocabularyHeader)));
    file.close();
    if (!file) {
      const std::string reason = system_error();
      std::remove(beside.c_str());
      throw Error(ErrorKind::io, path, "cannot be written", reason);
    }
  }
  if (std::rename(beside.c_str(), path.c_str()) != 0) {
    const std::string reason = system_error();
    std::remove(beside.c_str());
    throw Error(ErrorKind::io, path, "cannot be written", reason);
  }
}

VocabularyInfo VocabularyImage::info() const {
  if (empty()) return {};
  const VocabularyHeader& h = header();
  return {.bits = static_cast<int>(h.bits),
          .branching = static_cast<int>(h.branching),
          .depth = static_cast<int>(h.depth),
          .weighting = static_cast<BagWeighting>(h.weighting),
          .score = static_cast<BagScore>(h.score),
          .node_count = h.node_count,
          .leaf_count = h.leaf_count,
          .word_count = h.word_count,
          .bytes = h.bytes,
          .checksum = h.checksum};
}

VocabularyTree VocabularyImage::tree() const {
  require(!empty(), "VocabularyImage::tree", "the vocabulary has no words", 0);
  const VocabularyInfo about = info();
  VocabularyTree tree;
  tree.bits = about.bits;
  tree.branching = about.branching;
  tree.depth = about.depth;
  tree.weighting = about.weighting;
  tree.score = about.score;
  const auto words = static_cast<std::size_t>(tree.words_per_descriptor());
  std::vector<std::uint64_t> descriptor(words, 0);
  tree.add(0, VocabularyTree::kNoWord, 0.0, descriptor);
  // Blocks lie in the order of their nodes without gaps, so each is met once: damage cannot make this long.
  std::vector<std::uint32_t> line{0};
  std::size_t next_line = 0;
  std::uint32_t leaf_count = 0, word_count = 0;
  constexpr std::uint32_t kNone = 0xffffffffu;
  for (std::size_t node = 0; node < line.size(); ++node) {
    if (line[node] == kNone) continue;
    const VocabularyBlock b = block(line[node], words);
    if (line[node] != next_line) fail("a block is not where it belongs; line", line[node]);
    next_line += VocabularyBlock::bytes(b.count, words, b.has_leaf) / VocabularyBlock::kLine;
    if (b.first_child != tree.size()) fail("the children of a node have wrong numbers", b.first_child);
    for (std::uint32_t c = 0; c < b.count; ++c) {
      const std::uint32_t link = b.links[c];
      for (std::size_t w = 0; w < words; ++w) descriptor[w] = b.planes[w * b.count + c];
      const bool leaf = (link & VocabularyBlock::kLeaf) != 0;
      const std::uint32_t word = link == kNone ? VocabularyTree::kNoWord : link & ~VocabularyBlock::kLeaf;
      if (leaf && !b.has_leaf) fail("a leaf has no weight; word", word);
      const bool has_word = leaf && link != kNone;
      tree.add(static_cast<std::uint32_t>(node), has_word ? word : VocabularyTree::kNoWord,
               has_word ? b.weights[c] : 0.0, descriptor);
      line.push_back(leaf ? kNone : link);
      leaf_count += leaf;
      if (has_word) word_count = std::max(word_count, word + 1);
    }
  }
  if (next_line * VocabularyBlock::kLine != size_) fail("has bytes that belong to no node", size_);
  if (tree.size() != about.node_count) fail("has a wrong number of nodes", about.node_count);
  if (leaf_count != about.leaf_count) fail("has a wrong number of leaves", about.leaf_count);
  if (word_count != about.word_count) fail("has a wrong number of words", about.word_count);
  return tree;
}

void VocabularyImage::verify() const {
  require(!empty(), "VocabularyImage::verify", "the vocabulary has no words", 0);
  const std::uint64_t sum = checksum_of(blocks_, size_);
  if (sum != header().checksum) fail("the checksum is wrong: the file is damaged", header().checksum);
  try {
    check_vocabulary_tree(tree());
  } catch (const Error& error) {
    if (error.kind() != ErrorKind::argument) throw;
    throw Error(ErrorKind::data, place_, error.what());
  }
}

}  // namespace sweepkit
