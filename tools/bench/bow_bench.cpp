// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Vocabularies and bags of words, one thread. Training images are 50 of the kitchen of 7-Scenes, about 1000
// ORB each; without SWEEPKIT_DATA, crops of the images of opencv-doc. "L3" is the vocabulary trained from
// them (K = 10, L = 3), asked with the features of the images. "L6" is a tree of K = 10, L = 6 and about
// 400,000 words made of random numbers, children near their parents, asked with descriptors near its leaves:
// every leaf is as likely, so caches help as little as they can. "plain" is the walk that one would write
// down: a node at a time, with the popcount instruction, and a std::map for the bag.
//
// Counters: bound_us is the time of what cannot be left out: for transform the comparisons alone, their data
// in the first-level cache; for load and save the reading or writing of the same bytes in one piece (for .gz
// the inflating). error is the mean distance of the training descriptors to their words [bits].
#include <benchmark/benchmark.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <vector>

#include "sweepkit/bow/inverted_file.hpp"
#include "sweepkit/bow/vocabulary.hpp"
#include "sweepkit/bow/vocabulary_file.hpp"
#include "sweepkit/bow/vocabulary_training.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/feature/orb.hpp"

using namespace sweepkit;

namespace {

using Descriptors = std::vector<OrbDescriptor>;

#ifdef SWEEPKIT_HAVE_AVX2
#define PLAIN_TARGET __attribute__((target("popcnt")))
#else
#define PLAIN_TARGET
#endif

PLAIN_TARGET int plain_distance(const OrbDescriptor& a, const OrbDescriptor& b) {
  int distance = 0;
  for (int w = 0; w < 4; ++w) distance += __builtin_popcountll(a.words[w] ^ b.words[w]);
  return distance;
}

std::vector<Descriptors> make_images() {
  std::vector<std::filesystem::path> files;
  const char* data = std::getenv("SWEEPKIT_DATA");
  const std::string folder =
      data ? std::string(data) + "/place_7scenes/images" : "/usr/share/doc/opencv-doc/examples/data";
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator(folder, ignored))
    if (entry.path().extension() == ".jpg") files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  std::vector<Descriptors> images;
  OrbExtractor orb;
  for (std::size_t i = 0; i < files.size() && images.size() < 50; i += data ? 2 : 1) {
    const cv::Mat image = cv::imread(files[i].string(), cv::IMREAD_GRAYSCALE);
    if (image.cols < 320 || image.rows < 240) continue;
    Features<256> features;
    orb.extract({image.data, image.cols, image.rows, static_cast<std::ptrdiff_t>(image.step)}, features);
    if (features.size() >= 800) images.push_back(features.descriptors);
  }
  return images;
}

const std::vector<Descriptors>& images() {
  static const std::vector<Descriptors> all = make_images();
  return all;
}

VocabularyTrainingOptions training_options() {
  VocabularyTrainingOptions options;
  options.threads = 1;
  return options;
}

VocabularyTree large_tree() {
  constexpr std::size_t kNodes = 444400;
  Random random(1);
  VocabularyTree tree;
  tree.branching = 10;
  tree.depth = 6;
  OrbDescriptor d{};
  tree.add(0, VocabularyTree::kNoWord, 0.0, d.words);
  std::uint32_t words = 0;
  for (std::uint32_t parent = 0, end = 1; parent < end; ++parent) {
    if (tree.size() + 10 > kNodes) {
      tree.word[parent] = words++;
      tree.weight[parent] = random.uniform(1.0, 8.0);
      continue;
    }
    for (int c = 0; c < 10; ++c) {
      for (int w = 0; w < 4; ++w)
        d.words[w] =
            parent == 0 ? random() : tree.descriptors[parent * 4 + w] ^ (random() & random() & random());
      tree.add(parent, VocabularyTree::kNoWord, 0.0, d.words);
    }
    end = static_cast<std::uint32_t>(tree.size());
  }
  return tree;
}

struct Subject {
  VocabularyTree tree;
  OrbVocabulary vocabulary;
  std::vector<Descriptors> queries;

  static const Subject& get(bool large) {
    static const Subject small_one = make(false);
    if (!large) return small_one;
    static const Subject large_one = make(true);
    return large_one;
  }

