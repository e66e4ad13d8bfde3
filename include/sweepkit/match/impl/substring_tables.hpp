// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sweepkit/core/simd.hpp"
#include "sweepkit/match/impl/code_blocks.hpp"

namespace sweepkit::impl {

/// Appends those of the codes at the given places that lie within `threshold` of the query.
template <std::size_t kWords>
CodeHit* check_places_portable(const std::uint64_t* blocks, const std::uint32_t* places, std::size_t count,
                               const std::uint64_t* query, int threshold, CodeHit* hits) {
  for (std::size_t n = 0; n < count; ++n) {
    const std::size_t i = places[n];
    const std::uint64_t* words = blocks + i / kBlockCodes * (kBlockCodes * kWords) + i % kBlockCodes;
    int distance = 0;
    for (std::size_t w = 0; w < kWords && distance <= threshold; ++w)
      distance +=
          hamming_distance(BinaryDescriptor<64>{{query[w]}}, BinaryDescriptor<64>{{words[w * kBlockCodes]}});
    if (distance <= threshold) *hits++ = code_hit(static_cast<std::uint64_t>(distance), i);
  }
  return hits;
}

#ifdef SWEEPKIT_HAVE_AVX2
template <std::size_t kWords>
SWEEPKIT_TARGET_AVX2 CodeHit* check_places_avx2(const std::uint64_t* blocks, const std::uint32_t* places,
                                                std::size_t count, const std::uint64_t* query, int threshold,
                                                CodeHit* hits) {
  for (std::size_t n = 0; n < count; ++n) {
    const std::size_t i = places[n];
    const std::uint64_t* words = blocks + i / kBlockCodes * (kBlockCodes * kWords) + i % kBlockCodes;
    long long distance = 0;
    for (std::size_t w = 0; w < kWords && distance <= threshold; ++w)
      distance += _mm_popcnt_u64(query[w] ^ words[w * kBlockCodes]);
    if (distance <= threshold) *hits++ = code_hit(static_cast<std::uint64_t>(distance), i);
  }
  return hits;
}
#endif

template <std::size_t kWords>
CodeHit* check_places(const std::uint64_t* blocks, const std::uint32_t* places, std::size_t count,
                      const std::uint64_t* query, int threshold, CodeHit* hits) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2)
    return check_places_avx2<kWords>(blocks, places, count, query, threshold, hits);
#endif
  return check_places_portable<kWords>(blocks, places, count, query, threshold, hits);
}

/// Codes cut into substrings, and for each substring a table from its value to the codes that have it.
/// Buckets are runs of one array; values are hashed to buckets, so that substrings may be as long as pays.
/// All codes are entered at once.
template <int Bits>
class SubstringTables {
 public:
  static constexpr std::size_t kWords = Bits / 64;

  std::size_t substrings() const { return table_bits_ < 0 ? 0 : lows_.size() - 1; }
  std::size_t codes() const { return codes_; }
  /// Bits of substring j.
  int length(std::size_t j) const { return lows_[j + 1] - lows_[j]; }
  /// Mean length of the bucket in which a code of the table lies.
  double mean_bucket(std::size_t j) const { return mean_bucket_[j]; }
  std::size_t memory() const {
    return (begins_.capacity() + places_.capacity()) * sizeof(std::uint32_t) +
           lows_.capacity() * sizeof(int) + mean_bucket_.capacity() * sizeof(double);
  }

  /// The value of substring j.
  std::uint64_t value(const std::uint64_t* words, std::size_t stride, std::size_t j) const {
    const int low = lows_[j], length = this->length(j);
    const std::uint64_t* word = words + static_cast<std::size_t>(low / 64) * stride;
    std::uint64_t bits = *word >> low % 64;
    if (low % 64 + length > 64) bits |= word[stride] << (64 - low % 64);
    return length == 64 ? bits : bits & ((std::uint64_t{1} << length) - 1);
  }

  /// Where the bucket's begin is written, its end beside it.
  const std::uint32_t* bucket(std::size_t j, std::uint64_t value) const {
    return begins_.data() + (j << table_bits_) + j + (value * kHash >> (64 - table_bits_));
  }
  /// The places of table j.
  const std::uint32_t* places(std::size_t j) const { return places_.data() + j * codes_; }

  void clear() { *this = {}; }

  /// Enters the codes at `members`, ascending places.
  void build(const CodeBlocks<Bits>& blocks, const std::vector<std::uint32_t>& members,
             std::size_t substrings) {
    codes_ = members.size();
    lows_.resize(substrings + 1);
    for (std::size_t j = 0; j <= substrings; ++j) lows_[j] = static_cast<int>(Bits * j / substrings);
    table_bits_ = std::max(1, static_cast<int>(std::bit_width(codes_)) - 1);
    const std::size_t buckets = std::size_t{1} << table_bits_;
    begins_.assign((buckets + 1) * substrings, 0);
    places_.resize(codes_ * substrings);
    mean_bucket_.assign(substrings, 0);
    std::vector<std::uint32_t> bucket_of(codes_);
    for (std::size_t j = 0; j < substrings; ++j) {
      // Counting sort by bucket: begins[b + 1] counts, then is where bucket b goes on, in the end its end.
      std::uint32_t* const begins = begins_.data() + j * (buckets + 1);
      std::uint32_t* const places = places_.data() + j * codes_;
      for (std::size_t n = 0; n < codes_; ++n) {
        bucket_of[n] = static_cast<std::uint32_t>(
            value(blocks.first_word(members[n]), kBlockCodes, j) * kHash >> (64 - table_bits_));
        ++begins[bucket_of[n] + 1];
      }
      double squares = 0;
      for (std::uint32_t b = 0, begin = 0; b < buckets; ++b) {
        const std::uint32_t count = begins[b + 1];
        squares += static_cast<double>(count) * count;
        begins[b + 1] = begin;
        begin += count;
      }
      for (std::size_t n = 0; n < codes_; ++n) places[begins[bucket_of[n] + 1]++] = members[n];
      mean_bucket_[j] = codes_ == 0 ? 0 : squares / static_cast<double>(codes_);
    }
  }

 private:
  static constexpr std::uint64_t kHash = 0x9e3779b97f4a7c15u;  // 2^64 / golden ratio (Knuth)

  std::size_t codes_ = 0;
  int table_bits_ = -1;
  std::vector<int> lows_;              // first bit of each substring, and the end of the last
  std::vector<std::uint32_t> begins_;  // of each table: begin of each bucket, and the end of the last
  std::vector<std::uint32_t> places_;
  std::vector<double> mean_bucket_;
};

}  // namespace sweepkit::impl
