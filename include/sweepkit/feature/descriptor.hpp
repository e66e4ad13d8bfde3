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

/// Number of bits that differ.
template <int Bits>
inline int hamming_distance(const BinaryDescriptor<Bits>& a, const BinaryDescriptor<Bits>& b) {
  int distance = 0;
  for (int i = 0; i < BinaryDescriptor<Bits>::kWords; ++i) distance += std::popcount(a.words[i] ^ b.words[i]);
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
