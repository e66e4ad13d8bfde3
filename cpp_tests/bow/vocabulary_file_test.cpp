// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/vocabulary_file.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>

#include "bow/random_tree.hpp"
#include "scratch_folder.hpp"

using namespace sweepkit;

namespace {

std::string content_of(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return std::string((std::istreambuf_iterator<char>(in)), {});
}

template <class Number>
std::string bytes_of(Number number) {
  return std::string(reinterpret_cast<const char*>(&number), sizeof(number));
}

/// The files have single precision there.
VocabularyTree as_fbow(VocabularyTree tree) {
  tree = sorted_by_level(tree);
  for (double& weight : tree.weight) weight = static_cast<float>(weight);
  tree.weighting = BagWeighting::tf_idf;
  tree.score = BagScore::l2;
  return tree;
}

struct NamedFormat {
  VocabularyFormat format;
  const char* file;
};
constexpr NamedFormat kAll[] = {
    {VocabularyFormat::sweepkit, "v.swv"},           {VocabularyFormat::dbow2_yaml, "v.yml"},
    {VocabularyFormat::dbow2_yaml, "v.yml.gz"},      {VocabularyFormat::orbslam_text, "v.txt"},
    {VocabularyFormat::orbslam_text, "v.txt.gz"},    {VocabularyFormat::dbow3_yaml, "w.yml"},
    {VocabularyFormat::dbow3_yaml, "w.yml.gz"},      {VocabularyFormat::dbow3_binary, "v.dbow3"},
    {VocabularyFormat::dbow3_compressed, "w.dbow3"}, {VocabularyFormat::fbow, "v.fbow"}};

/// A node as DBoW2's own structures have it, filled by streams from ORB-SLAM's text.
struct PlainNode {
  std::vector<std::size_t> children;
  std::array<int, 32> bytes{};
  double weight = 0;
  int word = -1;
};

std::vector<PlainNode> plain_text_vocabulary(const std::string& path) {
  std::ifstream in(path);
  std::string line;
  std::getline(in, line);
  std::vector<PlainNode> nodes(1);
  int words = 0;
  while (std::getline(in, line) && !line.empty()) {
    std::istringstream fields(line);
    std::size_t parent;
    int leaf;
    PlainNode node;
    fields >> parent >> leaf;
    for (int& byte : node.bytes) fields >> byte;
    fields >> node.weight;
    if (leaf) node.word = words++;
    nodes.at(parent).children.push_back(nodes.size());
    nodes.push_back(node);
  }
  return nodes;
}

std::pair<int, double> plain_word(const std::vector<PlainNode>& nodes, const OrbDescriptor& descriptor) {
  std::size_t node = 0;
  while (!nodes[node].children.empty()) {
    int best_distance = 1000;
    std::size_t best = 0;
    for (const std::size_t child : nodes[node].children) {
      int distance = 0;
      for (std::size_t b = 0; b < 32; ++b)
        distance += std::popcount(static_cast<unsigned>(nodes[child].bytes[b]) ^
                                  static_cast<unsigned>(descriptor.words[b / 8] >> (b % 8 * 8) & 255));
      if (distance < best_distance) {
        best_distance = distance;
        best = child;
      }
    }
    node = best;
  }
  return {nodes[node].word, nodes[node].word < 0 ? 0.0 : nodes[node].weight};
}

const char* vocabularies() {
  const char* data = std::getenv("SWEEPKIT_DATA");
  if (!data) WARN("SWEEPKIT_DATA is not set: vocabularies of other libraries are not read");
  return data;
}

}  // namespace

