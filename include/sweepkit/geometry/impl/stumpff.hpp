// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>

namespace sweepkit::impl {

/// The functions C_k(x) = sum over n of (-x)^n / (2n + k)! at x = theta^2, of which all Jacobians of
/// rotations and rigid motions consist: C_2 = (1 - cos) / theta^2, C_3 = (theta - sin) / theta^3, and C_k = 1
/// / k! - x C_(k+2). Stumpff, Himmelsmechanik I (1959).
template <class S>
struct Stumpff {
  S c1, c2, c3, c4, c5;

  /// @param x theta^2, not negative
  explicit Stumpff(const S& x) {
    using std::cos;
    using std::sin;
    using std::sqrt;
    if (x < S(1)) {
      // The closed forms cancel here, the more so their derivatives; nine terms leave 1 / 22!.
      c4 = c5 = S(0);
      for (int n = 8; n >= 0; --n) {
        c4 = S(kInverseFactorial[2 * n + 4]) - x * c4;
        c5 = S(kInverseFactorial[2 * n + 5]) - x * c5;
      }
      c2 = S(1.0 / 2) - x * c4;
      c3 = S(1.0 / 6) - x * c5;
      c1 = S(1) - x * c3;
    } else {
      const S theta = sqrt(x);
      const S half_sine = sin(S(0.5) * theta);
      c1 = sin(theta) / theta;
      c2 = S(2) * half_sine * half_sine / x;
      c3 = (S(1) - c1) / x;
      c4 = (S(1.0 / 2) - c2) / x;
      c5 = (S(1.0 / 6) - c3) / x;
    }
  }

 private:
  static constexpr struct InverseFactorials {
    double value[22];
    constexpr InverseFactorials() : value{} {
      double factorial = 1;
      for (int i = 0; i < 22; ++i) {
        if (i > 0) factorial *= i;
        value[i] = 1 / factorial;
      }
    }
    constexpr double operator[](int i) const { return value[i]; }
  } kInverseFactorial{};
};

}  // namespace sweepkit::impl
