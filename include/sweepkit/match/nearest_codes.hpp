// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/parallel.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/match/multi_index_hash.hpp"
#include "sweepkit/match/neighbour_lists.hpp"

namespace sweepkit {

/// How NearestCodes searches.
enum class CodeSearch {
  automatic,    ///< whichever is less work
  scan,         ///< look at every code
  multi_index,  ///< by tables of substrings
};

struct NearestCodesOptions {
  CodeSearch search = CodeSearch::automatic;
  int substrings = 0;
  int threads = 1;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v.choice(search, "search",
             {{CodeSearch::automatic, "automatic"},
              {CodeSearch::scan, "scan"},
              {CodeSearch::multi_index, "multi_index"}},
             "how to search; the result is the same");
    v(substrings, "substrings", "", range(0, 64), "tables of substrings; 0: by the number of codes");
    v(threads, "threads", "", range(0, 1024), "threads that share a batch of queries; 0: all there are");
  }
};

namespace impl {

/// What searches cost, measured [ns]; wrong figures cost time, never exactness.
struct CodeSearchCost {
  static constexpr double kBucket = 5, kCandidate = 3.5, kStart = 150;

  /// A scan of one code up to that distance, with the vectors that this machine has.
  static double scanned_code(int distance, std::size_t words) {
    const auto read = static_cast<double>(words_before_test(distance, words));
    switch (scan_kernel()) {
      case ScanKernel::avx512:
        return 0.015 + 0.045 * read;
      case ScanKernel::avx2:
        return 0.05 + 0.15 * read;
      case ScanKernel::portable:
        break;
    }
    return 0.5 + 1.5 * read;
  }
};

}  // namespace impl

/// Exact neighbours in Hamming distance among many codes: chooses between CodeScan and MultiIndexHash by the
/// number of codes and the radius, and, for nearest codes, by how near those of the first queries of a batch
/// lie. All ways give the same lists. Ids as in CodeScan. Searches may run in several threads at once,
/// changes may not.
template <int Bits = 256>
class NearestCodes {
 public:
  using Code = BinaryDescriptor<Bits>;

  explicit NearestCodes(const NearestCodesOptions& options = {})
      : options_(checked(options)), hash_(options.substrings) {}
  const NearestCodesOptions& options() const { return options_; }

  std::size_t size() const { return uses_tables() ? hash_.size() : scan_only_.size(); }
  bool contains(std::int32_t id) const { return scan().contains(id); }
  /// @throws Error(argument) if there is no code of that id
  Code code(std::int32_t id) const { return scan().code(id); }
  /// Bytes taken.
  std::size_t memory() const { return uses_tables() ? hash_.memory() : scan_only_.memory(); }

  /// Adds a code and returns its id: the lowest that was never used, or that of the code removed last.
  std::int32_t insert(const Code& code) {
    return uses_tables() ? hash_.insert(code) : scan_only_.insert(code);
  }
  std::vector<std::int32_t> insert(std::span<const Code> codes) {
    if (uses_tables()) return hash_.insert(codes);
    std::vector<std::int32_t> ids;
    scan_only_.reserve(size() + codes.size());
    for (const Code& code : codes) ids.push_back(scan_only_.insert(code));
    return ids;
  }
  /// @throws Error(argument) if there is no code of that id
  void remove(std::int32_t id) { uses_tables() ? hash_.remove(id) : scan_only_.remove(id); }
  void clear() {
    hash_.clear();
    scan_only_.clear();
  }

  /// All codes at a distance of at most `radius`, nearest first, of equally near ones the lowest id first.
  void within(const Code& query, int radius, std::vector<Match>& matches) const {
    if (tables_pay(radius, 1))
      hash_.within(query, radius, matches);
    else
      scan().within(query, radius, matches);
  }
  std::vector<Match> within(const Code& query, int radius) const {
    std::vector<Match> matches;
    within(query, radius, matches);
    return matches;
  }
  /// The same for many queries, which is faster for each. Replaces what `lists` held.
  void within(std::span<const Code> queries, int radius, NeighbourLists& lists) const {
    if (!tables_pay(radius, queries.size())) return scan().within(queries, radius, lists, options_.threads);
    in_parts(queries, lists, [&](std::span<const Code> part, NeighbourLists& result) {
      std::vector<Match> matches;
      for (const Code& query : part) {
        hash_.within(query, radius, matches);
        result.matches.insert(result.matches.end(), matches.begin(), matches.end());
        result.finish_list();
      }
    });
  }