 private:
  static Subject make(bool large) {
    Subject s;
    if (!large) {
      if (images().empty()) return s;
      s.tree = sorted_by_level(train_vocabulary<256>(images(), training_options()));
      for (const Descriptors& image : images())
        s.queries.emplace_back(image.begin(),
                               image.begin() + std::min<std::ptrdiff_t>(1000, std::ssize(image)));
    } else {
      s.tree = sorted_by_level(large_tree());
      Random random(2);
      for (int i = 0; i < 20; ++i) {
        Descriptors query(1000);
        for (OrbDescriptor& d : query) {
          const std::size_t leaf = s.tree.size() - 1 - random.index(399000);
          for (int w = 0; w < 4; ++w)
            d.words[w] = s.tree.descriptors[leaf * 4 + w] ^ (random() & random() & random() & random());
        }
        s.queries.push_back(query);
      }
    }
    s.vocabulary = OrbVocabulary(s.tree);
    return s;
  }
};

/// The tree as linked nodes.
struct PlainVocabulary {
  struct Node {
    OrbDescriptor descriptor;
    std::vector<std::uint32_t> children;
    std::uint32_t word;
    double weight;
  };
  std::vector<Node> nodes;

  explicit PlainVocabulary(const VocabularyTree& tree) : nodes(tree.size()) {
    for (std::uint32_t i = 0; i < tree.size(); ++i) {
      std::copy_n(tree.descriptor(i).begin(), 4, nodes[i].descriptor.words.begin());
      nodes[i].word = tree.word[i];
      nodes[i].weight = tree.weight[i];
      if (i > 0) nodes[tree.parent[i]].children.push_back(i);
    }
  }
  PLAIN_TARGET const Node& leaf_of(const OrbDescriptor& d, std::int64_t& visits) const {
    const Node* node = &nodes[0];
    while (!node->children.empty()) {
      int best_distance = 1000;
      std::uint32_t best = 0;
      for (const std::uint32_t child : node->children) {
        const int distance = plain_distance(d, nodes[child].descriptor);
        if (distance < best_distance) {
          best_distance = distance;
          best = child;
        }
      }
      node = &nodes[best];
      ++visits;
    }
    return *node;
  }
  std::map<std::uint32_t, double> transform(const Descriptors& descriptors, std::int64_t& visits) const {
    std::map<std::uint32_t, double> bag;
    for (const OrbDescriptor& d : descriptors) {
      const Node& leaf = leaf_of(d, visits);
      if (leaf.weight > 0) bag[leaf.word] += leaf.weight;
    }
    double norm = 0;
    for (const auto& [word, weight] : bag) norm += std::abs(weight);
    for (auto& [word, weight] : bag) weight /= norm;
    return bag;
  }
};

