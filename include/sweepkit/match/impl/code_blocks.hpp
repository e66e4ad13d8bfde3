// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <atomic>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <new>
#include <string_view>
#include <vector>

#include "sweepkit/core/simd.hpp"
#include "sweepkit/feature/descriptor.hpp"

#ifdef SWEEPKIT_HAVE_AVX2
/// Put before a function that uses 512-bit vectors with a population count.
#define SWEEPKIT_TARGET_AVX512_POPCOUNT \
  __attribute__((target("avx512f,avx512vl,avx512bw,avx512vpopcntdq,avx2,bmi,popcnt")))
#endif

namespace sweepkit::impl {

constexpr std::size_t kBlockCodes = 64;

/// Memory for vectors of 64 bytes, at addresses that are multiples of 64.
template <class T>
struct CacheLineAllocator {
  using value_type = T;
  CacheLineAllocator() = default;
  template <class Other>
  CacheLineAllocator(const CacheLineAllocator<Other>&) {}  // NOLINT(google-explicit-constructor)
  T* allocate(std::size_t n) {
    return static_cast<T*>(::operator new(n * sizeof(T), std::align_val_t(kBlockCodes)));
  }
  void deallocate(T* p, std::size_t) { ::operator delete(p, std::align_val_t(kBlockCodes)); }
  friend bool operator==(const CacheLineAllocator&, const CacheLineAllocator&) { return true; }
};

/// Codes in blocks of 64: of a block first the first words of all its codes, then the second words, and so
/// on. A scan reads as few words as it needs; one code touches a cache line for each of its words that is
/// read.
template <int Bits>
class CodeBlocks {
 public:
  using Code = BinaryDescriptor<Bits>;
  static constexpr std::size_t kWords = Code::kWords;
  static constexpr std::size_t kBlockWords = kBlockCodes * kWords;

  std::size_t size() const { return size_; }
  std::size_t blocks() const { return (size_ + kBlockCodes - 1) / kBlockCodes; }
  const std::uint64_t* block(std::size_t b) const { return words_.data() + b * kBlockWords; }
  /// The first word of a code; the next ones follow at distances of kBlockCodes.
  const std::uint64_t* first_word(std::size_t i) const {
    return words_.data() + i / kBlockCodes * kBlockWords + i % kBlockCodes;
  }

  Code get(std::size_t i) const {
    Code code;
    const std::uint64_t* word = first_word(i);
    for (std::size_t w = 0; w < kWords; ++w) code.words[w] = word[w * kBlockCodes];
    return code;
  }
  void set(std::size_t i, const Code& code) {
    std::uint64_t* word = words_.data() + i / kBlockCodes * kBlockWords + i % kBlockCodes;
    for (std::size_t w = 0; w < kWords; ++w) word[w * kBlockCodes] = code.words[w];
  }
  void push_back(const Code& code) {
    if (size_ % kBlockCodes == 0) words_.resize(words_.size() + kBlockWords);
    set(size_++, code);
  }
  void pop_back() {
    if (--size_ % kBlockCodes == 0) words_.resize(words_.size() - kBlockWords);
  }
  void reserve(std::size_t n) { words_.reserve((n + kBlockCodes - 1) / kBlockCodes * kBlockWords); }
  void clear() {
    words_.clear();
    size_ = 0;
  }
  std::size_t memory() const { return words_.capacity() * sizeof(std::uint64_t); }

