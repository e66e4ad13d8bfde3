// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/impl/nearest_child.hpp"

#include <catch2/catch.hpp>
#include <vector>

#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

template <int Words>
void compare_kernels(std::uint64_t seed) {
  Random random(seed);
  for (std::uint32_t count = 1; count < 40; ++count) {
    std::vector<std::uint64_t> planes(count * Words), query(Words);
    // Few bits: many children lie equally near.
    for (auto& word : planes) word = count % 2 ? random() & 5u : random();
    for (auto& word : query) word = random();
    const impl::ChildSearch search{query.data(), planes.data(), count, 0, 0};
    std::uint32_t best = 0, best_distance = 64 * Words + 1;
    for (std::uint32_t i = 0; i < count; ++i) {
      std::uint32_t distance = 0;
      for (int w = 0; w < Words; ++w)
        distance += static_cast<std::uint32_t>(std::popcount(query[w] ^ planes[w * count + i]));
      if (distance < best_distance) {
        best_distance = distance;
        best = i;
      }
    }
    const auto check = [&](auto kernel) {
      impl::ChildSearch found = search;
      kernel(&found, 1);
      CHECK(found.best == best);
      CHECK(found.distance == best_distance);
    };
    check(impl::nearest_children_portable<Words>);
#ifdef SWEEPKIT_HAVE_AVX2
    if (simd_level() == SimdLevel::avx2) check(impl::nearest_children_avx2<Words>);
    if (simd_level() == SimdLevel::avx2 && impl::has_vector_popcount())
      check(impl::nearest_children_popcount<Words>);
#endif
  }
}

}  // namespace

TEST_CASE("every kernel finds the nearest child, and of equal ones the first", "[bow]") {
  compare_kernels<1>(1);
  compare_kernels<2>(2);
  compare_kernels<4>(3);
  compare_kernels<8>(4);
  compare_kernels<40>(5);
}
