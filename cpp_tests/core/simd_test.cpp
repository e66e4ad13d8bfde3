// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/core/simd.hpp"

#include <catch2/catch.hpp>

using namespace sweepkit;

TEST_CASE("A scoped SIMD level lowers the level and gives it back, but never raises it") {
  const SimdLevel machine = simd_level();
  {
    const ScopedSimdLevel portable(SimdLevel::portable);
    CHECK(simd_level() == SimdLevel::portable);
    {
      const ScopedSimdLevel higher(SimdLevel::avx2);
      CHECK(simd_level() == SimdLevel::portable);
    }
    CHECK(simd_level() == SimdLevel::portable);
  }
  CHECK(simd_level() == machine);
}
