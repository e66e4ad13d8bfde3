// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/bag_score.hpp"

#include <bit>
#include <cfloat>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "sweepkit/core/simd.hpp"

namespace sweepkit {
namespace {

// What a word that both bags have adds to a sum; for words that one lacks all of these give 0. The distance
// |v - w|_1 of two bags of norm 1 is 2 - 2 sum of min(v, w).
struct Smaller {
  static double of(double v, double w) { return v < w ? v : w; }
#ifdef SWEEPKIT_HAVE_AVX2
  SWEEPKIT_TARGET_AVX2 static __m256d of(__m256d v, __m256d w) { return _mm256_min_pd(v, w); }
#endif
};
struct Product {
  static double of(double v, double w) { return v * w; }
#ifdef SWEEPKIT_HAVE_AVX2
  SWEEPKIT_TARGET_AVX2 static __m256d of(__m256d v, __m256d w) { return _mm256_mul_pd(v, w); }
#endif
};
struct ChiSquare {
  static double of(double v, double w) { return v + w != 0 ? v * w / (v + w) : 0.0; }
#ifdef SWEEPKIT_HAVE_AVX2
  SWEEPKIT_TARGET_AVX2 static __m256d of(__m256d v, __m256d w) {
    const __m256d sum = _mm256_add_pd(v, w);
    const __m256d some = _mm256_cmp_pd(sum, _mm256_setzero_pd(), _CMP_NEQ_UQ);
    return _mm256_and_pd(some, _mm256_div_pd(_mm256_mul_pd(v, w), sum));
  }
#endif
};
struct Root {
  static double of(double v, double w) { return std::sqrt(v * w); }
#ifdef SWEEPKIT_HAVE_AVX2
  SWEEPKIT_TARGET_AVX2 static __m256d of(__m256d v, __m256d w) { return _mm256_sqrt_pd(_mm256_mul_pd(v, w)); }
#endif
};

// Sixteen sums side by side, added in one order: both kernels give the same bits.
double add_up(const double* sums) {
  double lanes[4];
  for (int i = 0; i < 4; ++i) lanes[i] = (sums[i] + sums[4 + i]) + (sums[8 + i] + sums[12 + i]);
  return (lanes[0] + lanes[2]) + (lanes[1] + lanes[3]);
}

template <class Term>
double dense_sum_portable(const double* a, const double* b, std::size_t size) {
  double sums[16] = {};
  for (std::size_t i = 0; i < size; i += 16)
    for (std::size_t k = 0; k < 16; ++k) sums[k] += Term::of(a[i + k], b[i + k]);
  return add_up(sums);
}

/// Calls each(i, j) for a[i] == b[j], ascending.
template <class Each>
void for_common(const std::uint32_t* a, std::size_t a_size, std::size_t i, const std::uint32_t* b,
                std::size_t b_size, std::size_t j, Each&& each) {
  while (i < a_size && j < b_size) {
    const std::uint32_t x = a[i], y = b[j];
    if (x == y) each(i, j);
    i += x <= y;
    j += y <= x;
  }
}

template <class Term>
double common_sum_portable(const Bag& a, const Bag& b) {
  double sum = 0;
  for_common(a.words().data(), a.size(), 0, b.words().data(), b.size(), 0,
             [&](std::size_t i, std::size_t j) { sum += Term::of(a.weights()[i], b.weights()[j]); });
  return sum;
}

#ifdef SWEEPKIT_HAVE_AVX2
template <class Term>
SWEEPKIT_TARGET_AVX2 double dense_sum_avx2(const double* a, const double* b, std::size_t size) {
  __m256d s0 = _mm256_setzero_pd(), s1 = s0, s2 = s0, s3 = s0;
  for (std::size_t i = 0; i < size; i += 16) {
    s0 = _mm256_add_pd(s0, Term::of(_mm256_loadu_pd(a + i), _mm256_loadu_pd(b + i)));
    s1 = _mm256_add_pd(s1, Term::of(_mm256_loadu_pd(a + i + 4), _mm256_loadu_pd(b + i + 4)));
    s2 = _mm256_add_pd(s2, Term::of(_mm256_loadu_pd(a + i + 8), _mm256_loadu_pd(b + i + 8)));
    s3 = _mm256_add_pd(s3, Term::of(_mm256_loadu_pd(a + i + 12), _mm256_loadu_pd(b + i + 12)));
  }
  double sums[16];
  _mm256_storeu_pd(sums, s0);
  _mm256_storeu_pd(sums + 4, s1);
  _mm256_storeu_pd(sums + 8, s2);
  _mm256_storeu_pd(sums + 12, s3);
  return add_up(sums);
}

/// Eight words of one bag against eight of the other at a time; what is left word by word. Matches come in
/// the order in which the portable walk finds them.
template <class Term>
SWEEPKIT_TARGET_AVX2 double common_sum_avx2(const Bag& bag_a, const Bag& bag_b) {
  const std::uint32_t *a = bag_a.words().data(), *b = bag_b.words().data();
  const double *v = bag_a.weights().data(), *w = bag_b.weights().data();
  const std::size_t a_size = bag_a.size(), b_size = bag_b.size();
  const __m256i turn = _mm256_setr_epi32(1, 2, 3, 4, 5, 6, 7, 0);
  double sum = 0;
  std::size_t i = 0, j = 0;
  while (i + 8 <= a_size && j + 8 <= b_size) {
    const __m256i x = impl::load_32(a + i);
    __m256i y = impl::load_32(b + j);
    __m256i equal = _mm256_cmpeq_epi32(x, y);
    for (int k = 1; k < 8; ++k) {
      y = _mm256_permutevar8x32_epi32(y, turn);
      equal = _mm256_or_si256(equal, _mm256_cmpeq_epi32(x, y));
    }
    auto bits = static_cast<unsigned>(_mm256_movemask_ps(_mm256_castsi256_ps(equal)));
    for (; bits; bits &= bits - 1) {
      const std::size_t m = i + static_cast<std::size_t>(std::countr_zero(bits));
      std::size_t n = j;
      while (b[n] != a[m]) ++n;
      sum += Term::of(v[m], w[n]);
    }
    const std::uint32_t last_a = a[i + 7], last_b = b[j + 7];
    i += last_a <= last_b ? 8 : 0;
    j += last_b <= last_a ? 8 : 0;
  }
  for_common(a, a_size, i, b, b_size, j, [&](std::size_t m, std::size_t n) { sum += Term::of(v[m], w[n]); });
  return sum;
}
#endif

template <class Term>
double sum_of(const Bag& a, const Bag& b) {
  const bool dense = !a.dense().empty() && a.dense().size() == b.dense().size();
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2)
    return dense ? dense_sum_avx2<Term>(a.dense().data(), b.dense().data(), a.dense().size())
                 : common_sum_avx2<Term>(a, b);
#endif
  return dense ? dense_sum_portable<Term>(a.dense().data(), b.dense().data(), a.dense().size())
               : common_sum_portable<Term>(a, b);
}

double divergence(const Bag& a, const Bag& b) {
  const double log_epsilon = std::log(DBL_EPSILON);
  const auto v = a.weights(), w = b.weights();
  double sum = 0;
  std::size_t j = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    while (j < b.size() && b.words()[j] < a.words()[i]) ++j;
    const bool common = j < b.size() && b.words()[j] == a.words()[i];
    if (v[i] == 0 || (common && w[j] == 0)) continue;
    sum += common ? v[i] * std::log(v[i] / w[j]) : v[i] * (std::log(v[i]) - log_epsilon);
  }
  return sum;
}

}  // namespace

double bag_score(const Bag& a, const Bag& b, BagScore score) {
  if (a.empty() || b.empty()) return score == BagScore::kl ? DBL_MAX : 0.0;
  switch (score) {
    case BagScore::l1:
      return sum_of<Smaller>(a, b);
    case BagScore::l2: {
      const double product = sum_of<Product>(a, b);
      return product >= 1 ? 1.0 : 1.0 - std::sqrt(1.0 - product);
    }
    case BagScore::chi_square:
      return 2 * sum_of<ChiSquare>(a, b);
    case BagScore::kl:
      return divergence(a, b);
    case BagScore::bhattacharyya:
      return sum_of<Root>(a, b);
    case BagScore::dot:
      return sum_of<Product>(a, b);
  }
  return 0.0;
}

}  // namespace sweepkit
