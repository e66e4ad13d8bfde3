// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/parallel.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/match/impl/code_blocks.hpp"
#include "sweepkit/match/neighbour_lists.hpp"

namespace sweepkit {

namespace impl {

/// The best hits of one query so far.
class BestHits {
 public:
  BestHits(std::size_t wanted, int threshold) : wanted_(wanted), threshold_(threshold) {}

  /// Codes farther than this cannot be among the wanted ones any more.
  int threshold() const { return threshold_; }

  /// Hits have to come in ascending order of place: of equally near ones the first stays.
  void add(CodeHit hit) {
    if (hits_.size() < wanted_) {
      hits_.push_back(hit);
      std::ranges::push_heap(hits_);
      if (hits_.size() == wanted_) threshold_ = hit_distance(hits_.front()) - 1;
      return;
    }
    if (hit >= hits_.front()) return;
    std::ranges::pop_heap(hits_);
    hits_.back() = hit;
    std::ranges::push_heap(hits_);
    threshold_ = hit_distance(hits_.front()) - 1;
  }

  void finish(std::vector<Match>& matches) {
    std::ranges::sort(hits_);
    for (const CodeHit hit : hits_)
      matches.push_back({static_cast<std::int32_t>(hit_place(hit)), hit_distance(hit)});
  }

 private:
  std::size_t wanted_;
  int threshold_;
  std::vector<CodeHit> hits_;
};

/// Everything within a radius.
class HitsWithin {
 public:
  explicit HitsWithin(int radius) : radius_(radius) {}

  int threshold() const { return radius_; }
  void add(CodeHit hit) { hits_.push_back(hit); }
  void finish(std::vector<Match>& matches) {
    std::ranges::sort(hits_);
    for (const CodeHit hit : hits_)
      matches.push_back({static_cast<std::int32_t>(hit_place(hit)), hit_distance(hit)});
  }

 private:
  int radius_;
  std::vector<CodeHit> hits_;
};

}  // namespace impl

/// Exact neighbours in Hamming distance by looking at every code, in vectors, with blocks of codes kept in
/// the cache while all queries of a batch pass. Portable and vector paths give the same lists. 32 bytes a
/// code of 256 bits, and one bit.
///
/// Each code has an id, counted from 0; the id of a removed code is given to the next one that is inserted,
/// the last removed first. Searches may run in several threads at once, changes may not.
template <int Bits>
class CodeScan {
 public:
  using Code = BinaryDescriptor<Bits>;

  /// Number of codes.
  std::size_t size() const { return codes_.size() - free_.size(); }
  /// All ids lie below this.
  std::size_t id_end() const { return codes_.size(); }
  bool contains(std::int32_t id) const {
    return id >= 0 && static_cast<std::size_t>(id) < codes_.size() && is_valid(static_cast<std::size_t>(id));
  }
  /// @throws Error(argument) if there is no code of that id
  Code code(std::int32_t id) const {
    require(contains(id), "CodeScan::code id", "there is no such code", id);
    return codes_.get(static_cast<std::size_t>(id));
  }
  /// Bytes taken.
  std::size_t memory() const {
    return codes_.memory() + valid_.capacity() * sizeof(std::uint64_t) +
           free_.capacity() * sizeof(std::int32_t);
  }
  void reserve(std::size_t n) { codes_.reserve(n); }

  /// Adds a code and returns its id. @throws Error(argument) beyond 2^31 - 1 codes
  std::int32_t insert(const Code& code) {
    std::int32_t id;
    if (free_.empty()) {
      require(codes_.size() < static_cast<std::size_t>(std::numeric_limits<std::int32_t>::max()),
              "CodeScan::insert", "too many codes", codes_.size());
      id = static_cast<std::int32_t>(codes_.size());
      codes_.push_back(code);
      if (valid_.size() < codes_.blocks()) valid_.push_back(0);
    } else {
      id = free_.back();
      free_.pop_back();
      codes_.set(static_cast<std::size_t>(id), code);
    }
    valid_[static_cast<std::size_t>(id) / 64] |= std::uint64_t{1} << id % 64;
    return id;
  }

  /// @throws Error(argument) if there is no code of that id
  void remove(std::int32_t id) {
    require(contains(id), "CodeScan::remove id", "there is no such code", id);
    valid_[static_cast<std::size_t>(id) / 64] &= ~(std::uint64_t{1} << id % 64);
    free_.push_back(id);
  }

  void clear() {
    codes_.clear();
    valid_.clear();
    free_.clear();
  }