 private:
  std::vector<std::uint64_t, CacheLineAllocator<std::uint64_t>> words_;
  std::size_t size_ = 0;
};

/// A code that a scan found: distance << 32 | place, so that order is by distance, then place.
using CodeHit = std::uint64_t;
constexpr CodeHit code_hit(std::uint64_t distance, std::uint64_t place) { return distance << 32 | place; }
constexpr int hit_distance(CodeHit hit) { return static_cast<int>(hit >> 32); }
constexpr std::uint32_t hit_place(CodeHit hit) { return static_cast<std::uint32_t>(hit); }

/// Which instructions a scan uses; all give the same hits in the same order.
enum class ScanKernel { portable, avx2, avx512 };

/// Whether 512-bit vectors may be used; the environment variable SWEEPKIT_SIMD=avx2 forbids it (read once), a
/// test may.
inline std::atomic<bool>& avx512_allowed() {
  static std::atomic<bool> allowed = [] {
    const char* wish = std::getenv("SWEEPKIT_SIMD");
    return !(wish && std::string_view(wish) == "avx2");
  }();
  return allowed;
}

/// The best that this machine has and simd_level() allows.
inline ScanKernel scan_kernel() {
#ifdef SWEEPKIT_HAVE_AVX2
  static const bool avx512 = __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw") &&
                             __builtin_cpu_supports("avx512vpopcntdq");
  if (simd_level() == SimdLevel::avx2)
    return avx512 && avx512_allowed().load(std::memory_order_relaxed) ? ScanKernel::avx512 : ScanKernel::avx2;
#endif
  return ScanKernel::portable;
}

/// After how many words a scan looks for the first time whether anything in a group of codes can still be
/// within the threshold. Distances of unrelated codes grow by 32 a word, and their spread with it, since bits
/// of descriptors are not independent. A group passes if one of its codes does, which has to be rare: the
/// bounds are where one word more begins to pay on descriptors of images.
constexpr std::size_t words_before_test(int threshold, std::size_t words) {
  for (std::size_t w = 1; w < words; ++w)
    if (threshold < 23 * static_cast<int>(w) - 11) return w;
  return words;
}

/// Appends the hits of codes [first block, last block) within `threshold` of the query in order of place.
/// @param hits room for 64 a block
/// Returns the end of what was written.
template <std::size_t kWords>
CodeHit* scan_portable(const std::uint64_t* blocks, std::size_t first, std::size_t last,
                       const std::uint64_t* query, int threshold, CodeHit* hits) {
  const std::size_t tested = words_before_test(threshold, kWords);
  for (std::size_t b = first; b < last; ++b) {
    const std::uint64_t* words = blocks + b * kBlockCodes * kWords;
    for (std::size_t i = 0; i < kBlockCodes; ++i) {
      BinaryDescriptor<64> x, y;
      int distance = 0;
      for (std::size_t w = 0; w < kWords; ++w) {
        if (w == tested && distance > threshold) break;
        x.words[0] = query[w];
        y.words[0] = words[w * kBlockCodes + i];
        distance += hamming_distance(x, y);
      }
      if (distance <= threshold)
        *hits++ = code_hit(static_cast<std::uint64_t>(distance), b * kBlockCodes + i);
    }
  }
  return hits;
}

#ifdef SWEEPKIT_HAVE_AVX2
/// Set bits of each byte (W. Mula et al., "Faster population counts using AVX2 instructions", 2018).
SWEEPKIT_TARGET_AVX2 inline __m256i count_bits_of_bytes(__m256i x) {
  const __m256i table = _mm256_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4, 0, 1, 1, 2, 1, 2, 2,
                                         3, 1, 2, 2, 3, 2, 3, 3, 4);
  const __m256i low = _mm256_set1_epi8(15);
  return _mm256_add_epi8(_mm256_shuffle_epi8(table, _mm256_and_si256(x, low)),
                         _mm256_shuffle_epi8(table, _mm256_and_si256(_mm256_srli_epi16(x, 4), low)));
}

template <std::size_t kWords>
SWEEPKIT_TARGET_AVX2 CodeHit* scan_avx2(const std::uint64_t* blocks, std::size_t first, std::size_t last,
                                        const std::uint64_t* query, int threshold, CodeHit* hits) {
  static_assert(kWords <= 31, "counts of a byte over all words have to fit a byte");
  constexpr std::size_t kLanes = 4, kGroup = 8 * kLanes;
  const std::size_t tested = words_before_test(threshold, kWords);
  const __m256i zero = _mm256_setzero_si256();
  const __m256i above = _mm256_set1_epi64x(threshold + 1);
  for (std::size_t b = first; b < last; ++b)
    for (std::size_t group = 0; group < kBlockCodes; group += kGroup) {
      const std::uint64_t* words = blocks + b * kBlockCodes * kWords + group;
      __m256i bytes[8];
      for (auto& v : bytes) v = zero;
      for (std::size_t w = 0; w < tested; ++w) {
        const __m256i q = _mm256_set1_epi64x(static_cast<long long>(query[w]));
#pragma GCC unroll 8
        for (std::size_t k = 0; k < 8; ++k)
          bytes[k] = _mm256_add_epi8(bytes[k], count_bits_of_bytes(_mm256_xor_si256(
                                                   q, load_32(words + w * kBlockCodes + k * kLanes))));
      }
      __m256i least = _mm256_sad_epu8(bytes[0], zero);
#pragma GCC unroll 7
      for (std::size_t k = 1; k < 8; ++k) least = _mm256_min_epu16(least, _mm256_sad_epu8(bytes[k], zero));
      const __m256i passes = _mm256_cmpgt_epi64(above, least);
      if (_mm256_testz_si256(passes, passes)) continue;
      for (std::size_t k = 0; k < 8; ++k) {
        __m256i count = bytes[k];
        for (std::size_t w = tested; w < kWords; ++w)
          count = _mm256_add_epi8(count, count_bits_of_bytes(_mm256_xor_si256(
                                             _mm256_set1_epi64x(static_cast<long long>(query[w])),
                                             load_32(words + w * kBlockCodes + k * kLanes))));
        count = _mm256_sad_epu8(count, zero);
        auto mask =
            static_cast<unsigned>(_mm256_movemask_pd(_mm256_castsi256_pd(_mm256_cmpgt_epi64(above, count))));
        if (mask == 0) continue;
        alignas(32) std::uint64_t distances[kLanes];
        store_32(distances, count);
        for (; mask != 0; mask &= mask - 1) {
          const auto lane = static_cast<std::size_t>(std::countr_zero(mask));
          *hits++ = code_hit(distances[lane], b * kBlockCodes + group + k * kLanes + lane);
        }
      }
    }
  return hits;
}

