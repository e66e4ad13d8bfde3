// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/feature/false_alarms.hpp"

#include <catch2/catch.hpp>
#include <cmath>

using namespace sweepkit;

TEST_CASE("The binomial tail is the sum of its terms") {
  for (const double p : {0.02, 0.1, 0.125, 0.4, 0.9})
    for (const int n : {1, 2, 7, 40, 150})
      for (int k = 0; k <= n; ++k) {
        long double sum = 0;
        for (int i = k; i <= n; ++i)
          sum += std::exp(std::lgamma(n + 1.0L) - std::lgamma(i + 1.0L) - std::lgamma(n - i + 1.0L) +
                          i * std::log(static_cast<long double>(p)) +
                          (n - i) * std::log1p(-static_cast<long double>(p)));
        const bool close =
            std::abs(log10_binomial_tail(n, k, p) - static_cast<double>(std::log10(sum))) < 1e-3;
        CHECK_FALSE(!close);
      }
}

TEST_CASE("More aligned points are surer, and long tails stay finite") {
  NumberOfFalseAlarms validation;
  validation.prepare(640, 480, 0.1);
  for (int k = 1; k <= 100; ++k) CHECK(validation.response(100, k) >= validation.response(100, k - 1));
  CHECK(validation.response(5, 5) < 0);
  CHECK(validation.accepts(validation.response(60, 60), 1.0));
  CHECK(std::isfinite(validation.response(100000, 100000)));
  CHECK(std::isfinite(validation.response(100000, 50000)));
}
