// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/match/code_scan.hpp"
#include "sweepkit/match/impl/substring_tables.hpp"
#include "sweepkit/match/neighbour_lists.hpp"

namespace sweepkit {

/// What a search in the tables costs, counted before it is done.
struct LookupCount {
  double buckets = 0;  ///< buckets looked up
  double codes = 0;    ///< codes expected in them, as codes of the tables themselves would find
};

/// Exact neighbours in Hamming distance by multi-index hashing (M. Norouzi, A. Punjani, D. J. Fleet, "Fast
/// search in Hamming space with multi-index hashing", CVPR 2012). Codes are cut into m substrings with a
/// table each. Two codes that differ in r = m q + a bits differ in at most q bits in one of the first a + 1
/// substrings or in at most q - 1 bits in one of the others, so few buckets hold all neighbours; what they
/// hold is compared in full.
///
/// Tables are flat arrays that are built as a whole. Codes inserted since lie in a list beside them that is
/// scanned; when it has grown to a sixteenth of the tables, tables are built anew (0.1 s for a million codes;
/// 16 times as seldom as that, so about 2 us an insertion). Ids as in CodeScan. Searches may run in several
/// threads at once, changes may not.
template <int Bits>
class MultiIndexHash {
 public:
  using Code = BinaryDescriptor<Bits>;

  /// @param substrings number of tables; 0: chosen from the number of codes each time that tables are built.
  /// @throws Error(argument) beyond Bits / 4
  explicit MultiIndexHash(int substrings = 0) : wanted_substrings_(substrings) {
    require(substrings >= 0 && substrings <= Bits / 4, "MultiIndexHash substrings",
            "must be 0 or up to a quarter of the bits", substrings);
  }

  /// Substrings a little longer than log2 of the number of codes: a bucket of codes with independent bits
  /// then holds one code or none.
  static std::size_t substrings_for(std::size_t codes) {
    const int length = std::max(14, static_cast<int>(std::bit_width(codes)) + 3);
    return static_cast<std::size_t>(std::max(1, (Bits + length / 2) / length));
  }

  std::size_t size() const { return scan_.size(); }
  bool contains(std::int32_t id) const { return scan_.contains(id); }
  Code code(std::int32_t id) const { return scan_.code(id); }
  /// The codes themselves, to be searched without the tables.
  const CodeScan<Bits>& scan() const { return scan_; }
  /// Number of substrings of the tables as they are; 0 before there are any.
  std::size_t substrings() const { return tables_.substrings(); }
  /// Codes beside the tables.
  std::size_t beside() const { return fresh_.size(); }
  /// Bytes taken, codes and tables.
  std::size_t memory() const {
    return scan_.memory() + tables_.memory() + fresh_.memory() +
           fresh_ids_.capacity() * sizeof(std::int32_t) + in_tables_.capacity() * sizeof(std::uint64_t);
  }

  /// Adds a code and returns its id.
  std::int32_t insert(const Code& code) {
    const std::int32_t id = add(code);
    if (is_due()) build();
    return id;
  }
  /// Adds codes, with tables built at most once, and returns their ids.
  std::vector<std::int32_t> insert(std::span<const Code> codes) {
    std::vector<std::int32_t> ids;
    ids.reserve(codes.size());
    scan_.reserve(size() + codes.size());
    for (const Code& code : codes) ids.push_back(add(code));
    if (is_due()) build();
    return ids;
  }
  /// @throws Error(argument) if there is no code of that id
  void remove(std::int32_t id) {
    scan_.remove(id);
    if (substrings() == 0) return;
    const auto i = static_cast<std::size_t>(id);
    if (is_in_tables(i)) {
      // Its entries stay, and are passed over, until tables are built anew.
      in_tables_[i / 64] &= ~(std::uint64_t{1} << i % 64);
      if (++gone_ > std::max<std::size_t>(kLeastFresh, tables_.codes() / 2)) build();
      return;
    }
    const auto at = std::ranges::find(fresh_ids_, id) - fresh_ids_.begin();
    fresh_.set(static_cast<std::size_t>(at), fresh_.get(fresh_.size() - 1));
    fresh_.pop_back();
    fresh_ids_[static_cast<std::size_t>(at)] = fresh_ids_.back();
    fresh_ids_.pop_back();
  }
  void clear() {
    scan_.clear();
    tables_.clear();
    fresh_.clear();
    fresh_ids_.clear();
    in_tables_.clear();
    gone_ = 0;
  }
  /// Enters all codes into the tables now.
  void build() {
    std::vector<std::uint32_t> members;
    members.reserve(size());
    in_tables_.assign((scan_.id_end() + 63) / 64, 0);
    for (std::size_t i = 0; i < scan_.id_end(); ++i)
      if (scan_.contains(static_cast<std::int32_t>(i))) {
        members.push_back(static_cast<std::uint32_t>(i));
        in_tables_[i / 64] |= std::uint64_t{1} << i % 64;
      }
    tables_.build(scan_.blocks(), members,
                  wanted_substrings_ > 0 ? static_cast<std::size_t>(wanted_substrings_)
                                         : substrings_for(members.size()));
    fresh_.clear();
    fresh_ids_.clear();
    gone_ = 0;
  }