template <std::size_t kWords>
SWEEPKIT_TARGET_AVX512_POPCOUNT CodeHit* scan_avx512(const std::uint64_t* blocks, std::size_t first,
                                                     std::size_t last, const std::uint64_t* query,
                                                     int threshold, CodeHit* hits) {
  constexpr std::size_t kLanes = 8;
  const std::size_t tested = words_before_test(threshold, kWords);
  const __m512i most = _mm512_set1_epi64(threshold);
  for (std::size_t b = first; b < last; ++b) {
    const std::uint64_t* words = blocks + b * kBlockCodes * kWords;
    __m512i count[8];
    __m512i q = _mm512_set1_epi64(static_cast<long long>(query[0]));
#pragma GCC unroll 8
    for (std::size_t k = 0; k < 8; ++k)
      count[k] = _mm512_popcnt_epi64(_mm512_xor_si512(q, _mm512_load_si512(words + k * kLanes)));
    for (std::size_t w = 1; w < tested; ++w) {
      q = _mm512_set1_epi64(static_cast<long long>(query[w]));
#pragma GCC unroll 8
      for (std::size_t k = 0; k < 8; ++k)
        count[k] =
            _mm512_add_epi64(count[k], _mm512_popcnt_epi64(_mm512_xor_si512(
                                           q, _mm512_load_si512(words + w * kBlockCodes + k * kLanes))));
    }
    __m512i least = count[0];
    // The masked form with all lanes is the same instruction; gcc 12 warns of its own header at the plain
    // one.
#pragma GCC unroll 7
    for (std::size_t k = 1; k < 8; ++k) least = _mm512_mask_min_epi64(least, 0xff, least, count[k]);
    if (_mm512_cmple_epi64_mask(least, most) == 0) continue;
    for (std::size_t k = 0; k < 8; ++k) {
      auto mask = static_cast<unsigned>(_mm512_cmple_epi64_mask(count[k], most));
      if (mask == 0) continue;
      __m512i all = count[k];
      for (std::size_t w = tested; w < kWords; ++w)
        all = _mm512_add_epi64(all, _mm512_popcnt_epi64(_mm512_xor_si512(
                                        _mm512_set1_epi64(static_cast<long long>(query[w])),
                                        _mm512_load_si512(words + w * kBlockCodes + k * kLanes))));
      mask = static_cast<unsigned>(_mm512_cmple_epi64_mask(all, most));
      if (mask == 0) continue;
      alignas(64) std::uint64_t distances[kLanes];
      _mm512_store_si512(distances, all);
      for (; mask != 0; mask &= mask - 1) {
        const auto lane = static_cast<std::size_t>(std::countr_zero(mask));
        *hits++ = code_hit(distances[lane], b * kBlockCodes + k * kLanes + lane);
      }
    }
  }
  return hits;
}
#endif

/// The kernel as a function; the places of its hits count from the first block of `blocks`.
using ScanFunction = CodeHit* (*)(const std::uint64_t* blocks, std::size_t first, std::size_t last,
                                  const std::uint64_t* query, int threshold, CodeHit* hits);

template <std::size_t kWords>
ScanFunction scan_function(ScanKernel kernel) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (kernel == ScanKernel::avx512) return scan_avx512<kWords>;
  if (kernel == ScanKernel::avx2) return scan_avx2<kWords>;
#endif
  return scan_portable<kWords>;
}

}  // namespace sweepkit::impl
