// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>

#include "sweepkit/core/simd.hpp"
#include "sweepkit/feature/descriptor.hpp"

namespace sweepkit::impl {

#ifdef SWEEPKIT_HAVE_AVX2

template <int Bits>
SWEEPKIT_TARGET_AVX2 inline std::uint16_t hamming_popcnt(const BinaryDescriptor<Bits>& a,
                                                         const BinaryDescriptor<Bits>& b) {
  long long distance = 0;
  for (int w = 0; w < BinaryDescriptor<Bits>::kWords; ++w)
    distance += _mm_popcnt_u64(a.words[w] ^ b.words[w]);
  return static_cast<std::uint16_t>(distance);
}

/// Bit counts of 32 bytes, summed over each group of eight (W. Mula et al., "Faster population counts using
/// AVX2 instructions", 2018).
SWEEPKIT_TARGET_AVX2 inline __m256i count_words(__m256i x) {
  const __m256i table = _mm256_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4, 0, 1, 1, 2, 1, 2, 2,
                                         3, 1, 2, 2, 3, 2, 3, 3, 4);
  const __m256i low = _mm256_set1_epi8(15);
  const __m256i bytes =
      _mm256_add_epi8(_mm256_shuffle_epi8(table, _mm256_and_si256(x, low)),
                      _mm256_shuffle_epi8(table, _mm256_and_si256(_mm256_srli_epi16(x, 4), low)));
  return _mm256_sad_epu8(bytes, _mm256_setzero_si256());
}

template <int Bits>
SWEEPKIT_TARGET_AVX2 void hamming_row_avx2(const BinaryDescriptor<Bits>& query,
                                           const BinaryDescriptor<Bits>* candidates, std::size_t count,
                                           std::uint16_t* distances) {
  for (std::size_t i = 0; i < count; ++i) distances[i] = hamming_popcnt(query, candidates[i]);
}

/// Four descriptors at a time, one in each vector.
SWEEPKIT_TARGET_AVX2 inline void hamming_row_avx2(const BinaryDescriptor<256>& query,
                                                  const BinaryDescriptor<256>* candidates, std::size_t count,
                                                  std::uint16_t* distances) {
  const __m256i q = load_32(&query);
  std::size_t i = 0;
  for (; i + 4 <= count; i += 4) {
    __m256i sums[4];
    for (int k = 0; k < 4; ++k) sums[k] = count_words(_mm256_xor_si256(q, load_32(candidates + i + k)));
    // Sums below 65 in each group of 64 bits: shift two apart and add, so that all four share the lanes.
    const __m256i a = _mm256_or_si256(sums[0], _mm256_slli_epi64(sums[1], 16));
    const __m256i b = _mm256_or_si256(_mm256_slli_epi64(sums[2], 32), _mm256_slli_epi64(sums[3], 48));
    const __m256i all = _mm256_or_si256(a, b);
    const __m128i half = _mm_add_epi16(_mm256_castsi256_si128(all), _mm256_extracti128_si256(all, 1));
    _mm_storel_epi64(reinterpret_cast<__m128i*>(distances + i),
                     _mm_add_epi16(half, _mm_unpackhi_epi64(half, half)));
  }
  for (; i < count; ++i) distances[i] = hamming_popcnt(query, candidates[i]);
}

template <int Bits>
SWEEPKIT_TARGET_AVX2 void hamming_listed_avx2(const BinaryDescriptor<Bits>& query,
                                              const BinaryDescriptor<Bits>* descriptors,
                                              const std::int32_t* indices, std::size_t count,
                                              std::uint16_t* distances) {
  for (std::size_t i = 0; i < count; ++i) distances[i] = hamming_popcnt(query, descriptors[indices[i]]);
}

#endif

template <int Bits>
void hamming_row(const BinaryDescriptor<Bits>& query, const BinaryDescriptor<Bits>* candidates,
                 std::size_t count, std::uint16_t* distances) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return hamming_row_avx2(query, candidates, count, distances);
#endif
  for (std::size_t i = 0; i < count; ++i)
    distances[i] = static_cast<std::uint16_t>(hamming_distance(query, candidates[i]));
}

template <int Bits>
void hamming_listed(const BinaryDescriptor<Bits>& query, const BinaryDescriptor<Bits>* descriptors,
                    const std::int32_t* indices, std::size_t count, std::uint16_t* distances) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2)
    return hamming_listed_avx2(query, descriptors, indices, count, distances);
#endif
  for (std::size_t i = 0; i < count; ++i)
    distances[i] = static_cast<std::uint16_t>(hamming_distance(query, descriptors[indices[i]]));
}

}  // namespace sweepkit::impl