  /// The work of finding all codes within a radius.
  LookupCount lookups(int radius) const {
    LookupCount count;
    const auto m = static_cast<int>(tables_.substrings());
    for (int j = 0; j < m && radius >= 0; ++j) {
      const int within = j <= radius % m ? radius / m : radius / m - 1;
      double choices = 1, masks = 0;
      for (int e = 0; e <= within && e <= tables_.length(static_cast<std::size_t>(j)); ++e) {
        masks += choices;
        choices *= static_cast<double>(tables_.length(static_cast<std::size_t>(j)) - e) / (e + 1);
      }
      count.buckets += masks;
      count.codes += masks * tables_.mean_bucket(static_cast<std::size_t>(j));
    }
    return count;
  }

  /// All codes at a distance of at most `radius`, nearest first. Scans where there would be more buckets to
  /// look up than there are codes.
  void within(const Code& query, int radius, std::vector<Match>& matches) const {
    if (substrings() == 0 || lookups(radius).buckets >= static_cast<double>(size()))
      return scan_.within(query, radius, matches);
    matches.clear();
    if (radius < 0) return;
    Search search(*this, query, size(), radius);
    search.scan_fresh();
    const auto m = static_cast<int>(tables_.substrings());
    for (int e = 0; e <= radius / m; ++e)
      search.look_up(e,
                     e < radius / m ? static_cast<std::size_t>(m) : static_cast<std::size_t>(radius % m) + 1);
    search.finish(matches);
  }

  /// The `count` nearest codes. Goes from radius to radius; scans the rest once that is less work.
  void nearest(const Code& query, std::size_t count, std::vector<Match>& matches) const {
    std::optional<int> bound = Bits;
    const auto worth = [&](int errors) {
      const int radius = (errors + 1) * static_cast<int>(substrings()) - 1;
      return radius >= 0 && lookups(radius).buckets * 4 <= static_cast<double>(size());
    };
    if (worth(0)) {
      int errors = 0;
      while (worth(errors + 1)) ++errors;
      bound = nearest_within(query, count, errors, matches);
      if (!bound) return;
    }
    const int bounds[] = {*bound};
    NeighbourLists lists;
    scan_.nearest(std::span(&query, 1), bounds, count, lists);
    matches = std::move(lists.matches);
  }

  /// Looks for the `count` nearest codes among those that differ from the query in at most `errors` bits in
  /// some substring. Returns nothing if they are the nearest of all and `matches` holds them; else a distance
  /// within which the nearest lie.
  std::optional<int> nearest_within(const Code& query, std::size_t count, int errors,
                                    std::vector<Match>& matches) const {
    matches.clear();
    if (count == 0 || size() == 0) return std::nullopt;
    if (substrings() == 0) return Bits;
    Search search(*this, query, count, Bits);
    const auto m = static_cast<int>(tables_.substrings());
    for (int e = 0; e <= errors; ++e) {
      search.look_up(e, static_cast<std::size_t>(m));
      if (e == 0) search.scan_fresh();
      if (search.complete() && search.bound() < (e + 1) * m) {
        search.finish(matches);
        return std::nullopt;
      }
    }
    return search.bound();
  }

 private:
  static constexpr std::size_t kLeastFresh = 2048;

  bool is_in_tables(std::size_t i) const {
    return i / 64 < in_tables_.size() && in_tables_[i / 64] >> i % 64 & 1;
  }

  std::int32_t add(const Code& code) {
    const std::int32_t id = scan_.insert(code);
    if (substrings() == 0) return id;
    fresh_.push_back(code);
    fresh_ids_.push_back(id);
    return id;
  }
  bool is_due() const {
    return substrings() == 0 ? size() > kLeastFresh
                             : fresh_.size() > std::max<std::size_t>(kLeastFresh, tables_.codes() / 16);
  }

  /// One query on its way.
  class Search {
   public:
    Search(const MultiIndexHash& hash, const Code& query, std::size_t wanted, int threshold)
        : hash_(hash), query_(query), wanted_(wanted), threshold_(threshold) {}

    /// As many codes as wanted have been found, and all that lie within bound() of what was looked up.
    bool complete() const { return hits_.size() >= wanted_; }
    int bound() const { return threshold_; }

