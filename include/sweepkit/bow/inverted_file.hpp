// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "sweepkit/bow/bag.hpp"
#include "sweepkit/core/options.hpp"

namespace sweepkit {

struct BagQueryOptions {
  int max_results = 0;
  double min_score = 0.0;
  double min_common = 0.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(max_results, "max_results", "", range(0, 1000000000), "most images to give; 0: all");
    v(min_score, "min_score", "", range(0.0, 1e30),
      "least score of an image to give (kl: the largest, 0 for any)");
    v(min_common, "min_common", "", range(0.0, 1.0),
      "least number of common words, as a part of the most that any image has");
  }
};

/// An image that shares words with the one asked for.
struct BagMatch {
  std::uint32_t id = 0;
  std::uint32_t common_words = 0;
  double score = 0;  ///< as bag_score gives it

  friend bool operator==(const BagMatch&, const BagMatch&) = default;
};

/// Images that belong together, by their best.
struct BagGroup {
  BagMatch best;                       ///< the member most alike
  double score = 0;                    ///< sum over the members
  std::vector<std::uint32_t> members;  ///< ids, in the order of `matches`
};

/// Images by their words: for each word the images that have it (Sivic and Zisserman 2003). Images come and
/// go one by one; a query costs time for those alone that share words with it. Ids are the caller's own.
/// Queries may run in several threads at once, each with buffers of its own, while nothing is inserted or
/// removed.
class InvertedFile {
 public:
  /// What a query works with; keep it between queries.
  class Buffers {
    friend class InvertedFile;
    std::vector<double> score_;
    std::vector<std::uint32_t> common_, touched_;
    std::vector<std::uint8_t> excluded_;
  };

  /// @param score how bags are compared; they must be normalised for it
  explicit InvertedFile(BagScore score = BagScore::l1) : score_(score) {}

  BagScore score() const { return score_; }
  std::size_t size() const { return slot_of_.size(); }
  bool contains(std::uint32_t id) const { return slot_of_.count(id) > 0; }
  /// Ids of all images, ascending.
  std::vector<std::uint32_t> ids() const;

  /// Throws Error(argument) if there is an image of that id.
  void insert(std::uint32_t id, const Bag& bag);
  /// False if there is no image of that id.
  bool remove(std::uint32_t id);
  void clear() { *this = InvertedFile(score_); }

  /// Images that share a word with the bag, best first and of equal ones by id. Scores are those of
  /// bag_score. For BagScore::kl, a divergence from the bag, the smallest come first.
  /// @param excluded ids that are not to be found; others than those of the file are allowed
  void query(const Bag& bag, const BagQueryOptions& options, std::span<const std::uint32_t> excluded,
             Buffers& buffers, std::vector<BagMatch>& matches) const;
  /// One call without kept buffers.
  std::vector<BagMatch> query(const Bag& bag, const BagQueryOptions& options = {},
                              std::span<const std::uint32_t> excluded = {}) const {
    Buffers buffers;
    std::vector<BagMatch> matches;
    query(bag, options, excluded, buffers, matches);
    return matches;
  }

  /// `path` is replaced when all is written. Throws Error(io).
  void save(const std::string& path) const;
  /// Throws Error(io), or Error(data) where the file is damaged.
  static InvertedFile load(const std::string& path);

  friend bool operator==(const InvertedFile& a, const InvertedFile& b);

 private:
  struct Posting {
    double weight;
    std::uint32_t slot;
  };
  struct Entry {
    std::uint32_t id = 0;
    std::vector<std::uint32_t> words;
  };
  /// Words are found through pages, made where a word occurs: memory does not grow with their numbers.
  static constexpr std::uint32_t kPageBits = 10;
  static constexpr std::uint32_t kNone = 0xffffffffu;

  const std::vector<Posting>* postings(std::uint32_t word) const {
    const std::uint32_t page = word >> kPageBits;
    if (page >= pages_.size() || pages_[page].empty()) return nullptr;
    const std::uint32_t list = pages_[page][word & ((1u << kPageBits) - 1)];
    return list == kNone ? nullptr : &lists_[list];
  }
  std::vector<Posting>& make_postings(std::uint32_t word);
  /// Word and weight of each image, ascending by id and word.
  std::vector<std::pair<std::uint32_t, std::vector<std::pair<std::uint32_t, double>>>> contents() const;

  BagScore score_;
  std::vector<std::vector<std::uint32_t>> pages_;
  std::vector<std::vector<Posting>> lists_;
  std::vector<Entry> entries_;
  std::vector<std::uint32_t> free_;
  std::unordered_map<std::uint32_t, std::uint32_t> slot_of_;
};

/// Joins matches that belong together, as views of one place do: each match with those matches that
/// `related` names for it makes a group, whose score is the sum of theirs and whose best is the most alike.
/// Groups of the same best are given once, that of the largest sum; groups far below the best one are left
/// out. For scores that grow with likeness, not for BagScore::kl.
/// @param related called with an id, gives a range of ids (its covisible keyframes, its neighbours in time)
/// @param min_share least score of a group, as a part of the best group's
/// Returns the groups, best first.
template <class Related>
std::vector<BagGroup> group_matches(std::span<const BagMatch> matches, Related&& related,
                                    double min_share = 0.75) {
  require(min_share >= 0 && min_share <= 1, "group_matches min_share", "must lie in [0, 1]", min_share);
  std::unordered_map<std::uint32_t, std::size_t> place;
  for (std::size_t i = 0; i < matches.size(); ++i) place.emplace(matches[i].id, i);
  std::vector<BagGroup> groups;
  std::unordered_map<std::uint32_t, std::size_t> group_of;  // by best
  std::vector<std::size_t> members;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    members.assign(1, i);
    for (const auto id : related(matches[i].id)) {
      const auto found = place.find(static_cast<std::uint32_t>(id));
      if (found != place.end()) members.push_back(found->second);
    }
    std::sort(members.begin(), members.end());
    members.erase(std::unique(members.begin(), members.end()), members.end());
    BagGroup group;
    group.best = matches[members.front()];
    for (const std::size_t m : members) {
      group.score += matches[m].score;
      if (matches[m].score > group.best.score) group.best = matches[m];
      group.members.push_back(matches[m].id);
    }
    const auto [known, fresh] = group_of.emplace(group.best.id, groups.size());
    if (fresh)
      groups.push_back(std::move(group));
    else if (group.score > groups[known->second].score)
      groups[known->second] = std::move(group);
  }
  std::stable_sort(groups.begin(), groups.end(),
                   [](const BagGroup& a, const BagGroup& b) { return a.score > b.score; });
  const double least = groups.empty() ? 0.0 : min_share * groups.front().score;
  while (!groups.empty() && groups.back().score < least) groups.pop_back();
  return groups;
}

}  // namespace sweepkit
