// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "block_cholesky.hpp"

#include <Eigen/OrderingMethods>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <cstring>

#include "small_matrix.hpp"
#include "sweepkit/core/simd.hpp"

namespace sweepkit {
namespace {

// Vectors of the compiler's own: four lanes are two SSE registers in baseline code and one AVX register in a
// function compiled for it. Each lane does the same operations in the same order, so all paths agree.
using Lanes4 = double __attribute__((vector_size(32)));
using Lanes2 = double __attribute__((vector_size(16)));

template <class V>
[[gnu::always_inline]] inline void load(V& v, const double* p) {
  std::memcpy(&v, p, sizeof(V));
}
template <class V>
[[gnu::always_inline]] inline void store(double* p, const V& v) {
  std::memcpy(p, &v, sizeof(V));
}

// One stripe of rows: C -= A B', B of D x D by rows.
template <int D, class V>
[[gnu::always_inline]] inline void subtract_stripe(double* C, std::ptrdiff_t ldc, const double* A,
                                                   std::ptrdiff_t lda, const double* B) {
  V c[D], a;
  for (int k = 0; k < D; ++k) load(c[k], C + k * ldc);
  for (int p = 0; p < D; ++p) {
    load(a, A + p * lda);
    for (int k = 0; k < D; ++k) c[k] -= a * B[k * D + p];
  }
  for (int k = 0; k < D; ++k) store(C + k * ldc, c[k]);
}

// X L' = A in place, row by row of A; `inverse` holds 1 / L(k, k).
template <int D, class V>
[[gnu::always_inline]] inline void solve_stripe(double* A, std::ptrdiff_t lda, const double* L,
                                                const double* inverse) {
  V x[D];
  for (int k = 0; k < D; ++k) {
    load(x[k], A + k * lda);
    for (int p = 0; p < k; ++p) x[k] -= x[p] * L[k * D + p];
    x[k] *= inverse[k];
    store(A + k * lda, x[k]);
  }
}

template <int D>
[[gnu::always_inline]] inline void subtract_rows(double* C, std::ptrdiff_t ldc, const double* A,
                                                 std::ptrdiff_t lda, const double* B, std::ptrdiff_t rows) {
  std::ptrdiff_t r = 0;
  for (; r + 4 <= rows; r += 4) subtract_stripe<D, Lanes4>(C + r, ldc, A + r, lda, B);
  if (r + 2 <= rows) {
    subtract_stripe<D, Lanes2>(C + r, ldc, A + r, lda, B);
    r += 2;
  }
  if (r < rows) subtract_stripe<D, double>(C + r, ldc, A + r, lda, B);
}

template <int D>
[[gnu::always_inline]] inline void solve_rows(double* A, std::ptrdiff_t lda, const double* L,
                                              const double* inverse, std::ptrdiff_t rows) {
  std::ptrdiff_t r = 0;
  for (; r + 4 <= rows; r += 4) solve_stripe<D, Lanes4>(A + r, lda, L, inverse);
  if (r + 2 <= rows) {
    solve_stripe<D, Lanes2>(A + r, lda, L, inverse);
    r += 2;
  }
  if (r < rows) solve_stripe<D, double>(A + r, lda, L, inverse);
}

// What is done with one column once it is complete: a stretch of its rows is subtracted elsewhere.
struct Stretch {
  double* to;
  std::ptrdiff_t ld_to;
  const double* from;
  std::ptrdiff_t rows;
};

template <int D>
void subtract_portable(const Stretch* s, std::size_t count, std::ptrdiff_t lda, const double* B) {
  for (std::size_t k = 0; k < count; ++k) subtract_rows<D>(s[k].to, s[k].ld_to, s[k].from, lda, B, s[k].rows);
}
template <int D>
void solve_portable(double* A, std::ptrdiff_t lda, const double* L, const double* inverse) {
  solve_rows<D>(A, lda, L, inverse, lda);
}
#ifdef SWEEPKIT_HAVE_AVX2
template <int D>
SWEEPKIT_TARGET_AVX2 void subtract_avx2(const Stretch* s, std::size_t count, std::ptrdiff_t lda,
                                        const double* B) {
  for (std::size_t k = 0; k < count; ++k) subtract_rows<D>(s[k].to, s[k].ld_to, s[k].from, lda, B, s[k].rows);
}
template <int D>
SWEEPKIT_TARGET_AVX2 void solve_avx2(double* A, std::ptrdiff_t lda, const double* L, const double* inverse) {
  solve_rows<D>(A, lda, L, inverse, lda);
}
#endif

template <int D>
auto subtract_kernel() {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return subtract_avx2<D>;
#endif
  return subtract_portable<D>;
}
template <int D>
auto solve_kernel() {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return solve_avx2<D>;
#endif
  return solve_portable<D>;
}

std::vector<int> order_of_elimination(int size, const std::vector<std::pair<int, int>>& pairs) {
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(2 * pairs.size() + static_cast<std::size_t>(size));
  for (int i = 0; i < size; ++i) entries.emplace_back(i, i, 1.0);
  for (const auto& [i, j] : pairs) {
    entries.emplace_back(i, j, 1.0);
    entries.emplace_back(j, i, 1.0);
  }
  Eigen::SparseMatrix<double> pattern(size, size);
  pattern.setFromTriplets(entries.begin(), entries.end());
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> order;
  Eigen::AMDOrdering<int>()(pattern, order);
  // indices()[k] is the row that comes k-th.
  std::vector<int> position(static_cast<std::size_t>(size));
  for (int k = 0; k < size; ++k) position[static_cast<std::size_t>(order.indices()[k])] = k;
  return position;
}

}  // namespace

template <int D>
BlockCholesky<D>::BlockCholesky(int size, const std::vector<std::pair<int, int>>& pairs) {
  const auto n = static_cast<std::size_t>(size);
  if (size > 0) position_ = order_of_elimination(size, pairs);
  for (const auto& [i, j] : pairs) {
    const int a = position_[static_cast<std::size_t>(i)], b = position_[static_cast<std::size_t>(j)];
    pairs_.emplace_back(std::max(a, b), std::min(a, b));
  }
  const auto by_column = [](const auto& a, const auto& b) {
    return std::pair(a.second, a.first) < std::pair(b.second, b.first);
  };
  std::sort(pairs_.begin(), pairs_.end(), by_column);
  pairs_.erase(std::unique(pairs_.begin(), pairs_.end()), pairs_.end());

  // A column of L has the rows of H's column and, but for itself, those of the columns whose first row it is.
  std::vector<std::vector<int>> columns(n), children(n);
  std::size_t next = 0;
  for (int k = 0; k < size; ++k) {
    std::vector<int>& column = columns[static_cast<std::size_t>(k)];
    for (; next < pairs_.size() && pairs_[next].second == k; ++next) column.push_back(pairs_[next].first);
    for (const int child : children[static_cast<std::size_t>(k)])
      for (const int row : columns[static_cast<std::size_t>(child)])
        if (row != k) column.push_back(row);
    std::sort(column.begin(), column.end());
    column.erase(std::unique(column.begin(), column.end()), column.end());
    if (!column.empty()) children[static_cast<std::size_t>(column.front())].push_back(k);
  }
  begin_.push_back(0);
  for (const auto& column : columns) {
    rows_.insert(rows_.end(), column.begin(), column.end());
    begin_.push_back(static_cast<int>(rows_.size()));
  }
  for (const auto& [row, column] : pairs_) {
    const int* first = rows(column);
    places_.push_back(
        {column, static_cast<int>(std::lower_bound(first, first + count(column), row) - first)});
  }
  run_begin_.push_back(0);
  for (int k = 0; k < size; ++k)
    for (int a = 0; a < count(k); ++a) {
      const int target = rows(k)[a];
      int to = 0;
      const auto first_run = runs_.size();
      for (int b = a + 1; b < count(k); ++b, ++to) {
        while (rows(target)[to] != rows(k)[b]) ++to;
        if (runs_.size() > first_run && runs_.back().to + runs_.back().count == to)
          ++runs_.back().count;
        else
          runs_.push_back({b, 1, to});
      }
      run_begin_.push_back(static_cast<int>(runs_.size()));
    }
  diagonal_.resize(n);
  off_diagonal_.resize(pairs_.size());
  factor_diagonal_.resize(n);
  factor_.resize(rows_.size() * D * D);
  set_zero();
}

template <int D>
double BlockCholesky<D>::factor_products() const {
  double products = 0.0;
  for (int k = 0; k < size(); ++k) {
    const double m = count(k);
    products += D * D * D * (1.0 / 6.0 + 0.5 * m + 0.5 * m * (m + 1.0));
  }
  return products;
}

template <int D>
typename BlockCholesky<D>::Slot BlockCholesky<D>::slot(int i, int j) const {
  const int a = position_[static_cast<std::size_t>(i)], b = position_[static_cast<std::size_t>(j)];
  const std::pair key(std::max(a, b), std::min(a, b));
  const auto at = std::lower_bound(pairs_.begin(), pairs_.end(), key, [](const auto& x, const auto& y) {
    return std::pair(x.second, x.first) < std::pair(y.second, y.first);
  });
  return {static_cast<int>(at - pairs_.begin()), a < b};
}

template <int D>
void BlockCholesky<D>::set_zero() {
  for (Block& block : diagonal_) block.setZero();
  for (Block& block : off_diagonal_) block.setZero();
}

template <int D>
bool BlockCholesky<D>::factorize(double damping) {
  const auto subtract = subtract_kernel<D>();
  const auto solve_panel = solve_kernel<D>();
  std::fill(factor_.begin(), factor_.end(), 0.0);
  for (std::size_t k = 0; k < pairs_.size(); ++k) {
    const auto [column, row] = places_[k];
    const std::ptrdiff_t ld = static_cast<std::ptrdiff_t>(count(column)) * D;
    double* to = panel(factor_, begin_[static_cast<std::size_t>(column)]) + row * D;
    for (int c = 0; c < D; ++c) std::memcpy(to + c * ld, off_diagonal_[k].data() + c * D, D * sizeof(double));
  }
  for (std::size_t k = 0; k < diagonal_.size(); ++k) {
    factor_diagonal_[k] = diagonal_[k];
    factor_diagonal_[k].diagonal() *= 1.0 + damping;
  }
  std::vector<Stretch> stretches;
  for (int k = 0; k < size(); ++k) {
    Block& L = factor_diagonal_[static_cast<std::size_t>(k)];
    if (!small::factorize<D>(L)) return false;
    const int begin = begin_[static_cast<std::size_t>(k)];
    const std::ptrdiff_t ld = static_cast<std::ptrdiff_t>(count(k)) * D;
    double* A = panel(factor_, begin);
    double by_rows[D * D], inverse[D];
    for (int r = 0; r < D; ++r) {
      inverse[r] = 1.0 / L(r, r);
      for (int c = 0; c < D; ++c) by_rows[r * D + c] = L(r, c);
    }
    solve_panel(A, ld, by_rows, inverse);
    for (int a = 0; a < count(k); ++a) {
      const int target = rows(k)[a];
      const int target_begin = begin_[static_cast<std::size_t>(target)];
      const std::ptrdiff_t ld_target = static_cast<std::ptrdiff_t>(count(target)) * D;
      for (int r = 0; r < D; ++r)
        for (int c = 0; c < D; ++c) by_rows[r * D + c] = A[a * D + r + c * ld];
      stretches.clear();
      stretches.push_back({factor_diagonal_[static_cast<std::size_t>(target)].data(), D, A + a * D, D});
      const auto block = static_cast<std::size_t>(begin + a);
      for (int r = run_begin_[block]; r < run_begin_[block + 1]; ++r) {
        const Run& run = runs_[static_cast<std::size_t>(r)];
        stretches.push_back({panel(factor_, target_begin) + run.to * D, ld_target, A + run.from * D,
                             static_cast<std::ptrdiff_t>(run.count) * D});
      }
      subtract(stretches.data(), stretches.size(), ld, by_rows);
    }
  }
  return true;
}

template <int D>
void BlockCholesky<D>::solve(Eigen::VectorXd& x) const {
  using Segment = Eigen::Matrix<double, D, 1>;
  Eigen::VectorXd y(x.size());
  for (int i = 0; i < size(); ++i)
    y.segment<D>(position_[static_cast<std::size_t>(i)] * D) = x.segment<D>(i * D);
  for (int k = 0; k < size(); ++k) {
    const Block& L = factor_diagonal_[static_cast<std::size_t>(k)];
    Segment z = y.segment<D>(k * D);
    for (int r = 0; r < D; ++r) {
      for (int c = 0; c < r; ++c) z[r] -= L(r, c) * z[c];
      z[r] /= L(r, r);
    }
    y.segment<D>(k * D) = z;
    const std::ptrdiff_t ld = static_cast<std::ptrdiff_t>(count(k)) * D;
    const double* A = panel(factor_, begin_[static_cast<std::size_t>(k)]);
    for (int a = 0; a < count(k); ++a) {
      auto target = y.segment<D>(rows(k)[a] * D);
      for (int c = 0; c < D; ++c) target -= z[c] * Eigen::Map<const Segment>(A + a * D + c * ld);
    }
  }
  for (int k = size() - 1; k >= 0; --k) {
    const Block& L = factor_diagonal_[static_cast<std::size_t>(k)];
    Segment z = y.segment<D>(k * D);
    const std::ptrdiff_t ld = static_cast<std::ptrdiff_t>(count(k)) * D;
    const double* A = panel(factor_, begin_[static_cast<std::size_t>(k)]);
    for (int a = 0; a < count(k); ++a) {
      const auto source = y.segment<D>(rows(k)[a] * D);
      for (int c = 0; c < D; ++c) z[c] -= source.dot(Eigen::Map<const Segment>(A + a * D + c * ld));
    }
    for (int r = D - 1; r >= 0; --r) {
      for (int c = r + 1; c < D; ++c) z[r] -= L(c, r) * z[c];
      z[r] /= L(r, r);
    }
    y.segment<D>(k * D) = z;
  }
  for (int i = 0; i < size(); ++i)
    x.segment<D>(i * D) = y.segment<D>(position_[static_cast<std::size_t>(i)] * D);
}

template <int D>
void BlockCholesky<D>::invert() {
  const auto subtract = subtract_kernel<D>();
  inverse_diagonal_.resize(diagonal_.size());
  inverse_.resize(factor_.size());
  std::vector<double> S, Y;
  for (int k = size() - 1; k >= 0; --k) {
    const int begin = begin_[static_cast<std::size_t>(k)], m = count(k);
    const Block L_inverse =
        small::solve_lower<D, D>(factor_diagonal_[static_cast<std::size_t>(k)], Block::Identity());
    Block& diagonal = inverse_diagonal_[static_cast<std::size_t>(k)];
    diagonal = small::product<D, D, D>(small::transposed<D, D>(L_inverse), L_inverse);
    if (m == 0) continue;
    // The inverse over the rows of this column is known, since they come later and L's pattern is closed.
    const std::ptrdiff_t ld = static_cast<std::ptrdiff_t>(m) * D;
    S.resize(static_cast<std::size_t>(ld * ld));
    for (int a = 0; a < m; ++a) {
      const int column = rows(k)[a];
      double* to = S.data() + ld * D * a;
      const double* from_diagonal = inverse_diagonal_[static_cast<std::size_t>(column)].data();
      for (int c = 0; c < D; ++c) std::memcpy(to + a * D + c * ld, from_diagonal + c * D, D * sizeof(double));
      const std::ptrdiff_t ld_from = static_cast<std::ptrdiff_t>(count(column)) * D;
      const double* from = panel(inverse_, begin_[static_cast<std::size_t>(column)]);
      const auto block = static_cast<std::size_t>(begin + a);
      for (int r = run_begin_[block]; r < run_begin_[block + 1]; ++r) {
        const Run& run = runs_[static_cast<std::size_t>(r)];
        for (int c = 0; c < D; ++c)
          std::memcpy(to + run.from * D + c * ld, from + run.to * D + c * ld_from,
                      sizeof(double) * static_cast<std::size_t>(run.count) * D);
      }
      for (int c = 0; c < D; ++c)
        for (std::ptrdiff_t r = (a + 1) * D; r < ld; ++r)
          S[static_cast<std::size_t>(r * ld + a * D + c)] = to[c * ld + r];
    }
    // Y = -panel L_kk^-1, and the column of the inverse is S Y.
    double by_rows[D * D];
    for (int c = 0; c < D; ++c)
      for (int p = 0; p < D; ++p) by_rows[c * D + p] = L_inverse(p, c);
    Y.assign(static_cast<std::size_t>(ld) * D, 0.0);
    const Stretch whole{Y.data(), ld, panel(factor_, begin), ld};
    subtract(&whole, 1, ld, by_rows);
    double* result = panel(inverse_, begin);
    std::fill_n(result, ld * D, 0.0);
    for (int a = 0; a < m; ++a) {
      for (int c = 0; c < D; ++c)
        for (int p = 0; p < D; ++p) by_rows[c * D + p] = -Y[static_cast<std::size_t>(c * ld + a * D + p)];
      const Stretch stripe{result, ld, S.data() + ld * D * a, ld};
      subtract(&stripe, 1, ld, by_rows);
    }
    for (int r = 0; r < D; ++r)
      for (int c = 0; c <= r; ++c) {
        double sum = 0.0;
        for (std::ptrdiff_t q = 0; q < ld; ++q)
          sum += Y[static_cast<std::size_t>(r * ld + q)] * result[c * ld + q];
        diagonal(r, c) += sum;
        diagonal(c, r) = diagonal(r, c);
      }
  }
}

template <int D>
typename BlockCholesky<D>::Block BlockCholesky<D>::inverse(const Slot& slot) const {
  const auto [column, row] = places_[static_cast<std::size_t>(slot.index)];
  const std::ptrdiff_t ld = static_cast<std::ptrdiff_t>(count(column)) * D;
  const double* from = panel(inverse_, begin_[static_cast<std::size_t>(column)]) + row * D;
  const Eigen::Map<const Block, 0, Eigen::OuterStride<>> kept(from, Eigen::OuterStride<>(ld));
  return slot.transposed ? Block(kept.transpose()) : Block(kept);
}

template class BlockCholesky<4>;
template class BlockCholesky<6>;
template class BlockCholesky<7>;

}  // namespace sweepkit