    void scan_fresh() {
      const auto kernel = impl::scan_function<Code::kWords>(impl::scan_kernel());
      impl::CodeHit found[impl::kBlockCodes];
      for (std::size_t b = 0; b < hash_.fresh_.blocks(); ++b) {
        const impl::CodeHit* const last =
            kernel(hash_.fresh_.block(0), b, b + 1, query_.words.data(), threshold_, found);
        for (const impl::CodeHit* hit = found; hit != last; ++hit) {
          const std::uint32_t place = impl::hit_place(*hit);
          if (place >= hash_.fresh_.size()) continue;
          hits_.push_back(impl::code_hit(static_cast<std::uint64_t>(impl::hit_distance(*hit)),
                                         static_cast<std::uint32_t>(hash_.fresh_ids_[place])));
        }
        if (hits_.size() > wanted_ + kSlack) thin();
      }
      thin();
    }

    /// Looks up all values that differ from the query's in exactly `errors` bits, in the first substrings.
    void look_up(int errors, std::size_t substrings) {
      const auto& tables = hash_.tables_;
      for (std::size_t j = 0; j < substrings; ++j) {
        const int length = tables.length(j);
        if (errors > length) continue;
        const std::uint64_t value = tables.value(query_.words.data(), 1, j);
        if (errors == 0) {
          add_bucket(j, value);
          continue;
        }
        // All masks of that many bits, ascending (Gosper's way to the next one).
        std::uint64_t mask = errors == 64 ? ~std::uint64_t{0} : (std::uint64_t{1} << errors) - 1;
        const std::uint64_t last = mask << (length - errors);
        for (;;) {
          add_bucket(j, value ^ mask);
          if (mask == last) break;
          const std::uint64_t lowest = mask & (0 - mask), ripple = mask + lowest;
          mask = (((ripple ^ mask) >> 2) >> std::countr_zero(lowest)) | ripple;
        }
      }
      visit_buckets();
      check();
      thin();
    }

    void finish(std::vector<Match>& matches) {
      for (const impl::CodeHit hit : hits_)
        matches.push_back({static_cast<std::int32_t>(impl::hit_place(hit)), impl::hit_distance(hit)});
    }

   private:
    static constexpr std::size_t kBuckets = 64;  // on the way from memory at once
    static constexpr std::size_t kCandidates = 256;
    static constexpr std::size_t kSlack = 64;  // hits beyond what is wanted before they are thinned out

    struct Bucket {
      const std::uint32_t* begin;
      const std::uint32_t* places;
    };

    void add_bucket(std::size_t j, std::uint64_t value) {
      const std::uint32_t* const begin = hash_.tables_.bucket(j, value);
      __builtin_prefetch(begin);
      buckets_[bucket_count_++] = {begin, hash_.tables_.places(j)};
      if (bucket_count_ == kBuckets) visit_buckets();
    }

    void visit_buckets() {
      for (std::size_t n = 0; n < bucket_count_; ++n)
        __builtin_prefetch(buckets_[n].places + *buckets_[n].begin);
      for (std::size_t n = 0; n < bucket_count_; ++n) {
        const Bucket& bucket = buckets_[n];
        for (std::uint32_t i = bucket.begin[0]; i < bucket.begin[1]; ++i) {
          const std::uint32_t place = bucket.places[i];
          __builtin_prefetch(hash_.scan_.blocks().first_word(place));
          candidates_[candidate_count_++] = place;
          if (candidate_count_ == kCandidates) check();
        }
      }
      bucket_count_ = 0;
    }

    void check() {
      impl::CodeHit found[kCandidates];
      const impl::CodeHit* const last =
          impl::check_places<Code::kWords>(hash_.scan_.blocks().block(0), candidates_.data(),
                                           candidate_count_, query_.words.data(), threshold_, found);
      candidate_count_ = 0;
      for (const impl::CodeHit* hit = found; hit != last; ++hit)
        if (hash_.is_in_tables(impl::hit_place(*hit))) hits_.push_back(*hit);
      if (hits_.size() > wanted_ + kSlack) thin();
    }

    /// Sorts, drops what was found twice or is not wanted, and lowers the threshold.
    void thin() {
      std::ranges::sort(hits_);
      hits_.erase(std::unique(hits_.begin(), hits_.end()), hits_.end());
      if (hits_.size() < wanted_) return;
      hits_.resize(wanted_);
      threshold_ = std::min(threshold_, impl::hit_distance(hits_.back()));
    }

    const MultiIndexHash& hash_;
    const Code& query_;
    std::size_t wanted_;
    int threshold_;
    std::vector<impl::CodeHit> hits_;
    std::array<Bucket, kBuckets> buckets_;
    std::size_t bucket_count_ = 0;
    std::array<std::uint32_t, kCandidates> candidates_;
    std::size_t candidate_count_ = 0;
  };

  int wanted_substrings_;
  CodeScan<Bits> scan_;
  impl::SubstringTables<Bits> tables_;
  std::vector<std::uint64_t> in_tables_;  // a bit for each id: whether its entries are valid
  impl::CodeBlocks<Bits> fresh_;          // what is not in the tables
  std::vector<std::int32_t> fresh_ids_;
  std::size_t gone_ = 0;  // entries that are not valid any more
};

}  // namespace sweepkit
