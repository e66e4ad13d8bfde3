// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>

#include "sweepkit/core/simd.hpp"
#include "sweepkit/feature/descriptor.hpp"

// One step down the tree for a batch of descriptors: for each the nearest of a node's children, of equally
// near ones the first. The children's descriptors lie word by word, so that a vector holds the same word of
// four children and distances need no horizontal sums.

namespace sweepkit::impl {

/// One descriptor at one node.
struct ChildSearch {
  const std::uint64_t* query;
  const std::uint64_t* planes;  ///< word w of child i at planes[w * count + i]
  std::uint32_t count;
  std::uint32_t best;      ///< result: index of the nearest child
  std::uint32_t distance;  ///< result: bits that differ from it
};

/// Distance and index in one number: the smallest is the nearest, and of equal ones the first.
constexpr int kChildBits = 16;

template <int Words>
void nearest_children_portable(ChildSearch* searches, std::size_t size) {
  for (std::size_t s = 0; s < size; ++s) {
    ChildSearch& search = searches[s];
    std::uint32_t best = ~0u;
    for (std::uint32_t i = 0; i < search.count; ++i) {
      BinaryDescriptor<64 * Words> a, b;
      for (int w = 0; w < Words; ++w) {
        a.words[w] = search.query[w];
        b.words[w] = search.planes[w * search.count + i];
      }
      const std::uint32_t key = static_cast<std::uint32_t>(hamming_distance(a, b)) << kChildBits | i;
      best = key < best ? key : best;
    }
    search.best = best & ((1u << kChildBits) - 1);
    search.distance = best >> kChildBits;
  }
}

#ifdef SWEEPKIT_HAVE_AVX2

/// Set bits of each byte.
SWEEPKIT_TARGET_AVX2 inline __m256i count_bits_of_bytes(__m256i x) {
  const __m256i table = _mm256_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4, 0, 1, 1, 2, 1, 2, 2,
                                         3, 1, 2, 2, 3, 2, 3, 3, 4);
  const __m256i nibble = _mm256_set1_epi8(15);
  return _mm256_add_epi8(_mm256_shuffle_epi8(table, _mm256_and_si256(x, nibble)),
                         _mm256_shuffle_epi8(table, _mm256_and_si256(_mm256_srli_epi16(x, 4), nibble)));
}

/// Distances to children i .. i + 3, as 64-bit numbers. `query` holds each word four times.
template <int Words>
SWEEPKIT_TARGET_AVX2 inline __m256i distances_to_four(const __m256i* query, const std::uint64_t* planes,
                                                      std::size_t count, std::size_t i) {
  const __m256i zero = _mm256_setzero_si256();
  __m256i sum = zero;
  // Bytes count up to 8 a word: 31 words fit.
  for (int from = 0; from < Words; from += 31) {
    const int end = from + 31 < Words ? from + 31 : Words;
    __m256i bytes = count_bits_of_bytes(_mm256_xor_si256(query[from], load_32(planes + from * count + i)));
#pragma GCC unroll 8
    for (int w = from + 1; w < end; ++w)
      bytes = _mm256_add_epi8(
          bytes, count_bits_of_bytes(_mm256_xor_si256(query[w], load_32(planes + w * count + i))));
    const __m256i part = _mm256_sad_epu8(bytes, zero);
    sum = from == 0 ? part : _mm256_add_epi64(sum, part);
  }
  return sum;
}