TEST_CASE("random trees come back from every format", "[bow]") {
  const ScratchFolder folder;
  for (const std::uint64_t seed : {1, 2, 3, 4, 5, 6}) {
    RandomTreeShape shape{.bits = seed == 4   ? 512
                                  : seed == 5 ? 64
                                              : 256,
                          .branching = 3 + static_cast<int>(seed),
                          .depth = 3,
                          .full = seed == 1,
                          .unnamed_leaves = seed == 2,
                          .alike = seed == 3};
    VocabularyTree tree = random_tree(shape, seed);
    tree.weighting = static_cast<BagWeighting>(seed % 4);
    tree.score = static_cast<BagScore>(seed % 6);
    for (const auto& [format, name] : kAll) {
      INFO(name << ", seed " << seed);
      if (format == VocabularyFormat::fbow && shape.unnamed_leaves) continue;
      const std::string path = (folder / name).string();
      write_vocabulary(path, tree, format);
      CHECK(detect_vocabulary_format(path) == format);
      const VocabularyTree back = read_vocabulary(path);
      VocabularyTree expected = sorted_by_level(tree);
      if (format == VocabularyFormat::fbow) {
        expected = as_fbow(tree);
        // The file holds no depth; this tree may be less deep than asked for, and wider nowhere.
        expected.depth = back.depth;
      }
      CHECK(sorted_by_level(back) == expected);
    }
  }
}

TEST_CASE("words keep their numbers where other libraries would give others", "[bow]") {
  const ScratchFolder folder;
  VocabularyTree tree = random_tree({.branching = 4, .depth = 2}, 1);
  // Numbered from behind: text, whose words are numbered by their lines, cannot hold that.
  std::uint32_t words = 16;
  for (auto& word : tree.word)
    if (word != VocabularyTree::kNoWord) word = --words;
  for (const auto& [format, name] : kAll) {
    const std::string path = (folder / name).string();
    if (format == VocabularyFormat::orbslam_text) {
      CHECK_THROWS_AS(write_vocabulary(path, tree, format), Error);
      CHECK_FALSE(std::filesystem::exists(path));
      continue;
    }
    write_vocabulary(path, tree, format);
    CHECK(sorted_by_level(read_vocabulary(path)).word == sorted_by_level(tree).word);
  }
  // Gaps are for our own and FBoW's files alone.
  tree.word.back() = 1000;
  CHECK_THROWS_AS(write_vocabulary((folder / "gap.yml").string(), tree, VocabularyFormat::dbow2_yaml), Error);
  CHECK_NOTHROW(write_vocabulary((folder / "gap.fbow").string(), tree, VocabularyFormat::fbow));
  CHECK_NOTHROW(
      write_vocabulary((folder / "gap.yml").string(), renumbered(tree), VocabularyFormat::dbow2_yaml));
}

TEST_CASE("packed files of DBoW3 are smaller, with equal content too", "[bow]") {
  const ScratchFolder folder;
  for (const bool alike : {false, true}) {
    VocabularyTree tree = random_tree({.branching = 9, .depth = 3, .alike = alike}, 21);
    if (alike) std::fill(tree.descriptors.begin(), tree.descriptors.end(), 0);
    const std::string raw = (folder / "raw.dbow3").string(), packed = (folder / "packed.dbow3").string();
    write_vocabulary(raw, tree, VocabularyFormat::dbow3_binary);
    write_vocabulary(packed, tree, VocabularyFormat::dbow3_compressed);
    CHECK(read_vocabulary(packed) == read_vocabulary(raw));
    CHECK(std::filesystem::file_size(packed) < (alike ? 0.5 : 0.9) * std::filesystem::file_size(raw));
  }
}

TEST_CASE("names and formats", "[bow]") {
  CHECK(vocabulary_format("fbow") == VocabularyFormat::fbow);
  CHECK_THROWS_AS(vocabulary_format("bow"), Error);
  CHECK(vocabulary_format_of_name("a/b.yml.gz") == VocabularyFormat::dbow2_yaml);
  CHECK(vocabulary_format_of_name("b.swv") == VocabularyFormat::sweepkit);
  CHECK(vocabulary_format_of_name("b.dbow3") == VocabularyFormat::dbow3_binary);
  CHECK_THROWS_AS(vocabulary_format_of_name("b.bin"), Error);
}