double seconds(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

/// Time of one step down among ten children that lie in the first-level cache.
double step_seconds() {
  static const double result = [] {
    Random random(3);
    alignas(64) std::uint64_t planes[40];
    std::vector<std::uint64_t> queries(64 * 4);
    for (auto& word : planes) word = random();
    for (auto& word : queries) word = random();
    std::vector<impl::ChildSearch> searches;
    for (std::size_t i = 0; i < 64; ++i) searches.push_back({&queries[4 * i], planes, 10, 0, 0});
    double best = 1;
    for (int trial = 0; trial < 200; ++trial) {
      const auto begin = std::chrono::steady_clock::now();
      for (int k = 0; k < 10; ++k) {
        impl::nearest_children<4>(searches.data(), searches.size());
        benchmark::ClobberMemory();
      }
      best = std::min(best, seconds(begin) / 640);
    }
    return best;
  }();
  return result;
}

const char* name_of(bool large) { return large ? "L6" : "L3"; }

void transform(benchmark::State& state, bool large) {
  const Subject& s = Subject::get(large);
  if (s.queries.empty()) return state.SkipWithError("neither SWEEPKIT_DATA nor opencv-doc");
  Bag bag;
  TransformBuffers buffers;
  std::size_t i = 0;
  for (auto _ : state) {
    s.vocabulary.transform(s.queries[i++ % s.queries.size()], bag, buffers);
    benchmark::DoNotOptimize(bag);
  }
  const PlainVocabulary plain(s.tree);
  std::int64_t visits = 0;
  std::size_t features = 0;
  for (const Descriptors& query : s.queries) {
    plain.transform(query, visits);
    features += query.size();
  }
  const double count = static_cast<double>(s.queries.size());
  state.counters["features"] = static_cast<double>(features) / count;
  state.counters["words"] = s.vocabulary.word_count();
  state.counters["bound_us"] = static_cast<double>(visits) / count * step_seconds() * 1e6;
}

void transform_plain(benchmark::State& state, bool large) {
  const Subject& s = Subject::get(large);
  if (s.queries.empty()) return state.SkipWithError("neither SWEEPKIT_DATA nor opencv-doc");
  const PlainVocabulary plain(s.tree);
  std::size_t i = 0;
  std::int64_t visits = 0;
  for (auto _ : state) benchmark::DoNotOptimize(plain.transform(s.queries[i++ % s.queries.size()], visits));
}

void direct_index(benchmark::State& state, bool large) {
  const Subject& s = Subject::get(large);
  if (s.queries.empty()) return state.SkipWithError("neither SWEEPKIT_DATA nor opencv-doc");
  Bag bag;
  DirectIndex index;
  TransformBuffers buffers;
  std::size_t i = 0;
  for (auto _ : state) {
    s.vocabulary.transform(s.queries[i++ % s.queries.size()], 2, bag, index, buffers);
    benchmark::DoNotOptimize(index);
  }
}

void score(benchmark::State& state, bool large) {
  const Subject& s = Subject::get(large);
  if (s.queries.empty()) return state.SkipWithError("neither SWEEPKIT_DATA nor opencv-doc");
  const Bag a = s.vocabulary.transform(s.queries[0]), b = s.vocabulary.transform(s.queries[1]);
  for (auto _ : state) benchmark::DoNotOptimize(s.vocabulary.score(a, b));
  state.counters["words_a"] = static_cast<double>(a.size());
  state.counters["words_b"] = static_cast<double>(b.size());
}

void score_plain(benchmark::State& state, bool large) {
  const Subject& s = Subject::get(large);
  if (s.queries.empty()) return state.SkipWithError("neither SWEEPKIT_DATA nor opencv-doc");
  const PlainVocabulary plain(s.tree);
  std::int64_t visits = 0;
  const auto a = plain.transform(s.queries[0], visits), b = plain.transform(s.queries[1], visits);
  for (auto _ : state) {
    double sum = 0;
    for (auto i = a.begin(), j = b.begin(); i != a.end() && j != b.end();) {
      if (i->first == j->first) {
        sum += std::abs(i->second - j->second) - i->second - j->second;
        ++i;
        ++j;
      } else if (i->first < j->first) {
        ++i;
      } else {
        ++j;
      }
    }
    benchmark::DoNotOptimize(sum);
  }
}

double quantisation_error(const VocabularyTree& tree) {
  const PlainVocabulary plain(tree);
  double sum = 0;
  std::size_t count = 0;
  std::int64_t visits = 0;
  for (const Descriptors& image : images())
    for (const OrbDescriptor& d : image) {
      sum += plain_distance(d, plain.leaf_of(d, visits).descriptor);
      ++count;
    }
  return sum / static_cast<double>(count);
}

void train(benchmark::State& state) {
  if (images().empty()) return state.SkipWithError("neither SWEEPKIT_DATA nor opencv-doc");
  VocabularyTree tree;
  VocabularyTrainingOptions options = training_options();
  double error = 0;
  int runs = 0;
  for (auto _ : state) {
    options.seed = 1 + runs % 5;
    tree = train_vocabulary<256>(images(), options);
    if (++runs <= 5) {
      state.PauseTiming();
      error += quantisation_error(tree);
      state.ResumeTiming();
    }
  }
  std::size_t descriptors = 0;
  for (const Descriptors& image : images()) descriptors += image.size();
  state.counters["descriptors"] = static_cast<double>(descriptors);
  state.counters["error"] = error / std::min(runs, 5);
}

/// Hierarchical k-majority written down plainly: k-means++ seeds, rounds until no descriptor changes.
struct PlainTrainer {
  VocabularyTree tree;
  Random random;

  PLAIN_TARGET void split(std::uint32_t node, const Descriptors& own, int depth) {
    constexpr std::size_t kBranching = 10;
    Descriptors centres{own[random.index(own.size())]};
    std::vector<double> nearest(own.size(), 1e9);
    while (centres.size() < kBranching) {
      double sum = 0;
      for (std::size_t i = 0; i < own.size(); ++i)
        sum += nearest[i] = std::min<double>(nearest[i], plain_distance(own[i], centres.back()));
      if (sum == 0) break;
      double target = random.uniform() * sum;
      std::size_t i = 0;
      while (i + 1 < own.size() && (target -= nearest[i]) >= 0) ++i;
      centres.push_back(own[i]);
    }
    std::vector<std::size_t> label(own.size(), centres.size());
    std::vector<Descriptors> members;
    for (bool changed = true; changed;) {
      changed = false;
      members.assign(centres.size(), {});
      for (std::size_t i = 0; i < own.size(); ++i) {
        std::size_t best = 0;
        int best_distance = 1000;
        for (std::size_t c = 0; c < centres.size(); ++c)
          if (const int distance = plain_distance(own[i], centres[c]); distance < best_distance) {
            best_distance = distance;
            best = c;
          }
        changed |= label[i] != best;
        label[i] = best;
        members[best].push_back(own[i]);
      }
      if (!changed) break;
      for (std::size_t c = 0; c < centres.size(); ++c) {
        if (members[c].empty()) continue;
        int votes[256] = {};
        for (const OrbDescriptor& d : members[c])
          for (int b = 0; b < 256; ++b) votes[b] += static_cast<int>(d.words[b / 64] >> (b % 64) & 1);
        centres[c] = {};
        for (int b = 0; b < 256; ++b)
          if (2 * votes[b] >= static_cast<int>(members[c].size()))
            centres[c].words[b / 64] |= std::uint64_t{1} << (b % 64);
      }
    }
    for (std::size_t c = 0; c < centres.size(); ++c) {
      const auto child = tree.add(node, VocabularyTree::kNoWord, 1.0, centres[c].words);
      if (depth < 3 && members[c].size() > 1) split(child, members[c], depth + 1);
    }
  }
};

void train_plain(benchmark::State& state) {
  if (images().empty()) return state.SkipWithError("neither SWEEPKIT_DATA nor opencv-doc");
  Descriptors all;
  for (const Descriptors& image : images()) all.insert(all.end(), image.begin(), image.end());
  double error = 0;
  std::uint64_t runs = 0;
  for (auto _ : state) {
    PlainTrainer trainer{{}, Random(++runs)};
    const OrbDescriptor zero{};
    trainer.tree.add(0, VocabularyTree::kNoWord, 0.0, zero.words);
    trainer.split(0, all, 1);
    state.PauseTiming();
    error += quantisation_error(trainer.tree);
    state.ResumeTiming();
  }
  state.counters["error"] = error / static_cast<double>(runs);
}

struct FileCase {
  VocabularyFormat format;
  const char* suffix;
};
constexpr FileCase kFiles[] = {
    {VocabularyFormat::sweepkit, ".swv"},       {VocabularyFormat::dbow2_yaml, ".yml"},
    {VocabularyFormat::dbow2_yaml, ".yml.gz"},  {VocabularyFormat::orbslam_text, ".txt"},
    {VocabularyFormat::dbow3_binary, ".dbow3"}, {VocabularyFormat::dbow3_compressed, ".packed.dbow3"},
    {VocabularyFormat::fbow, ".fbow"}};

std::string file_path(bool large, const FileCase& c) {
  return (std::filesystem::temp_directory_path() /
          ("sweepkit_bench_" + std::to_string(::getpid()) + name_of(large) + c.suffix))
      .string();
}

/// Reads a file in one piece, or inflates it.
double read_seconds(const std::string& path) {
  std::vector<char> buffer(1 << 20);
  double best = 1e9;
  for (int trial = 0; trial < 3; ++trial) {
    const auto begin = std::chrono::steady_clock::now();
    const gzFile file = gzopen(path.c_str(), "rb");
    while (gzread(file, buffer.data(), static_cast<unsigned>(buffer.size())) > 0) benchmark::ClobberMemory();
    gzclose(file);
    best = std::min(best, seconds(begin));
  }
  return best;
}

void load(benchmark::State& state, bool large, const FileCase& c) {
  const Subject& s = Subject::get(large);
  if (s.queries.empty()) return state.SkipWithError("neither SWEEPKIT_DATA nor opencv-doc");
  const std::string path = file_path(large, c);
  write_vocabulary(path, s.tree, c.format);
  for (auto _ : state) benchmark::DoNotOptimize(load_vocabulary<256>(path).word_count());
  state.counters["bytes"] = static_cast<double>(std::filesystem::file_size(path));
  if (c.format != VocabularyFormat::sweepkit) state.counters["bound_us"] = read_seconds(path) * 1e6;
  std::filesystem::remove(path);
}

void save(benchmark::State& state, bool large, const FileCase& c) {
  const Subject& s = Subject::get(large);
  if (s.queries.empty()) return state.SkipWithError("neither SWEEPKIT_DATA nor opencv-doc");
  const std::string path = file_path(large, c);
  for (auto _ : state) {
    if (c.format == VocabularyFormat::sweepkit)
      s.vocabulary.save(path);
    else
      write_vocabulary(path, s.tree, c.format);
  }
  const std::size_t bytes = std::filesystem::file_size(path);
  const std::string content(bytes, 'x');
  double best = 1e9;
  for (int trial = 0; trial < 3; ++trial) {
    const auto begin = std::chrono::steady_clock::now();
    std::ofstream(path, std::ios::binary).write(content.data(), static_cast<std::streamsize>(bytes));
    best = std::min(best, seconds(begin));
  }
  state.counters["bytes"] = static_cast<double>(bytes);
  state.counters["bound_us"] = best * 1e6;
  std::filesystem::remove(path);
}

/// One image asked for among a thousand.
void query(benchmark::State& state, bool large) {
  const Subject& s = Subject::get(large);
  if (s.queries.empty()) return state.SkipWithError("neither SWEEPKIT_DATA nor opencv-doc");
  std::vector<Bag> bags;
  for (const Descriptors& q : s.queries) bags.push_back(s.vocabulary.transform(q));
  InvertedFile file;
  for (std::uint32_t id = 0; id < 1000; ++id) file.insert(id, bags[id % bags.size()]);
  InvertedFile::Buffers buffers;
  std::vector<BagMatch> matches;
  BagQueryOptions options;
  options.max_results = 20;
  std::size_t i = 0;
  for (auto _ : state) {
    file.query(bags[i++ % bags.size()], options, {}, buffers, matches);
    benchmark::DoNotOptimize(matches);
  }
}

const int kRegistered = [] {
  const auto us = benchmark::kMicrosecond;
  for (const bool large : {false, true}) {
    const std::string size = name_of(large);
    const auto add = [&](const std::string& name, auto body) {
      return benchmark::RegisterBenchmark(("bow/" + name + "/" + size).c_str(),
                                          [body, large](benchmark::State& state) { body(state, large); })
          ->Unit(us);
    };
    add("transform/sweepkit", transform);
    add("transform/plain", transform_plain);
    add("direct_index/sweepkit", direct_index);
    add("score/sweepkit", score);
    add("score/plain", score_plain);
    add("query_1000/sweepkit", query);
    for (const FileCase& c : kFiles) {
      const std::string name =
          std::string(to_string(c.format)) + (std::string_view(c.suffix) == ".yml.gz" ? "_gz" : "");
      add("load/" + name, [&c](benchmark::State& state, bool l) { load(state, l, c); });
      add("save/" + name, [&c](benchmark::State& state, bool l) { save(state, l, c); });
    }
  }
  benchmark::RegisterBenchmark("bow/train/sweepkit/L3", train)->Unit(benchmark::kMillisecond);
  benchmark::RegisterBenchmark("bow/train/plain/L3", train_plain)->Unit(benchmark::kMillisecond);
  return 0;
}();

}  // namespace
