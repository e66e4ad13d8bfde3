// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/match/nearest_codes.hpp"

#include <catch2/catch.hpp>

#include "match/random_codes.hpp"

using namespace sweepkit;

namespace {

template <int Bits>
std::vector<BinaryDescriptor<Bits>> queries_near(Random& random, const PlainCodes<Bits>& plain, int count,
                                                 int distance) {
  std::vector<BinaryDescriptor<Bits>> queries;
  for (int i = 0; i < count; ++i)
    queries.push_back(
        plain.items.empty() || i % 6 == 0
            ? random_code<Bits>(random)
            : disturbed_code(random, plain.items[random.index(plain.items.size())].code, distance));
  return queries;
}

}  // namespace

TEMPLATE_TEST_CASE_SIG("multi-index hashing is exact while codes come and go", "", ((int Bits), Bits), 64,
                       128, 256, 384, 512) {
  Random random(11 + Bits);
  for (const int substrings : {0, 3, Bits / 11}) {
    MultiIndexHash<Bits> hash(substrings);
    PlainCodes<Bits> plain;
    for (int round = 0; round < 6; ++round) {
      const auto codes = clustered_codes<Bits>(random, 400 + random.index(400), 8);
      if (round % 2 == 0) {
        const auto ids = hash.insert(codes);
        for (std::size_t i = 0; i < codes.size(); ++i) plain.items.push_back({ids[i], codes[i]});
      } else {
        for (const auto& code : codes) plain.items.push_back({hash.insert(code), code});
      }
      if (round == 1) hash.build();  // the next ones lie beside the tables
      for (auto removals = random.index(plain.items.size() / 3); removals > 0; --removals) {
        const auto at = random.index(plain.items.size());
        hash.remove(plain.items[at].id);
        plain.items.erase(plain.items.begin() + static_cast<std::ptrdiff_t>(at));
      }
      REQUIRE(hash.size() == plain.items.size());
      for (const auto& query : queries_near(random, plain, 8, 12)) {
        std::vector<Match> matches;
        for (const int radius : {-1, 0, 1, 4, 10, 17, 25}) {
          hash.within(query, radius, matches);
          CHECK(matches == plain.within(query, radius));
        }
        for (const std::size_t count : {std::size_t{0}, std::size_t{1}, std::size_t{2}, std::size_t{20}}) {
          hash.nearest(query, count, matches);
          CHECK(matches == plain.nearest(query, count));
        }
      }
    }
    CHECK(hash.substrings() > 0);
    CHECK(hash.beside() > 0);
  }
}

TEST_CASE("tables are built when they are due, and removals empty them") {
  Random random(2);
  MultiIndexHash<256> hash;
  CHECK(hash.substrings() == 0);
  std::vector<std::int32_t> ids;
  for (int i = 0; i < 3000; ++i) ids.push_back(hash.insert(random_code<256>(random)));
  CHECK(hash.substrings() == MultiIndexHash<256>::substrings_for(2049));
  CHECK(hash.beside() == 3000 - 2049);
  for (const auto id : ids) hash.remove(id);
  CHECK(hash.size() == 0);
  std::vector<Match> matches;
  hash.within(OrbDescriptor{}, 256, matches);
  CHECK(matches.empty());
  hash.nearest(OrbDescriptor{}, 3, matches);
  CHECK(matches.empty());
  hash.build();
  hash.within(OrbDescriptor{}, 10, matches);
  CHECK(matches.empty());
  hash.insert(OrbDescriptor{});
  hash.nearest(OrbDescriptor{}, 3, matches);
  CHECK(matches == std::vector<Match>{{ids.back(), 0}});
  CHECK_THROWS_AS(MultiIndexHash<64>(17), Error);
  CHECK_THROWS_AS(MultiIndexHash<64>(-1), Error);
}

