// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstring>

#include "sweepkit/core/error.hpp"
#include "vocabulary_formats.hpp"

namespace sweepkit::impl {
namespace {

/// DBoW3 compresses pieces of this length.
constexpr std::size_t kChunk = 10000;

/// Numbers out of bytes, none past their end.
class ByteReader {
 public:
  ByteReader(std::string_view bytes, const std::string& path, std::size_t at = 0)
      : bytes_(bytes), path_(path), at_(at) {}

  template <class Number>
  Number take() {
    Number number;
    std::memcpy(&number, take(sizeof(Number)), sizeof(Number));
    return number;
  }
  const char* take(std::size_t count) {
    if (count > bytes_.size() - at_) fail("ends early");
    at_ += count;
    return bytes_.data() + at_ - count;
  }
  std::size_t left() const { return bytes_.size() - at_; }
  std::string_view rest() const { return bytes_.substr(at_); }
  [[noreturn]] void fail(const std::string& what, const std::string& value = {}) const {
    throw Error(ErrorKind::data, path_, what + ", at byte " + std::to_string(at_), value);
  }

 private:
  std::string_view bytes_;
  const std::string& path_;
  std::size_t at_;
};

template <class Number>
void append(std::string& bytes, Number number) {
  bytes.append(reinterpret_cast<const char*>(&number), sizeof(number));
}

void append_descriptor(std::string& bytes, std::span<const std::uint64_t> words) {
  bytes.append(reinterpret_cast<const char*>(words.data()), words.size() * 8);
}

std::size_t round_up(std::size_t value, std::size_t step) { return (value + step - 1) / step * step; }

/// FBoW's header behind the signature, field by field: its compiler's padding is part of the file.
struct FbowHeader {
  char name[50] = {};
  std::uint8_t gap[2] = {};
  std::uint32_t alignment = 8, blocks = 0;
  std::uint8_t gap2[4] = {};
  std::uint64_t descriptor_stride = 0, block_size = 0, descriptors_at = 0, links_at = 0, total = 0;
  std::int32_t type = 0, descriptor_bytes = 0;
  std::uint32_t branching = 0;
  std::uint8_t gap3[4] = {};
};
static_assert(sizeof(FbowHeader) == 120);

constexpr std::uint32_t kFbowLeaf = 0x80000000u;

}  // namespace

VocabularyTree read_dbow3_binary(const std::string& path, std::string_view content) {
  ByteReader head(content, path);
  head.take<std::uint64_t>();  // the signature, seen before
  const bool compressed = head.take<std::uint8_t>() != 0;
  const auto node_count = head.take<std::uint32_t>();
  if (node_count < 2) head.fail("the vocabulary has no words", std::to_string(node_count));
  std::string unpacked;
  if (compressed) {
    const auto chunks = head.take<std::uint32_t>();
    std::string_view rest = head.rest();
    for (std::uint32_t i = 0; i < chunks; ++i)
      rest.remove_prefix(unpack_quicklz(rest, kChunk, path, unpacked));
  }
  ByteReader in(compressed ? std::string_view(unpacked) : head.rest(), path);
  ListedNodes listed;
  listed.branching = in.take<std::int32_t>();
  listed.depth = in.take<std::int32_t>();
  listed.score = in.take<std::int32_t>();
  listed.weighting = in.take<std::int32_t>();
  for (std::uint32_t i = 1; i < node_count; ++i) {
    listed.id.push_back(in.take<std::uint32_t>());
    listed.parent.push_back(in.take<std::uint32_t>());
    listed.weight.push_back(in.take<double>());
    const auto columns = in.take<std::int32_t>(), rows = in.take<std::int32_t>(),
               type = in.take<std::int32_t>();
    if (type != 0) in.fail("descriptors must be binary; type", std::to_string(type));
    if (rows != 1 || columns < 1 || columns > 2048)
      in.fail("a descriptor has a wrong size", std::to_string(columns));
    if (listed.bytes == 0) listed.bytes = static_cast<std::size_t>(columns);
    if (listed.bytes != static_cast<std::size_t>(columns))
      in.fail("a descriptor has another length", std::to_string(columns));
    const char* bytes = in.take(listed.bytes);
    listed.descriptors.insert(listed.descriptors.end(), bytes, bytes + listed.bytes);
  }
  const auto words = in.take<std::uint32_t>();
  for (std::uint32_t i = 0; i < words; ++i) {
    listed.word_id.push_back(in.take<std::uint32_t>());
    listed.word_node.push_back(in.take<std::uint32_t>());
  }
  return tree_of(listed, path);
}

void write_dbow3_binary(const VocabularyTree& tree, bool compressed, const Sink& sink) {
  const std::vector<std::uint32_t> leaf = leaf_of_word(tree);
  std::vector<std::uint32_t> order = order_by_word(tree);
  if (order.empty())
    for (std::uint32_t i = 0; i < tree.size(); ++i) order.push_back(i);
  std::vector<std::uint32_t> id(tree.size());
  for (std::uint32_t k = 0; k < order.size(); ++k) id[order[k]] = k;

  std::string head, body;
  append(head, kDbow3Signature);
  append(head, static_cast<std::uint8_t>(compressed));
  append(head, static_cast<std::uint32_t>(tree.size()));
  append(body, static_cast<std::int32_t>(tree.branching));
  append(body, static_cast<std::int32_t>(tree.depth));
  append(body, static_cast<std::int32_t>(tree.score));
  append(body, static_cast<std::int32_t>(tree.weighting));
  for (const std::uint32_t node : order) {
    if (node == 0) continue;
    append(body, id[node]);
    append(body, id[tree.parent[node]]);
    append(body, tree.word[node] == VocabularyTree::kNoWord ? 0.0 : tree.weight[node]);
    append(body, static_cast<std::int32_t>(tree.bits / 8));
    append(body, std::int32_t{1});
    append(body, std::int32_t{0});
    append_descriptor(body, tree.descriptor(node));
  }
  append(body, static_cast<std::uint32_t>(leaf.size()));
  for (std::size_t word = 0; word < leaf.size(); ++word) {
    append(body, static_cast<std::uint32_t>(word));
    append(body, id[leaf[word]]);
  }
  if (!compressed) {
    sink(head);
    sink(body);
    return;
  }
  append(head, static_cast<std::uint32_t>((body.size() + kChunk - 1) / kChunk));
  sink(head);
  for (std::size_t from = 0; from < body.size(); from += kChunk)
    sink(pack_quicklz(std::string_view(body).substr(from, kChunk)));
}

VocabularyTree read_fbow(const std::string& path, std::string_view content) {
  ByteReader in(content, path);
  in.take<std::uint64_t>();  // the signature, seen before
  FbowHeader header;
  std::memcpy(static_cast<void*>(&header), in.take(sizeof(header)), sizeof(header));
  if (header.type != 0) in.fail("descriptors must be binary; type", std::to_string(header.type));
  if (header.descriptor_bytes < 1 || header.descriptor_bytes > 2048)
    in.fail("descriptors have a wrong length", std::to_string(header.descriptor_bytes));
  if (header.branching < 1 || header.branching > 65535)
    in.fail("has a wrong branching", std::to_string(header.branching));
  const auto bytes = static_cast<std::size_t>(header.descriptor_bytes);
  const std::uint64_t k = header.branching, size = header.block_size;
  if (header.descriptor_stride < bytes || header.descriptor_stride > size || size > in.left() ||
      header.descriptors_at < 8 || header.descriptors_at > size || header.links_at > size ||
      k * header.descriptor_stride > size - header.descriptors_at || 8 * k > size - header.links_at)
    in.fail("the layout of a block is wrong", std::to_string(size));
  if (header.blocks < 1 || header.blocks > in.left() / size)
    in.fail("ends early; blocks as its header says", std::to_string(header.blocks));

  VocabularyTree tree;
  tree.bits = static_cast<int>(round_up(bytes, 8) * 8);
  tree.branching = static_cast<int>(k);
  tree.weighting = BagWeighting::tf_idf;
  tree.score = BagScore::l2;
  std::vector<std::uint64_t> words(static_cast<std::size_t>(tree.words_per_descriptor()), 0);
  tree.add(0, VocabularyTree::kNoWord, 0.0, words);
  const char* blocks = in.rest().data();
  struct Visit {
    std::uint32_t node, block, depth;
  };
  std::vector<Visit> visits{{0, 0, 1}};
  std::vector<bool> seen(header.blocks, false);
  seen[0] = true;
  std::uint32_t depth = 1;
  for (std::size_t v = 0; v < visits.size(); ++v) {
    const Visit visit = visits[v];
    depth = std::max(depth, visit.depth);
    const char* block = blocks + visit.block * size;
    std::uint16_t count;
    std::memcpy(&count, block, 2);
    if (count > k) in.fail("a block has too many nodes", std::to_string(count));
    if (count == 0 && visit.block == 0) in.fail("the vocabulary has no words");
    for (std::uint32_t c = 0; c < count; ++c) {
      std::uint32_t link;
      float weight;
      std::memcpy(&link, block + header.links_at + 8 * c, 4);
      std::memcpy(&weight, block + header.links_at + 8 * c + 4, 4);
      copy_descriptor(
          reinterpret_cast<const std::uint8_t*>(block + header.descriptors_at + c * header.descriptor_stride),
          bytes, words.data());
      if (link & kFbowLeaf) {
        tree.add(visit.node, link & ~kFbowLeaf, static_cast<double>(weight), words);
        continue;
      }
      if (link >= header.blocks || seen[link]) in.fail("a block has a wrong link", std::to_string(link));
      seen[link] = true;
      visits.push_back({tree.add(visit.node, VocabularyTree::kNoWord, 0.0, words), link, visit.depth + 1});
    }
  }
  tree.depth = static_cast<int>(std::min<std::uint32_t>(depth, 1000));
  return tree;
}

void write_fbow(const VocabularyTree& unsorted, const Sink& sink) {
  const VocabularyTree tree = sorted_by_level(unsorted);
  std::vector<std::uint32_t> count(tree.size(), 0), first(tree.size(), 0), block(tree.size(), 0);
  for (std::size_t i = tree.size(); i-- > 1;) {
    ++count[tree.parent[i]];
    first[tree.parent[i]] = static_cast<std::uint32_t>(i);
  }
  FbowHeader header;
  header.branching = static_cast<std::uint32_t>(tree.branching);
  for (std::size_t i = 0; i < tree.size(); ++i) {
    header.branching = std::max(header.branching, count[i]);
    if (count[i] > 0) block[i] = header.blocks++;
  }
  header.descriptor_bytes = tree.bits / 8;
  header.descriptor_stride = static_cast<std::uint64_t>(tree.bits / 8);
  header.descriptors_at = 8;
  header.links_at = header.descriptors_at + header.branching * header.descriptor_stride;
  header.block_size = header.links_at + std::uint64_t{8} * header.branching;
  header.total = header.block_size * header.blocks;
  std::string bytes;
  append(bytes, kFbowSignature);
  append(bytes, header);
  sink(bytes);
  for (std::uint32_t node = 0; node < tree.size(); ++node) {
    if (count[node] == 0) continue;
    bytes.assign(header.block_size, '\0');
    bool leaves = true;
    for (std::uint32_t c = 0; c < count[node]; ++c) {
      const std::uint32_t child = first[node] + c;
      const auto descriptor = tree.descriptor(child);
      std::memcpy(bytes.data() + header.descriptors_at + c * header.descriptor_stride, descriptor.data(),
                  descriptor.size() * 8);
      const bool leaf = count[child] == 0, named = tree.word[child] != VocabularyTree::kNoWord;
      const std::uint32_t link = leaf ? kFbowLeaf | (named ? tree.word[child] : 0) : block[child];
      const float weight = leaf && named ? static_cast<float>(tree.weight[child]) : 0.0f;
      std::memcpy(bytes.data() + header.links_at + 8 * c, &link, 4);
      std::memcpy(bytes.data() + header.links_at + 8 * c + 4, &weight, 4);
      leaves = leaves && leaf;
    }
    const auto children = static_cast<std::uint16_t>(count[node]);
    const std::uint16_t all_leaves = leaves;
    std::memcpy(bytes.data(), &children, 2);
    std::memcpy(bytes.data() + 2, &all_leaves, 2);
    std::memcpy(bytes.data() + 4, &node, 4);
    sink(bytes);
  }
}

}  // namespace sweepkit::impl