  /// For each query all codes at a distance of at most `radius`. Replaces what `lists` held.
  /// @param threads 0: as many as the machine has; the result does not depend on it
  void within(std::span<const Code> queries, int radius, NeighbourLists& lists, int threads = 1) const {
    search(queries, threads, lists, [&](std::size_t) { return impl::HitsWithin(radius); });
  }
  /// The same for one query: its list replaces what `matches` held.
  void within(const Code& query, int radius, std::vector<Match>& matches) const {
    matches.clear();
    impl::HitsWithin hits(radius);
    scan(std::span(&query, 1), std::span(&hits, 1));
    hits.finish(matches);
  }

  /// For each query its `count` nearest codes, or all if there are fewer. Replaces what `lists` held.
  void nearest(std::span<const Code> queries, std::size_t count, NeighbourLists& lists,
               int threads = 1) const {
    search(queries, threads, lists, [&](std::size_t) { return impl::BestHits(count, most(count)); });
  }
  /// The same where something is known: no wanted code of query i lies beyond bounds[i].
  void nearest(std::span<const Code> queries, std::span<const int> bounds, std::size_t count,
               NeighbourLists& lists, int threads = 1) const {
    require(bounds.size() == queries.size(), "CodeScan::nearest bounds", "one for each query", bounds.size());
    search(queries, threads, lists,
           [&](std::size_t i) { return impl::BestHits(count, std::min(bounds[i], most(count))); });
  }
  void nearest(const Code& query, std::size_t count, std::vector<Match>& matches) const {
    matches.clear();
    impl::BestHits hits(count, most(count));
    scan(std::span(&query, 1), std::span(&hits, 1));
    hits.finish(matches);
  }

  /// Where the codes lie, for indices over them.
  const impl::CodeBlocks<Bits>& blocks() const { return codes_; }

 private:
  bool is_valid(std::size_t i) const { return valid_[i / 64] >> i % 64 & 1; }
  static int most(std::size_t count) { return count == 0 ? -1 : Bits; }

  template <class MakeHits>
  void search(std::span<const Code> queries, int threads, NeighbourLists& lists, MakeHits&& make_hits) const {
    lists.clear();
    const std::size_t parts =
        std::max<std::size_t>(1, std::min(static_cast<std::size_t>(thread_count(threads)), queries.size()));
    std::vector<NeighbourLists> of_part(parts);
    parallel_blocks(queries.size(), threads, [&](std::size_t begin, std::size_t end, std::size_t part) {
      using Hits = decltype(make_hits(begin));
      std::vector<Hits> hits;
      for (; begin < end; begin += kBatch) {
        const std::size_t count = std::min(kBatch, end - begin);
        hits.clear();
        for (std::size_t i = 0; i < count; ++i) hits.push_back(make_hits(begin + i));
        scan(queries.subspan(begin, count), std::span<Hits>(hits));
        for (Hits& h : hits) {
          h.finish(of_part[part].matches);
          of_part[part].finish_list();
        }
      }
    });
    if (parts == 1)
      lists = std::move(of_part[0]);
    else
      for (const NeighbourLists& part : of_part) lists.append(part);
  }

  /// Shows each query all codes, tile by tile. The first tiles are short: after them thresholds are near
  /// their final values.
  template <class Hits>
  void scan(std::span<const Code> queries, std::span<Hits> hits) const {
    const auto kernel = impl::scan_function<Code::kWords>(impl::scan_kernel());
    impl::CodeHit found[kTile * impl::kBlockCodes];
    std::size_t length = 1;
    for (std::size_t b = 0, end; b < codes_.blocks(); b = end) {
      end = std::min(codes_.blocks(), b + length);
      length = std::min(kTile, 2 * length);
      for (std::size_t i = 0; i < queries.size(); ++i) {
        const int threshold = hits[i].threshold();
        if (threshold < 0) continue;
        const impl::CodeHit* const last =
            kernel(codes_.block(0), b, end, queries[i].words.data(), threshold, found);
        for (const impl::CodeHit* hit = found; hit != last; ++hit)
          if (is_valid(impl::hit_place(*hit))) hits[i].add(*hit);
      }
    }
  }

  static constexpr std::size_t kBatch = 64;  // queries that share a tile
  static constexpr std::size_t kTile = 16;   // blocks: 32 KiB of 256-bit codes

  impl::CodeBlocks<Bits> codes_;
  std::vector<std::uint64_t> valid_;  // a bit for each id
  std::vector<std::int32_t> free_;
};

}  // namespace sweepkit