TEST_CASE("a small DBoW2 yaml is read", "[bow]") {
  const ScratchFolder folder;
  const auto path = folder
                        .write("small.yml", R"(%YAML:1.0
---
vocabulary:
   k: 2
   L: 2
   scoringType: 1
   weightingType: 3
   nodes:
      - { nodeId:2, parentId:0, weight:0.,
          descriptor:"1 0 0 0 0 0 0 0 " }
      - { nodeId:1, parentId:0, weight:1.5e+00,
          descriptor:"255 255 255 255 255 255 255 255 " }
      - { nodeId:3, parentId:2, weight:2.,
          descriptor:"3 0 0 0 0 0 0 128 " }
   words:
      - { wordId:1, nodeId:1 }
      - { wordId:0, nodeId:3 }
)")
                        .string();
  CHECK(detect_vocabulary_format(path) == VocabularyFormat::dbow2_yaml);
  const VocabularyTree tree = read_vocabulary(path);
  CHECK(tree.bits == 64);
  CHECK(tree.branching == 2);
  CHECK(tree.depth == 2);
  CHECK(tree.score == BagScore::l2);
  CHECK(tree.weighting == BagWeighting::binary);
  CHECK(tree.parent == std::vector<std::uint32_t>{0, 0, 0, 1});
  CHECK(tree.word == std::vector<std::uint32_t>{0xffffffffu, 0xffffffffu, 1, 0});
  CHECK(tree.weight[2] == 1.5);
  CHECK(tree.weight[3] == 2.0);
  CHECK(tree.descriptors == std::vector<std::uint64_t>{0, 1, ~0ull, 0x8000000000000003ull});
}

TEST_CASE("both spellings of DBoW3's descriptors are read", "[bow]") {
  const ScratchFolder folder;
  for (const char* mark : {"", "dbw3 "}) {
    const std::string text = std::string("%YAML:1.0\nvocabulary:\n k: 2\n L: 1\n scoringType: 0\n") +
                             " weightingType: 0\n nodes:\n  - { nodeId:1, parentId:0, weight:1.,\n" +
                             "    descriptor:\"" + mark + "0 8 7 0 0 0 0 0 0 1 \" }\n" +
                             " words:\n  - { wordId:0, nodeId:1 }\n";
    const auto path = folder.write("d.yml", text).string();
    CHECK(detect_vocabulary_format(path) == VocabularyFormat::dbow3_yaml);
    CHECK(read_vocabulary(path).descriptors == std::vector<std::uint64_t>{0, 0x0100000000000007ull});
  }
}

