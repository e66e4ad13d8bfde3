// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <cmath>

// Products and factors of matrices of a handful of rows as plain loops. Eigen's own unroll them into
// expressions that run no faster and take the compiler minutes for six and seven rows.
namespace sweepkit::small {

/// A B.
template <int M, int K, int N>
Eigen::Matrix<double, M, N> product(const Eigen::Matrix<double, M, K>& A,
                                    const Eigen::Matrix<double, K, N>& B) {
  Eigen::Matrix<double, M, N> C;
  double* c = C.data();
  const double *a = A.data(), *b = B.data();
  for (int n = 0; n < N; ++n) {
    double sum[M] = {};
    for (int k = 0; k < K; ++k)
      for (int m = 0; m < M; ++m) sum[m] += a[k * M + m] * b[n * K + k];
    for (int m = 0; m < M; ++m) c[n * M + m] = sum[m];
  }
  return C;
}

template <int M, int N>
Eigen::Matrix<double, N, M> transposed(const Eigen::Matrix<double, M, N>& A) {
  Eigen::Matrix<double, N, M> T;
  for (int n = 0; n < N; ++n)
    for (int m = 0; m < M; ++m) T.data()[m * N + n] = A.data()[n * M + m];
  return T;
}

/// Replaces the lower triangle of A by its Cholesky factor and the upper by zeros; false unless A is positive
/// definite.
template <int D>
bool factorize(Eigen::Matrix<double, D, D>& A) {
  for (int k = 0; k < D; ++k) {
    double d = A(k, k);
    for (int p = 0; p < k; ++p) d -= A(k, p) * A(k, p);
    if (!(d > 0.0) || !std::isfinite(d)) return false;
    d = std::sqrt(d);
    A(k, k) = d;
    for (int i = k + 1; i < D; ++i) {
      double s = A(i, k);
      for (int p = 0; p < k; ++p) s -= A(i, p) * A(k, p);
      A(i, k) = s / d;
      A(k, i) = 0.0;
    }
  }
  return true;
}

/// L^-1 B for a lower triangle.
template <int D, int N>
Eigen::Matrix<double, D, N> solve_lower(const Eigen::Matrix<double, D, D>& L,
                                        const Eigen::Matrix<double, D, N>& B) {
  Eigen::Matrix<double, D, N> X;
  for (int n = 0; n < N; ++n)
    for (int r = 0; r < D; ++r) {
      double s = B(r, n);
      for (int c = 0; c < r; ++c) s -= L(r, c) * X(c, n);
      X(r, n) = s / L(r, r);
    }
  return X;
}

/// The inverse of a symmetric positive definite matrix.
template <int D>
Eigen::Matrix<double, D, D> inverse(Eigen::Matrix<double, D, D> A) {
  using Square = Eigen::Matrix<double, D, D>;
  factorize(A);
  const Square L_inverse = solve_lower<D, D>(A, Square::Identity());
  return product<D, D, D>(transposed<D, D>(L_inverse), L_inverse);
}

}  // namespace sweepkit::small
