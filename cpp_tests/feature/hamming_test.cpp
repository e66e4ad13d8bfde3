// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/feature/hamming.hpp"

#include <catch2/catch.hpp>
#include <cstring>
#include <random>
#include <vector>

using namespace sweepkit;

namespace {

template <int Bits>
std::vector<BinaryDescriptor<Bits>> random_descriptors(std::size_t count, std::uint32_t seed) {
  std::mt19937_64 random(seed);
  std::vector<BinaryDescriptor<Bits>> descriptors(count);
  for (auto& d : descriptors)
    for (auto& word : d.words) word = random() & random();
  return descriptors;
}

template <int Bits>
int count_bit_by_bit(const BinaryDescriptor<Bits>& a, const BinaryDescriptor<Bits>& b) {
  int distance = 0;
  for (int i = 0; i < Bits; ++i)
    distance += (a.words[i / 64] >> (i % 64) & 1) != (b.words[i / 64] >> (i % 64) & 1);
  return distance;
}

template <int Bits>
struct Length {
  static constexpr int kBits = Bits;
};

}  // namespace

TEMPLATE_TEST_CASE("All Hamming kernels count differing bits", "", Length<64>, Length<128>, Length<256>,
                   Length<512>, Length<4096>) {
  constexpr int kBits = TestType::kBits;
  auto a = random_descriptors<kBits>(13, 1);
  const auto b = random_descriptors<kBits>(31, 2);
  a[0] = b[0];
  for (auto& word : a[1].words) word = 0;
  for (std::size_t w = 0; w < a[2].words.size(); ++w) a[2].words[w] = ~b[5].words[w];  // all bits differ
  std::vector<std::int32_t> indices{30, 0, 5, 5, 17};
  for (const SimdLevel path : {SimdLevel::avx2, SimdLevel::portable}) {
    const ScopedSimdLevel level(path);
    std::vector<std::uint16_t> matrix(a.size() * b.size()), row(b.size()), listed(indices.size());
    hamming_distance_matrix<kBits>(a, b, matrix);
    for (std::size_t i = 0; i < a.size(); ++i) {
      hamming_distances(a[i], b, row);
      hamming_distances(a[i], b, indices, listed);
      for (std::size_t j = 0; j < b.size(); ++j) {
        const int expected = count_bit_by_bit(a[i], b[j]);
        CHECK_FALSE(hamming_distance(a[i], b[j]) != expected);
        CHECK_FALSE(row[j] != expected);
        CHECK_FALSE(matrix[i * b.size() + j] != expected);
      }
      for (std::size_t k = 0; k < indices.size(); ++k) CHECK_FALSE(listed[k] != row[indices[k]]);
    }
  }
}

TEST_CASE("Matrices larger than a block are whole") {
  const auto a = random_descriptors<256>(3, 3), b = random_descriptors<256>(1100, 4);
  std::vector<std::uint16_t> matrix(a.size() * b.size());
  hamming_distance_matrix<256>(a, b, matrix);
  for (std::size_t i = 0; i < a.size(); ++i)
    for (std::size_t j = 0; j < b.size(); ++j)
      CHECK_FALSE(matrix[i * b.size() + j] != hamming_distance(a[i], b[j]));
}

TEST_CASE("Nothing to compare is no error, too little room is") {
  const auto a = random_descriptors<256>(2, 1);
  std::vector<std::uint16_t> distances(1);
  hamming_distances(a[0], {}, distances);
  CHECK_THROWS_AS(hamming_distances(a[0], a, distances), Error);
  CHECK_THROWS_AS(hamming_distance_matrix<256>(a, a, distances), Error);
}

TEST_CASE("Bit i of a descriptor is bit i % 8 of byte i / 8") {
  OrbDescriptor d;
  d.words[1] = std::uint64_t{1} << 11;
  std::uint8_t bytes[32];
  std::memcpy(bytes, &d, 32);
  for (int i = 0; i < 256; ++i) CHECK((bytes[i / 8] >> (i % 8) & 1) == (i == 75));
}