TEST_CASE("a DBoW3 binary built byte by byte is read, stored and packed", "[bow]") {
  const ScratchFolder folder;
  std::string body = bytes_of(std::int32_t{2}) + bytes_of(std::int32_t{1}) + bytes_of(std::int32_t{0}) +
                     bytes_of(std::int32_t{0});
  for (std::uint32_t id : {1u, 2u})
    body += bytes_of(id) + bytes_of(std::uint32_t{0}) + bytes_of(0.5 * id) + bytes_of(std::int32_t{8}) +
            bytes_of(std::int32_t{1}) + bytes_of(std::int32_t{0}) + bytes_of(std::uint64_t{id * 0x101});
  body += bytes_of(std::uint32_t{2});
  for (std::uint32_t word : {0u, 1u}) body += bytes_of(word) + bytes_of(word + 1);
  const auto head = [&](bool packed) {
    return bytes_of(std::uint64_t{88877711233}) + bytes_of(packed) + bytes_of(std::uint32_t{3});
  };
  const VocabularyTree raw = read_vocabulary(folder.write("raw", head(false) + body).string());
  CHECK(raw.weight == std::vector<double>{0, 0.5, 1.0});
  CHECK(raw.word == std::vector<std::uint32_t>{0xffffffffu, 0, 1});
  CHECK(raw.descriptors == std::vector<std::uint64_t>{0, 0x101, 0x202});

  // Short header, every byte a literal: control words of 31 bits, then a mark. The last bytes too.
  std::string chunk;
  for (std::size_t i = 0; i < body.size(); ++i) {
    if (i % 31 == 0) chunk += bytes_of(std::uint32_t{0x80000000u});
    chunk += body[i];
  }
  const auto packed = [&](const std::string& c, std::size_t size) {
    return std::string(1, '\x47') + bytes_of(static_cast<std::uint32_t>(c.size() + 9)) +
           bytes_of(static_cast<std::uint32_t>(size)) + c;
  };
  const std::string one = bytes_of(std::uint32_t{1});
  CHECK(read_vocabulary(folder.write("packed", head(true) + one + packed(chunk, body.size())).string()) ==
        raw);

  // Matches: after "abcabc" the hash of "abc" is known. 24 zero bytes from 3 and a match that overlaps.
  std::string with_match = body;
  // bytes 17 .. 19 of the body are zeros of the parent and of the weight's start; 0,0,0 hashes to 0
  std::string coded;
  std::uint32_t control = 0;
  std::string pending;
  int bits = 0;
  const auto flush = [&] {
    coded += bytes_of(control | 1u << bits) + pending;
    control = 0;
    bits = 0;
    pending.clear();
  };
  std::size_t at = 0;
  std::array<std::size_t, 4096> where{};
  std::size_t hashed = 0;
  const auto hash_at = [&](std::size_t i) {
    const auto b = [&](std::size_t k) {
      return static_cast<std::uint32_t>(static_cast<unsigned char>(body[k]));
    };
    const std::uint32_t next = b(i) | b(i + 1) << 8 | b(i + 2) << 16;
    return (next >> 12 ^ next) & 4095;
  };
  int matches = 0;
  while (at < body.size()) {
    if (bits == 31) flush();
    std::size_t length = 0, from = 0;
    if (at + 20 < body.size() && at >= 3) {
      from = where[hash_at(at)];
      if (from + 3 <= at)
        while (length < 200 && at + length + 12 < body.size() && body[from + length] == body[at + length])
          ++length;
    }
    if (length >= 3) {
      const std::uint32_t hash = hash_at(at);
      const bool small = length < 18;
      pending += bytes_of(static_cast<std::uint16_t>(hash << 4 | (small ? length - 2 : 0)));
      if (!small) pending += static_cast<char>(length);
      control |= 1u << bits;
      at += length;
      for (; hashed < at + 1 - length; ++hashed) where[hash_at(hashed)] = hashed;
      hashed = at;
      ++matches;
    } else {
      pending += body[at++];
      for (; at >= 3 && hashed < at - 2; ++hashed) where[hash_at(hashed)] = hashed;
    }
    ++bits;
  }
  if (bits > 0) flush();
  CHECK(matches > 3);
  CHECK(coded.size() < body.size());
  CHECK(read_vocabulary(folder.write("matched", head(true) + one + packed(coded, body.size())).string()) ==
        raw);

  // What cannot be read says so.
  std::string other = packed(chunk, body.size());
  other[0] = '\x4f';
  try {
    read_vocabulary(folder.write("level3", head(true) + one + other).string());
    FAIL("level 3 is not read");
  } catch (const Error& error) {
    CHECK(std::string(error.what()).find("uncompressed") != std::string::npos);
  }
}