template <int Words>
SWEEPKIT_TARGET_AVX2 void nearest_children_avx2(ChildSearch* searches, std::size_t size) {
  const __m256i lanes = _mm256_setr_epi64x(0, 1, 2, 3), step = _mm256_set1_epi64x(4);
  for (std::size_t s = 0; s < size; ++s) {
    ChildSearch& search = searches[s];
    const std::uint64_t* planes = search.planes;
    const std::size_t count = search.count;
    __m256i query[Words];
#pragma GCC unroll 8
    for (int w = 0; w < Words; ++w) query[w] = _mm256_set1_epi64x(static_cast<long long>(search.query[w]));
    __m256i keys = _mm256_set1_epi64x(0x7fffffff), index = lanes;
    std::size_t i = 0;
    for (; i + 4 <= count; i += 4) {
      const __m256i distance = distances_to_four<Words>(query, planes, count, i);
      keys = _mm256_min_epi32(keys, _mm256_or_si256(_mm256_slli_epi64(distance, kChildBits), index));
      index = _mm256_add_epi64(index, step);
    }
    // The rest word by word: other units of the processor do this beside the vectors.
    std::uint32_t best = 0x7fffffff;
    for (; i < count; ++i) {
      std::uint64_t distance = 0;
#pragma GCC unroll 8
      for (int w = 0; w < Words; ++w)
        distance += static_cast<std::uint64_t>(_mm_popcnt_u64(search.query[w] ^ planes[w * count + i]));
      const auto key = static_cast<std::uint32_t>(distance << kChildBits | i);
      best = key < best ? key : best;
    }
    __m128i half = _mm_min_epi32(_mm256_castsi256_si128(keys), _mm256_extracti128_si256(keys, 1));
    half = _mm_min_epi32(half, _mm_shuffle_epi32(half, 0x4e));
    const auto key = static_cast<std::uint32_t>(_mm_cvtsi128_si32(half));
    best = key < best ? key : best;
    search.best = best & ((1u << kChildBits) - 1);
    search.distance = best >> kChildBits;
  }
}

#define SWEEPKIT_TARGET_VECTOR_POPCOUNT \
  __attribute__((target("avx2,bmi,popcnt,avx512f,avx512vl,avx512vpopcntdq")))

/// Processors that count the bits of vectors: one instruction instead of eight.
inline bool has_vector_popcount() {
  static const bool has = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                          __builtin_cpu_supports("avx512vpopcntdq");
  return has;
}

template <int Words>
SWEEPKIT_TARGET_VECTOR_POPCOUNT void nearest_children_popcount(ChildSearch* searches, std::size_t size) {
  const __m256i lanes = _mm256_setr_epi64x(0, 1, 2, 3), step = _mm256_set1_epi64x(4);
  for (std::size_t s = 0; s < size; ++s) {
    ChildSearch& search = searches[s];
    const std::size_t count = search.count;
    __m256i keys = _mm256_set1_epi64x(0x7fffffff), index = lanes;
    for (std::size_t i = 0; i < count; i += 4) {
      const auto inside = static_cast<__mmask8>(count - i >= 4 ? 0xfu : (1u << (count - i)) - 1);
      __m256i distance = _mm256_setzero_si256();
#pragma GCC unroll 8
      for (int w = 0; w < Words; ++w) {
        const __m256i query = _mm256_set1_epi64x(static_cast<long long>(search.query[w]));
        const __m256i child = _mm256_maskz_loadu_epi64(inside, search.planes + w * count + i);
        distance = _mm256_add_epi64(distance, _mm256_popcnt_epi64(_mm256_xor_si256(query, child)));
      }
      const __m256i key = _mm256_or_si256(_mm256_slli_epi64(distance, kChildBits), index);
      keys = _mm256_mask_min_epi64(keys, inside, keys, key);
      index = _mm256_add_epi64(index, step);
    }
    __m128i half = _mm_min_epi32(_mm256_castsi256_si128(keys), _mm256_extracti128_si256(keys, 1));
    half = _mm_min_epi32(half, _mm_shuffle_epi32(half, 0x4e));
    const auto best = static_cast<std::uint32_t>(_mm_cvtsi128_si32(half));
    search.best = best & ((1u << kChildBits) - 1);
    search.distance = best >> kChildBits;
  }
}

#endif

/// Fills `best` of each search. Every count is at least 1.
template <int Words>
void nearest_children(ChildSearch* searches, std::size_t size) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2)
    return has_vector_popcount() ? nearest_children_popcount<Words>(searches, size)
                                 : nearest_children_avx2<Words>(searches, size);
#endif
  nearest_children_portable<Words>(searches, size);
}

}  // namespace sweepkit::impl