TEST_CASE("the pigeonhole counts what a radius looks up") {
  Random random(8);
  MultiIndexHash<64> hash(4);  // 16 bits each
  for (int i = 0; i < 3000; ++i) hash.insert(random_code<64>(random));
  CHECK(hash.lookups(-1).buckets == 0);
  CHECK(hash.lookups(0).buckets == 1);
  CHECK(hash.lookups(3).buckets == 4);
  CHECK(hash.lookups(4).buckets == 17 + 3);
  CHECK(hash.lookups(11).buckets == 4 * (1 + 16 + 120));
}

TEMPLATE_TEST_CASE_SIG("all ways of NearestCodes give the lists of the definition", "", ((int Bits), Bits),
                       64, 256, 512) {
  Random random(23 + Bits);
  const auto codes = clustered_codes<Bits>(random, 6000, 10);
  PlainCodes<Bits> plain;
  std::vector<NearestCodes<Bits>> ways;
  for (const CodeSearch search : {CodeSearch::automatic, CodeSearch::scan, CodeSearch::multi_index})
    for (const int threads : {1, 2})
      ways.emplace_back(NearestCodesOptions{.search = search, .threads = threads});
  for (auto& way : ways) way.insert(codes);
  for (std::size_t i = 0; i < codes.size(); ++i)
    plain.items.push_back({static_cast<std::int32_t>(i), codes[i]});
  for (int i = 0; i < 500; ++i) {
    const auto at = random.index(plain.items.size());
    for (auto& way : ways) way.remove(plain.items[at].id);
    plain.items.erase(plain.items.begin() + static_cast<std::ptrdiff_t>(at));
  }
  // Half of the queries have a very near code, so that the tables are tried and given up.
  auto queries = queries_near(random, plain, 20, 3);
  for (const auto& query : queries_near(random, plain, 20, Bits / 4)) queries.push_back(query);
  NeighbourLists lists;
  for (const auto& way : ways) {
    REQUIRE(way.size() == plain.items.size());
    for (const int radius : {-1, 0, 9, 20, 60}) {
      way.within(queries, radius, lists);
      REQUIRE(lists.size() == queries.size());
      for (std::size_t i = 0; i < queries.size(); i += 3) {
        CHECK(std::ranges::equal(lists[i], plain.within(queries[i], radius)));
        CHECK(std::ranges::equal(lists[i], way.within(queries[i], radius)));
      }
    }
    for (const std::size_t count : {std::size_t{1}, std::size_t{5}}) {
      way.nearest(queries, count, lists);
      REQUIRE(lists.size() == queries.size());
      for (std::size_t i = 0; i < queries.size(); i += 3) {
        CHECK(std::ranges::equal(lists[i], plain.nearest(queries[i], count)));
        CHECK(std::ranges::equal(lists[i], way.nearest(queries[i], count)));
      }
    }
    way.nearest(std::span<const BinaryDescriptor<Bits>>(), 1, lists);
    CHECK(lists.size() == 0);
  }
}

TEST_CASE("NearestCodes is the same on every path of instructions") {
  Random random(31);
  NearestCodes<256> codes;
  const auto all = clustered_codes<256>(random, 5000, 20);
  codes.insert(all);
  const std::span queries = std::span(all).first(100);
  NeighbourLists fast[2], portable[2];
  codes.within(queries, 25, fast[0]);
  codes.nearest(queries, 3, fast[1]);
  const ScopedSimdLevel level(SimdLevel::portable);
  codes.within(queries, 25, portable[0]);
  codes.nearest(queries, 3, portable[1]);
  CHECK(fast[0] == portable[0]);
  CHECK(fast[1] == portable[1]);
}

TEST_CASE("NearestCodes refuses what is not there") {
  NearestCodes<256> codes;
  CHECK_THROWS_AS(codes.remove(0), Error);
  CHECK_THROWS_AS(codes.code(3), Error);
  CHECK_FALSE(codes.contains(0));
  CHECK(codes.nearest(OrbDescriptor{}, 2).empty());
  CHECK(codes.within(OrbDescriptor{}, 256).empty());
  CHECK_THROWS_AS(NearestCodes<256>({.substrings = 65}), Error);
}
