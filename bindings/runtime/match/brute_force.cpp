// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/match/brute_force.hpp"

#include <algorithm>
#include <limits>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/simd.hpp"
#include "sweepkit/match/impl/code_blocks.hpp"

namespace sweepkit {

namespace {

#ifdef SWEEPKIT_HAVE_AVX2
using impl::load_32;
using impl::store_32;
#endif

// A distance (at most 256) and an index in one number, ordered by distance, then index.
constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();
constexpr std::uint32_t key(std::uint32_t distance, std::uint32_t index) { return distance << 16 | index; }

/// The two nearest of b to one descriptor of a.
struct Nearest {
  std::uint32_t best = kNone, second = kNone;

  void add(std::uint32_t k) {
    second = std::min(second, std::max(best, k));
    best = std::min(best, k);
  }
};

// Blocks of eight descriptors: of each word first that of the even ones, then that of the odd ones, so that a
// vector of even distances and one of odd ones interleave to the natural order.
constexpr std::size_t kBlock = 8;
constexpr std::size_t kBlockWords = kBlock * OrbDescriptor::kWords;
constexpr std::size_t place(std::size_t j) {
  return j / kBlock * kBlockWords + j % 2 * (kBlock / 2) + j % kBlock / 2;
}

/// Adds the blocked descriptors [first, count) to the nearest of a; keeps nearest_to_b up to date.
void find_nearest_portable(const OrbDescriptor& a, std::uint32_t a_index, const std::uint64_t* blocks,
                           std::size_t first, std::size_t count, std::uint32_t* nearest_to_b,
                           Nearest& nearest) {
  for (std::size_t j = first; j < count; ++j) {
    const std::uint64_t* words = blocks + place(j);
    std::uint32_t distance = 0;
    for (std::size_t w = 0; w < OrbDescriptor::kWords; ++w)
      distance += static_cast<std::uint32_t>(std::popcount(a.words[w] ^ words[w * kBlock]));
    nearest.add(key(distance, static_cast<std::uint32_t>(j)));
    nearest_to_b[j] = std::min(nearest_to_b[j], key(distance, a_index));
  }
}

#ifdef SWEEPKIT_HAVE_AVX2
SWEEPKIT_TARGET_AVX2 void find_nearest_avx2(const OrbDescriptor& a, std::uint32_t a_index,
                                            const std::uint64_t* blocks, std::size_t first, std::size_t count,
                                            std::uint32_t* nearest_to_b, Nearest& nearest) {
  __m256i word[OrbDescriptor::kWords];
  for (std::size_t w = 0; w < OrbDescriptor::kWords; ++w)
    word[w] = _mm256_set1_epi64x(static_cast<long long>(a.words[w]));
  const __m256i zero = _mm256_setzero_si256();
  const __m256i a_keys = _mm256_set1_epi32(static_cast<int>(a_index));
  const __m256i step = _mm256_set1_epi32(kBlock);
  __m256i index = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
  __m256i best = _mm256_set1_epi32(-1), second = best;
  const std::size_t whole = count / kBlock * kBlock;
  for (std::size_t j = first; j < whole; j += kBlock) {
    __m256i even = zero, odd = zero;
    for (std::size_t w = 0; w < OrbDescriptor::kWords; ++w) {
      const auto* row = reinterpret_cast<const __m256i*>(blocks + place(j) + w * kBlock);
      even = _mm256_add_epi8(even,
                             impl::count_bits_of_bytes(_mm256_xor_si256(word[w], _mm256_loadu_si256(row))));
      odd = _mm256_add_epi8(
          odd, impl::count_bits_of_bytes(_mm256_xor_si256(word[w], _mm256_loadu_si256(row + 1))));
    }
    even = _mm256_sad_epu8(even, zero);
    odd = _mm256_sad_epu8(odd, zero);
    const __m256i distance = _mm256_or_si256(_mm256_slli_epi64(even, 16), _mm256_slli_epi64(odd, 48));
    const __m256i k = _mm256_or_si256(distance, index);
    index = _mm256_add_epi32(index, step);
    second = _mm256_min_epu32(second, _mm256_max_epu32(best, k));
    best = _mm256_min_epu32(best, k);
    auto* to_b = reinterpret_cast<__m256i*>(nearest_to_b + j);
    _mm256_storeu_si256(to_b, _mm256_min_epu32(_mm256_loadu_si256(to_b), _mm256_or_si256(distance, a_keys)));
  }
  alignas(32) std::uint32_t bests[kBlock], seconds[kBlock];
  _mm256_store_si256(reinterpret_cast<__m256i*>(bests), best);
  _mm256_store_si256(reinterpret_cast<__m256i*>(seconds), second);
  for (std::size_t i = 0; i < kBlock; ++i) {
    nearest.add(bests[i]);
    nearest.add(seconds[i]);
  }
  find_nearest_portable(a, a_index, blocks, whole, count, nearest_to_b, nearest);
}

SWEEPKIT_TARGET_AVX512_POPCOUNT void find_nearest_avx512(const OrbDescriptor& a, std::uint32_t a_index,
                                                         const std::uint64_t* blocks, std::size_t first,
                                                         std::size_t count, std::uint32_t* nearest_to_b,
                                                         Nearest& nearest) {
  const __m256i natural = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
  const __m256i a_keys = _mm256_set1_epi32(static_cast<int>(a_index));
  const __m256i step = _mm256_set1_epi32(kBlock);
  __m256i index = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
  __m256i best = _mm256_set1_epi32(-1), second = best;
  const std::size_t whole = count / kBlock * kBlock;
  for (std::size_t j = first; j < whole; j += kBlock) {
    __m512i sum = _mm512_setzero_si512();
    for (std::size_t w = 0; w < OrbDescriptor::kWords; ++w)
      sum = _mm512_add_epi64(
          sum, _mm512_popcnt_epi64(_mm512_xor_si512(_mm512_set1_epi64(static_cast<long long>(a.words[w])),
                                                    _mm512_loadu_si512(blocks + place(j) + w * kBlock))));
    // The form with a mask of all lanes: gcc 12 warns of its own header at the plain one.
    const __m256i counts = _mm512_maskz_cvtepi64_epi32(0xff, sum);
    const __m256i distance = _mm256_slli_epi32(_mm256_permutevar8x32_epi32(counts, natural), 16);
    const __m256i k = _mm256_or_si256(distance, index);
    index = _mm256_add_epi32(index, step);
    second = _mm256_min_epu32(second, _mm256_max_epu32(best, k));
    best = _mm256_min_epu32(best, k);
    store_32(nearest_to_b + j,
             _mm256_min_epu32(load_32(nearest_to_b + j), _mm256_or_si256(distance, a_keys)));
  }
  alignas(32) std::uint32_t bests[kBlock], seconds[kBlock];
  store_32(bests, best);
  store_32(seconds, second);
  for (std::size_t i = 0; i < kBlock; ++i) {
    nearest.add(bests[i]);
    nearest.add(seconds[i]);
  }
  find_nearest_portable(a, a_index, blocks, whole, count, nearest_to_b, nearest);
}
#endif

/// The kernel for this machine; all find the same.
auto find_nearest_function() {
#ifdef SWEEPKIT_HAVE_AVX2
  if (impl::scan_kernel() == impl::ScanKernel::avx512) return find_nearest_avx512;
  if (impl::scan_kernel() == impl::ScanKernel::avx2) return find_nearest_avx2;
#endif
  return find_nearest_portable;
}

}  // namespace

int BruteForceMatcher::match(std::span<const OrbDescriptor> a, std::span<const OrbDescriptor> b,
                             std::vector<Match>& matches) {
  require(a.size() <= 65535, "BruteForceMatcher::match a", "at most 65535 descriptors", a.size());
  require(b.size() <= 65535, "BruteForceMatcher::match b", "at most 65535 descriptors", b.size());
  const auto find_nearest = find_nearest_function();
  blocks_.resize((b.size() + kBlock - 1) / kBlock * kBlockWords);
  for (std::size_t j = 0; j < b.size(); ++j)
    for (std::size_t w = 0; w < OrbDescriptor::kWords; ++w) blocks_[place(j) + w * kBlock] = b[j].words[w];
  nearest_to_b_.assign(b.size(), kNone);
  matches.assign(a.size(), {});
  if (b.empty()) return 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    Nearest nearest;
    find_nearest(a[i], static_cast<std::uint32_t>(i), blocks_.data(), 0, b.size(), nearest_to_b_.data(),
                 nearest);
    const auto distance = static_cast<std::int32_t>(nearest.best >> 16);
    if (distance > options_.max_distance) continue;
    if (options_.ratio < 1 && nearest.second != kNone && distance > options_.ratio * (nearest.second >> 16))
      continue;
    matches[i] = {static_cast<std::int32_t>(nearest.best & 0xffff), distance};
  }
  int count = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    if (!matches[i].found()) continue;
    if (options_.mutual && (nearest_to_b_[matches[i].index] & 0xffff) != i)
      matches[i] = {};
    else
      ++count;
  }
  return count;
}

int BruteForceMatcher::match(const Features<256>& a, const Features<256>& b, std::vector<Match>& matches) {
  require(a.keypoints.size() == a.descriptors.size(), "BruteForceMatcher::match a",
          "must have as many descriptors as key points", a.descriptors.size());
  require(b.keypoints.size() == b.descriptors.size(), "BruteForceMatcher::match b",
          "must have as many descriptors as key points", b.descriptors.size());
  int count = match(a.descriptors, b.descriptors, matches);
  if (!options_.check_orientation || count == 0) return count;
  orientation_.clear();
  for (std::size_t i = 0; i < a.size(); ++i)
    if (matches[i].found()) orientation_.add(a.keypoints[i].angle, b.keypoints[matches[i].index].angle);
  orientation_.finish();
  std::size_t k = 0;
  for (Match& match : matches)
    if (match.found() && !orientation_.agrees(k++)) {
      match = {};
      --count;
    }
  return count;
}

}  // namespace sweepkit
