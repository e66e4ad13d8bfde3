// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/match/code_scan.hpp"

#include <catch2/catch.hpp>

#include "match/random_codes.hpp"

using namespace sweepkit;

TEMPLATE_TEST_CASE_SIG("every kernel finds what the definition says", "", ((int Bits), Bits), 64, 128, 192,
                       256, 320, 512) {
  Random random(Bits);
  const auto codes = clustered_codes<Bits>(random, 5 * impl::kBlockCodes, Bits / 8);
  impl::CodeBlocks<Bits> blocks;
  for (const auto& code : codes) blocks.push_back(code);
  std::vector<impl::ScanKernel> kernels{impl::ScanKernel::portable};
  if (simd_level() == SimdLevel::avx2) kernels.push_back(impl::ScanKernel::avx2);
  if (impl::scan_kernel() == impl::ScanKernel::avx512) kernels.push_back(impl::ScanKernel::avx512);
  for (const int threshold : {0, 1, 7, 11, 12, 30, 34, 35, 57, 58, 90, 120, 150, 255, Bits - 1, Bits}) {
    if (threshold > Bits) continue;
    const auto query = disturbed_code(random, codes[random.index(codes.size())], Bits / 4);
    std::vector<impl::CodeHit> expected;
    for (std::size_t i = impl::kBlockCodes; i < 4 * impl::kBlockCodes; ++i) {
      const int distance = hamming_distance(codes[i], query);
      if (distance <= threshold) expected.push_back(impl::code_hit(static_cast<std::uint64_t>(distance), i));
    }
    for (const impl::ScanKernel kernel : kernels) {
      std::vector<impl::CodeHit> hits(codes.size());
      const auto* end = impl::scan_function<Bits / 64>(kernel)(blocks.block(0), 1, 4, query.words.data(),
                                                               threshold, hits.data());
      hits.resize(static_cast<std::size_t>(end - hits.data()));
      CHECK(hits == expected);
    }
  }
}

TEMPLATE_TEST_CASE_SIG("a scan keeps to its definition while codes come and go", "", ((int Bits), Bits), 64,
                       256, 512) {
  Random random(3 + Bits);
  CodeScan<Bits> scan;
  PlainCodes<Bits> plain;
  for (int round = 0; round < 12; ++round) {
    for (const auto& code : clustered_codes<Bits>(random, random.index(150), 6)) {
      const std::int32_t id = scan.insert(code);
      for (const auto& item : plain.items) REQUIRE(item.id != id);
      plain.items.push_back({id, code});
    }
    for (auto removals = random.index(plain.items.size() + 1) / 2; removals > 0; --removals) {
      const auto at = random.index(plain.items.size());
      scan.remove(plain.items[at].id);
      CHECK_FALSE(scan.contains(plain.items[at].id));
      plain.items.erase(plain.items.begin() + static_cast<std::ptrdiff_t>(at));
    }
    REQUIRE(scan.size() == plain.items.size());
    for (const auto& item : plain.items) REQUIRE(scan.code(item.id) == item.code);
    std::vector<BinaryDescriptor<Bits>> queries;
    for (int i = 0; i < 70; ++i)
      queries.push_back(plain.items.empty() || i % 5 == 0
                            ? random_code<Bits>(random)
                            : disturbed_code(random, plain.items[random.index(plain.items.size())].code, 9));
    for (const int threads : {1, 3}) {
      NeighbourLists lists;
      std::vector<Match> one;
      scan.within(queries, 14, lists, threads);
      REQUIRE(lists.size() == queries.size());
      for (std::size_t i = 0; i < queries.size(); ++i) {
        const auto expected = plain.within(queries[i], 14);
        CHECK(std::ranges::equal(lists[i], expected));
        scan.within(queries[i], 14, one);
        CHECK(one == expected);
      }
      for (const std::size_t count : {std::size_t{0}, std::size_t{1}, std::size_t{3}, std::size_t{1000}}) {
        scan.nearest(queries, count, lists, threads);
        REQUIRE(lists.size() == queries.size());
        for (std::size_t i = 0; i < queries.size(); ++i) {
          const auto expected = plain.nearest(queries[i], count);
          CHECK(std::ranges::equal(lists[i], expected));
          scan.nearest(queries[i], count, one);
          CHECK(one == expected);
        }
      }
    }
  }
}

TEST_CASE("bounds that hold do not change what is nearest") {
  Random random(5);
  CodeScan<256> scan;
  const auto codes = clustered_codes<256>(random, 300, 30);
  for (const auto& code : codes) scan.insert(code);
  NeighbourLists free, bound;
  scan.nearest(codes, 4, free);
  std::vector<int> bounds;
  for (std::size_t i = 0; i < codes.size(); ++i)
    bounds.push_back(free[i].back().distance + static_cast<int>(random.index(3)));
  scan.nearest(codes, bounds, 4, bound);
  CHECK(free == bound);
  bounds.pop_back();
  CHECK_THROWS_AS(scan.nearest(codes, bounds, 4, bound), Error);
}

TEST_CASE("ids that are not there are errors, and freed ids come back last first") {
  CodeScan<64> scan;
  CHECK_THROWS_AS(scan.remove(0), Error);
  CHECK_THROWS_AS(scan.code(-1), Error);
  for (int i = 0; i < 5; ++i) CHECK(scan.insert({}) == i);
  scan.remove(1);
  scan.remove(3);
  CHECK_THROWS_AS(scan.remove(3), Error);
  CHECK(scan.insert({}) == 3);
  CHECK(scan.insert({}) == 1);
  CHECK(scan.insert({}) == 5);
  scan.clear();
  CHECK(scan.size() == 0);
  CHECK(scan.insert({}) == 0);
  std::vector<Match> matches{{7, 7}};
  scan.within(BinaryDescriptor<64>{}, -1, matches);
  CHECK(matches.empty());
}
