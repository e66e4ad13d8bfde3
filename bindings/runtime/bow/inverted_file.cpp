// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/inverted_file.hpp"

#include <unistd.h>

#include <bit>
#include <cerrno>
#include <cfloat>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fstream>

#include "sweepkit/core/error.hpp"

namespace sweepkit {
namespace {

constexpr char kMagic[8] = {'s', 'w', 'k', 'i', 'n', 'v', '\r', '\n'};
constexpr std::uint32_t kVersion = 1;

std::uint64_t checksum_of(std::string_view bytes) {
  std::uint64_t sum = 0xcbf29ce484222325u;
  for (const char c : bytes) sum = (sum ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
  return sum;
}

template <class Number>
void append(std::string& bytes, Number number) {
  bytes.append(reinterpret_cast<const char*>(&number), sizeof(number));
}

/// Adds to the score of each image with a word.
template <class Term>
struct Adder {
  Term term;
  template <class Postings>
  void operator()(const Postings& postings, double v, double* score, std::uint32_t* common,
                  std::vector<std::uint32_t>& touched) const {
    for (const auto& posting : postings) {
      if (common[posting.slot]++ == 0) touched.push_back(posting.slot);
      score[posting.slot] += term(v, posting.weight);
    }
  }
};

}  // namespace

std::vector<std::uint32_t> InvertedFile::ids() const {
  std::vector<std::uint32_t> result;
  result.reserve(size());
  for (const auto& [id, slot] : slot_of_) result.push_back(id);
  std::sort(result.begin(), result.end());
  return result;
}

std::vector<InvertedFile::Posting>& InvertedFile::make_postings(std::uint32_t word) {
  const std::uint32_t page = word >> kPageBits;
  if (page >= pages_.size()) pages_.resize(page + 1);
  if (pages_[page].empty()) pages_[page].assign(std::size_t{1} << kPageBits, kNone);
  std::uint32_t& list = pages_[page][word & ((1u << kPageBits) - 1)];
  if (list == kNone) {
    list = static_cast<std::uint32_t>(lists_.size());
    lists_.emplace_back();
  }
  return lists_[list];
}

void InvertedFile::insert(std::uint32_t id, const Bag& bag) {
  require(!contains(id), "InvertedFile::insert id", "there is an image of this id", id);
  std::uint32_t slot;
  if (free_.empty()) {
    slot = static_cast<std::uint32_t>(entries_.size());
    entries_.emplace_back();
  } else {
    slot = free_.back();
    free_.pop_back();
  }
  entries_[slot].id = id;
  entries_[slot].words.assign(bag.words().begin(), bag.words().end());
  for (std::size_t i = 0; i < bag.size(); ++i)
    make_postings(bag.words()[i]).push_back({bag.weights()[i], slot});
  slot_of_.emplace(id, slot);
}

bool InvertedFile::remove(std::uint32_t id) {
  const auto found = slot_of_.find(id);
  if (found == slot_of_.end()) return false;
  const std::uint32_t slot = found->second;
  for (const std::uint32_t word : entries_[slot].words) {
    auto& list = make_postings(word);
    const auto posting =
        std::find_if(list.begin(), list.end(), [&](const Posting& p) { return p.slot == slot; });
    *posting = list.back();
    list.pop_back();
  }
  entries_[slot].words.clear();
  free_.push_back(slot);
  slot_of_.erase(found);
  return true;
}

void InvertedFile::query(const Bag& bag, const BagQueryOptions& options,
                         std::span<const std::uint32_t> excluded, Buffers& b,
                         std::vector<BagMatch>& matches) const {
  check_options(options);
  matches.clear();
  b.score_.assign(entries_.size(), 0.0);
  b.common_.assign(entries_.size(), 0);
  b.touched_.clear();
  b.excluded_.assign(entries_.size(), 0);
  for (const std::uint32_t id : excluded) {
    const auto found = slot_of_.find(id);
    if (found != slot_of_.end()) b.excluded_[found->second] = 1;
  }
  const double log_epsilon = std::log(DBL_EPSILON);
  const auto each_word = [&](const auto& adder) {
    for (std::size_t i = 0; i < bag.size(); ++i)
      if (const auto* list = postings(bag.words()[i]))
        adder(*list, bag.weights()[i], b.score_.data(), b.common_.data(), b.touched_);
  };
  const auto add = [&](auto term) { each_word(Adder<decltype(term)>{term}); };
  double base = 0;
  switch (score_) {
    case BagScore::l1:
      add([](double v, double w) { return v < w ? v : w; });
      break;
    case BagScore::l2:
    case BagScore::dot:
      add([](double v, double w) { return v * w; });
      break;
    case BagScore::chi_square:
      add([](double v, double w) { return v + w != 0 ? v * w / (v + w) : 0.0; });
      break;
    case BagScore::bhattacharyya:
      add([](double v, double w) { return std::sqrt(v * w); });
      break;
    case BagScore::kl:
      // As if no word were common; a common one then takes its part back.
      for (const double v : bag.weights())
        if (v != 0) base += v * (std::log(v) - log_epsilon);
      add([&](double v, double w) {
        if (v == 0) return 0.0;
        const double alone = v * (std::log(v) - log_epsilon);
        return w == 0 ? -alone : v * std::log(v / w) - alone;
      });
      break;
  }
  std::uint32_t most_common = 0;
  for (const std::uint32_t slot : b.touched_)
    if (!b.excluded_[slot]) most_common = std::max(most_common, b.common_[slot]);
  const double least_common = options.min_common * most_common;
  const bool descending = score_ != BagScore::kl;
  for (const std::uint32_t slot : b.touched_) {
    if (b.excluded_[slot] || b.common_[slot] < least_common) continue;
    double score = b.score_[slot] + base;
    if (score_ == BagScore::l2) score = score >= 1 ? 1.0 : 1.0 - std::sqrt(1.0 - score);
    if (score_ == BagScore::chi_square) score *= 2;
    if (descending ? score < options.min_score : options.min_score > 0 && score > options.min_score) continue;
    matches.push_back({entries_[slot].id, b.common_[slot], score});
  }
  const auto better = [&](const BagMatch& x, const BagMatch& y) {
    if (x.score != y.score) return descending ? x.score > y.score : x.score < y.score;
    return x.id < y.id;
  };
  const auto limit = static_cast<std::size_t>(options.max_results);
  if (limit > 0 && limit < matches.size()) {
    std::partial_sort(matches.begin(), matches.begin() + options.max_results, matches.end(), better);
    matches.resize(limit);
  } else {
    std::sort(matches.begin(), matches.end(), better);
  }
}

std::vector<std::pair<std::uint32_t, std::vector<std::pair<std::uint32_t, double>>>> InvertedFile::contents()
    const {
  std::vector<std::vector<std::pair<std::uint32_t, double>>> by_slot(entries_.size());
  for (std::uint32_t page = 0; page < pages_.size(); ++page)
    for (std::uint32_t i = 0; i < pages_[page].size(); ++i)
      if (pages_[page][i] != kNone)
        for (const Posting& posting : lists_[pages_[page][i]])
          by_slot[posting.slot].emplace_back(page << kPageBits | i, posting.weight);
  std::vector<std::pair<std::uint32_t, std::vector<std::pair<std::uint32_t, double>>>> result;
  for (const std::uint32_t id : ids()) result.emplace_back(id, std::move(by_slot[slot_of_.at(id)]));
  return result;
}

bool operator==(const InvertedFile& a, const InvertedFile& b) {
  return a.score_ == b.score_ && a.contents() == b.contents();
}

void InvertedFile::save(const std::string& path) const {
  // magic, version, score, images, checksum; then for each image id, number of words, words, weights.
  std::string body;
  for (const auto& [id, words] : contents()) {
    append(body, id);
    append(body, static_cast<std::uint32_t>(words.size()));
    for (const auto& [word, weight] : words) append(body, word);
    for (const auto& [word, weight] : words) append(body, weight);
  }
  std::string head(kMagic, sizeof(kMagic));
  append(head, kVersion);
  append(head, static_cast<std::uint32_t>(score_));
  append(head, static_cast<std::uint64_t>(size()));
  append(head, checksum_of(body));
  const std::string beside = path + "." + std::to_string(::getpid()) + ".part";
  std::ofstream file(beside, std::ios::binary | std::ios::trunc);
  file << head << body;
  file.close();
  if (!file || std::rename(beside.c_str(), path.c_str()) != 0) {
    const std::string reason = std::strerror(errno);
    std::remove(beside.c_str());
    throw Error(ErrorKind::io, path, "cannot be written", reason);
  }
}

InvertedFile InvertedFile::load(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw Error(ErrorKind::io, path, "cannot be opened");
  const std::string bytes((std::istreambuf_iterator<char>(file)), {});
  if (file.bad()) throw Error(ErrorKind::io, path, "cannot be read");
  std::size_t at = 0;
  const auto fail = [&](const char* what) {
    throw Error(ErrorKind::data, path, what, "byte " + std::to_string(at));
  };
  const auto take = [&](void* to, std::size_t count) {
    if (count > bytes.size() - at) fail("ends early");
    std::memcpy(to, bytes.data() + at, count);
    at += count;
  };
  char magic[8];
  std::uint32_t version = 0, score = 0;
  std::uint64_t images = 0, checksum = 0;
  take(magic, sizeof(magic));
  if (std::memcmp(magic, kMagic, sizeof(magic)) != 0) fail("is no inverted file");
  take(&version, 4);
  if (version != kVersion) fail("has an unknown version");
  take(&score, 4);
  if (score > 5) fail("has an unknown score");
  take(&images, 8);
  take(&checksum, 8);
  if (checksum_of(std::string_view(bytes).substr(at)) != checksum) fail("is damaged: the checksum is wrong");
  InvertedFile result(static_cast<BagScore>(score));
  for (std::uint64_t i = 0; i < images; ++i) {
    std::uint32_t id = 0, count = 0;
    take(&id, 4);
    take(&count, 4);
    if (count > (bytes.size() - at) / 12) fail("ends early");
    std::vector<std::uint32_t> words(count);
    std::vector<double> weights(count);
    if (count > 0) {
      take(words.data(), 4 * std::size_t{count});
      take(weights.data(), 8 * std::size_t{count});
    }
    try {
      result.insert(id, Bag(std::move(words), std::move(weights), 0x7fffffffu));
    } catch (const Error& error) {
      throw Error(ErrorKind::data, path, error.what());
    }
  }
  if (at != bytes.size()) fail("has bytes behind its end");
  return result;
}

}  // namespace sweepkit
