// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <catch2/catch.hpp>

namespace sweepkit::test {

/// The derivative of f at x by central differences of fourth order (five-point rule): right to about
/// h^4 times the fifth derivative plus the rounding of f over h.
/// @param f from a fixed-size vector of double to a fixed-size vector of double
template <class F, int kIn>
auto numeric_jacobian(const F& f, const Eigen::Matrix<double, kIn, 1>& x, double h = 1e-3) {
  using Value = std::decay_t<decltype(f(x))>;
  Eigen::Matrix<double, Value::RowsAtCompileTime, kIn> J;
  for (int i = 0; i < kIn; ++i) {
    const auto at = [&](double d) -> Value {
      Eigen::Matrix<double, kIn, 1> moved = x;
      moved[i] += d;
      return f(moved);
    };
    J.col(i) = (8.0 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h);
  }
  return J;
}

/// Checks an analytic Jacobian against central differences, to a tolerance relative to the largest entry (at
/// least 1).
template <class F, int kIn, class Analytic>
void check_jacobian(const F& f, const Eigen::Matrix<double, kIn, 1>& x,
                    const Eigen::MatrixBase<Analytic>& analytic, double tolerance = 1e-9, double h = 1e-3) {
  const auto numeric = numeric_jacobian(f, x, h);
  const double scale = std::max(1.0, numeric.cwiseAbs().maxCoeff());
  const double error = (numeric - analytic).cwiseAbs().maxCoeff() / scale;
  INFO("at " << x.transpose() << "\nanalytic\n" << analytic << "\nnumeric\n" << numeric);
  CHECK(error <= tolerance);
}

}  // namespace sweepkit::test