TEST_CASE("an FBoW file built byte by byte is read", "[bow]") {
  const ScratchFolder folder;
  // One root block with a leaf and a link, and the block of the link with a leaf.
  const std::uint32_t k = 2;
  const std::uint64_t stride = 8, at = 8, links = at + k * stride, size = links + 8 * k;
  std::string head = bytes_of(std::uint64_t{55824124}) + std::string(52, '\0') + bytes_of(std::uint32_t{8}) +
                     bytes_of(std::uint32_t{2}) + std::string(4, '\0') + bytes_of(stride) + bytes_of(size) +
                     bytes_of(at) + bytes_of(links) + bytes_of(std::uint64_t{2 * size}) +
                     bytes_of(std::int32_t{0}) + bytes_of(std::int32_t{8}) + bytes_of(k) +
                     std::string(4, '\0');
  const std::string root = bytes_of(std::uint16_t{2}) + bytes_of(std::uint16_t{0}) +
                           bytes_of(std::uint32_t{0}) + bytes_of(std::uint64_t{5}) +
                           bytes_of(std::uint64_t{9}) + bytes_of(0x80000000u | 77u) + bytes_of(0.25f) +
                           bytes_of(std::uint32_t{1}) + bytes_of(0.0f);
  const std::string child = bytes_of(std::uint16_t{1}) + bytes_of(std::uint16_t{1}) +
                            bytes_of(std::uint32_t{2}) + bytes_of(std::uint64_t{6}) +
                            bytes_of(std::uint64_t{0}) + bytes_of(0x80000000u | 3u) + bytes_of(0.5f) +
                            std::string(8, '\0');
  const VocabularyTree tree = read_vocabulary(folder.write("v.fbow", head + root + child).string());
  CHECK(tree.parent == std::vector<std::uint32_t>{0, 0, 0, 2});
  CHECK(tree.word == std::vector<std::uint32_t>{0xffffffffu, 77, 0xffffffffu, 3});
  CHECK(tree.weight == std::vector<double>{0, 0.25, 0, 0.5});
  CHECK(tree.descriptors == std::vector<std::uint64_t>{0, 5, 9, 6});
  CHECK(tree.score == BagScore::l2);
  CHECK(tree.depth == 2);
  CHECK_THROWS_AS(read_vocabulary(folder.write("short.fbow", head + root).string()), Error);
  // A block that links to itself.
  std::string loop = child;
  loop.replace(links, 4, bytes_of(std::uint32_t{1}));
  CHECK_THROWS_AS(read_vocabulary(folder.write("loop.fbow", head + root + loop).string()), Error);
}

TEST_CASE("damaged files of every format give errors or other vocabularies, never more", "[bow]") {
  const ScratchFolder folder;
  const VocabularyTree tree = random_tree({.branching = 4, .depth = 3, .full = false}, 9);
  const auto descriptors = random_descriptors<256>(tree, 20, 10);
  Random random(11);
  for (const auto& [format, name] : kAll) {
    INFO(name);
    const std::string path = (folder / name).string();
    write_vocabulary(path, tree, format);
    const std::string whole = content_of(path);
    int refused = 0;
    for (int trial = 0; trial < 400; ++trial) {
      std::string damaged = whole;
      if (trial % 4 == 0) {
        damaged.resize(random.index(whole.size()));
      } else if (trial % 4 == 1) {
        damaged.insert(random.index(whole.size()), 1 + random.index(3), static_cast<char>(random()));
      } else {
        const std::size_t reach = trial % 4 == 2 ? std::min<std::size_t>(whole.size(), 200) : whole.size();
        for (std::uint64_t k = 0; k <= random.index(3); ++k)
          damaged[random.index(reach)] = static_cast<char>(trial % 8 < 4 ? random() : '0' + random.index(10));
      }
      const std::string file = (folder / "damaged").string();
      std::ofstream(file, std::ios::binary) << damaged;
      try {
        const auto back = read_vocabulary(file);
        check_vocabulary_tree(back);
        if (back.bits == 256) OrbVocabulary(back).transform(descriptors);
      } catch (const Error& error) {
        if (error.kind() != ErrorKind::data) FAIL_CHECK(error.what());
        ++refused;
      }
    }
    CHECK(refused > 100);
  }
  for (const char* text : {"", "%", "%YAML:1.0\n", "10 6 0 0\n", "10 6\n0 1 2 3\n", "\x1f\x8b", "hello"})
    CHECK_THROWS_AS(read_vocabulary(folder.write("x", text).string()), Error);
  CHECK_THROWS_AS(read_vocabulary((folder / "absent").string()), Error);
  CHECK_THROWS_AS(read_vocabulary(folder.path().string()), Error);
}