  /// The `count` nearest codes, or all if there are fewer.
  void nearest(const Code& query, std::size_t count, std::vector<Match>& matches) const {
    NeighbourLists lists;
    nearest(std::span(&query, 1), count, lists);
    matches = std::move(lists.matches);
  }
  std::vector<Match> nearest(const Code& query, std::size_t count = 1) const {
    std::vector<Match> matches;
    nearest(query, count, matches);
    return matches;
  }
  void nearest(std::span<const Code> queries, std::size_t count, NeighbourLists& lists) const {
    if (!uses_tables() || hash_.substrings() == 0)
      return scan().nearest(queries, count, lists, options_.threads);
    in_parts(queries, lists, [&](std::span<const Code> part, NeighbourLists& result) {
      nearest_of_part(part, count, result);
    });
  }

 private:
  static const NearestCodesOptions& checked(const NearestCodesOptions& options) {
    check_options(options);
    return options;
  }
  bool uses_tables() const { return options_.search != CodeSearch::scan; }
  const CodeScan<Bits>& scan() const { return uses_tables() ? hash_.scan() : scan_only_; }

  double scan_cost(int distance, std::size_t queries) const {
    double cost = impl::CodeSearchCost::scanned_code(distance, Code::kWords);
    // A single query reads codes from memory that a batch finds in the cache.
    if (queries < 4 && size() * sizeof(Code) > (1u << 20))
      cost += 0.2 * static_cast<double>(impl::words_before_test(distance, Code::kWords));
    return cost * static_cast<double>(size());
  }
  double table_cost(int radius) const {
    const LookupCount count = hash_.lookups(radius);
    return impl::CodeSearchCost::kStart + count.buckets * impl::CodeSearchCost::kBucket +
           count.codes * impl::CodeSearchCost::kCandidate +
           static_cast<double>(hash_.beside()) * impl::CodeSearchCost::scanned_code(radius, Code::kWords);
  }
  bool tables_pay(int radius, std::size_t queries) const {
    if (!uses_tables() || hash_.substrings() == 0 || radius < 0) return false;
    return options_.search == CodeSearch::multi_index || table_cost(radius) < scan_cost(radius, queries);
  }

  template <class Body>
  void in_parts(std::span<const Code> queries, NeighbourLists& lists, Body&& body) const {
    const std::size_t parts = std::max<std::size_t>(
        1, std::min(static_cast<std::size_t>(thread_count(options_.threads)), queries.size()));
    std::vector<NeighbourLists> of_part(parts);
    parallel_blocks(queries.size(), options_.threads,
                    [&](std::size_t begin, std::size_t end, std::size_t part) {
                      body(queries.subspan(begin, end - begin), of_part[part]);
                    });
    lists.clear();
    for (const NeighbourLists& part : of_part) lists.append(part);
  }

  /// Tables first, for as long as they pay, then a scan of what they could not settle.
  void nearest_of_part(std::span<const Code> queries, std::size_t count, NeighbourLists& result) const {
    std::vector<std::vector<Match>> found(queries.size());
    std::vector<Code> open;
    std::vector<std::size_t> open_index;
    std::vector<int> bounds;
    const double all = scan_cost(60, queries.size());
    Trial trial[2];
    for (int e = 0; e < 2; ++e) {
      const int radius = (e + 1) * static_cast<int>(hash_.substrings()) - 1;
      trial[e].price = table_cost(radius) / all;
    }
    for (std::size_t i = 0; i < queries.size(); ++i) {
      if (options_.search == CodeSearch::multi_index) {
        hash_.nearest(queries[i], count, found[i]);
        continue;
      }
      std::optional<int> bound = Bits;
      for (int e = 0; e < 2 && bound && trial[e].pays(queries.size()); ++e) {
        bound = hash_.nearest_within(queries[i], count, e, found[i]);
        trial[e].add(!bound);
      }
      if (!bound) continue;
      open.push_back(queries[i]);
      open_index.push_back(i);
      bounds.push_back(*bound);
    }
    NeighbourLists scanned;
    scan().nearest(open, bounds, count, scanned);
    for (std::size_t n = 0; n < open.size(); ++n)
      found[open_index[n]].assign(scanned[n].begin(), scanned[n].end());
    for (const auto& list : found) {
      result.matches.insert(result.matches.end(), list.begin(), list.end());
      result.finish_list();
    }
  }

  /// Whether a way that settles some queries and not others is worth trying on the next one.
  struct Trial {
    double price = 0;  // of a try, in scans
    std::size_t tried = 0, settled = 0;

    bool pays(std::size_t queries) const {
      // Tries that cannot be learned from have to be next to free.
      if (price < 0.03) return true;
      if (price > 0.5 || queries < 32) return false;
      if (tried < 4 + queries / 64) return true;
      return static_cast<double>(settled) > 1.5 * price * static_cast<double>(tried);
    }
    void add(bool success) {
      ++tried;
      settled += success;
    }
  };

  NearestCodesOptions options_;
  MultiIndexHash<Bits> hash_;
  CodeScan<Bits> scan_only_;
};

}  // namespace sweepkit
