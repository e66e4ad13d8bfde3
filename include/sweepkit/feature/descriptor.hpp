// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <vector>

#include "sweepkit/feature/keypoint.hpp"

namespace sweepkit {

/// A binary descriptor. Bit i is bit i % 64 of words[i / 64]; in memory (little endian) this is byte i / 8,
/// bit i % 8, the layout of OpenCV's rows.
template <int Bits>
struct BinaryDescriptor {
  static_assert(Bits > 0 && Bits % 64 == 0, "descriptors are whole 64-bit words");
  static constexpr int kBits = Bits;
  static constexpr int kWords = Bits / 64;

  std::array<std::uint64_t, kWords> words{};

  friend bool operator==(const BinaryDescriptor&, const BinaryDescriptor&) = default;
};

using OrbDescriptor = BinaryDescriptor<256>;

namespace impl {

/// Set bits of each byte, byte by byte.
constexpr std::uint64_t count_bytes(std::uint64_t x) {
  x -= x >> 1 & 0x5555555555555555u;
  x = (x & 0x3333333333333333u) + (x >> 2 & 0x3333333333333333u);
  return (x + (x >> 4)) & 0x0f0f0f0f0f0f0f0fu;
}

}  // namespace impl

/// Number of bits that differ. For many distances see hamming.hpp.
template <int Bits>
inline int hamming_distance(const BinaryDescriptor<Bits>& a, const BinaryDescriptor<Bits>& b) {
  int distance = 0;
#if defined(__x86_64__) && !defined(__POPCNT__)
  // Without the instruction std::popcount is a call for each word. Bytes count up to 8 a word: 31 words fit.
  constexpr int kWords = BinaryDescriptor<Bits>::kWords;
  for (int i = 0; i < kWords;) {
    std::uint64_t bytes = 0;
    for (const int end = i + 31 < kWords ? i + 31 : kWords; i < end; ++i)
      bytes += impl::count_bytes(a.words[i] ^ b.words[i]);
    const std::uint64_t pairs = (bytes & 0x00ff00ff00ff00ffu) + (bytes >> 8 & 0x00ff00ff00ff00ffu);
    distance += static_cast<int>(pairs * 0x0001000100010001u >> 48);
  }
#else
  for (int i = 0; i < BinaryDescriptor<Bits>::kWords; ++i) distance += std::popcount(a.words[i] ^ b.words[i]);
#endif
  return distance;
}

/// Key points of one image and their descriptors, index by index.
template <int Bits = 256>
struct Features {
  std::vector<KeyPoint> keypoints;
  std::vector<BinaryDescriptor<Bits>> descriptors;

  std::size_t size() const { return keypoints.size(); }
  void clear() {
    keypoints.clear();
    descriptors.clear();
  }
};

}  // namespace sweepkit