TEST_CASE("messages name file, line and value", "[bow]") {
  const ScratchFolder folder;
  const auto path =
      folder.write("bad.txt", "2 1 0 0\n0 1 1 2 3 4 5 6 7 8 1.5\n0 1 1 2 3 4 5 6 7 1.5\n").string();
  try {
    read_vocabulary(path);
    FAIL("a node is cut short");
  } catch (const Error& error) {
    CHECK(error.place() == path + ":4");
    CHECK(error.value() == "0 1 1 2 3 4 5 6 7 1.5");
  }
}

TEST_CASE("vocabularies of other libraries give the words of a plain walk", "[bow]") {
  const char* data = vocabularies();
  if (!data) return;
  const std::string folder = std::string(data) + "/vocabularies/";
  struct Case {
    const char* file;
    VocabularyFormat format;
    std::uint32_t nodes, words;
    int branching, depth;
  };
  for (const auto& c :
       {Case{"dbow2_orb_k9_L3.yml.gz", VocabularyFormat::dbow2_yaml, 781, 692, 9, 3},
        Case{"dbow2_orb_k9_L3.txt", VocabularyFormat::orbslam_text, 781, 692, 9, 3},
        Case{"dbow3_orb_k10_L5.yml.gz", VocabularyFormat::dbow3_yaml, 6162, 4983, 10, 5},
        Case{"orbslam_orb_k10_L6_truncated.txt", VocabularyFormat::orbslam_text, 9998, 8959, 10, 6}}) {
    INFO(c.file);
    CHECK(detect_vocabulary_format(folder + c.file) == c.format);
    const auto vocabulary = load_vocabulary<256>(folder + c.file);
    // Their counts leave the root out, but for the first file's.
    CHECK(std::abs(static_cast<int>(vocabulary.info().node_count) - static_cast<int>(c.nodes)) <= 1);
    CHECK(vocabulary.word_count() == c.words);
    CHECK(vocabulary.info().branching == c.branching);
    CHECK(vocabulary.info().depth == c.depth);
    CHECK_NOTHROW(vocabulary.image().verify());
    // And back in every format.
    const ScratchFolder scratch;
    const VocabularyTree tree = vocabulary.tree();
    for (const auto& [format, name] : kAll) {
      // FBoW has no leaves without words, and the truncated file has many.
      if (format == VocabularyFormat::fbow) continue;
      write_vocabulary((scratch / name).string(), tree, format);
      CHECK(sorted_by_level(read_vocabulary((scratch / name).string())) == tree);
    }
  }
  for (const char* file : {"dbow2_orb_k9_L3.txt", "orbslam_orb_k10_L6_truncated.txt"}) {
    const auto nodes = plain_text_vocabulary(folder + file);
    const auto vocabulary = load_vocabulary<256>(folder + file);
    const auto descriptors = random_descriptors<256>(vocabulary.tree(), 500, 12);
    std::vector<std::uint32_t> words(500);
    std::vector<double> weights(500);
    vocabulary.find_words(descriptors, words, weights);
    std::map<int, double> bag;
    for (std::size_t i = 0; i < 500; ++i) {
      const auto [word, weight] = plain_word(nodes, descriptors[i]);
      CHECK(static_cast<int>(words[i]) == word);
      CHECK(weights[i] == weight);
      if (weight > 0) bag[word] += weight;
    }
    // DBoW2's bag: sums, then divided by the L1 norm, all in the order of words.
    double norm = 0;
    for (const auto& [word, weight] : bag) norm += std::abs(weight);
    const Bag ours = vocabulary.transform(descriptors);
    REQUIRE(ours.size() == bag.size());
    std::size_t i = 0;
    for (const auto& [word, weight] : bag) {
      CHECK(ours.words()[i] == static_cast<std::uint32_t>(word));
      CHECK(ours.weights()[i] == weight / norm);
      ++i;
    }
  }
  // The same tree in two formats.
  const auto yaml = load_vocabulary<256>(folder + "dbow2_orb_k9_L3.yml.gz").tree();
  const auto text = load_vocabulary<256>(folder + "dbow2_orb_k9_L3.txt").tree();
  CHECK(yaml.word == text.word);
  CHECK(yaml.descriptors == text.descriptors);
}
