// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <numbers>

#include "sweepkit/core/random.hpp"
#include "sweepkit/feature/descriptor.hpp"

namespace sweepkit {

inline OrbDescriptor random_descriptor(Random& random) {
  OrbDescriptor d;
  for (auto& word : d.words) word = random();
  return d;
}

/// A descriptor with up to `bits` bits turned over.
inline OrbDescriptor disturbed(Random& random, OrbDescriptor d, int bits) {
  const auto count = random.index(static_cast<std::uint64_t>(bits) + 1);
  for (std::uint64_t i = 0; i < count; ++i) {
    const auto bit = random.index(256);
    d.words[bit / 64] ^= std::uint64_t{1} << bit % 64;
  }
  return d;
}

/// Key points anywhere in an image of 640x400 px.
inline Features<256> random_features(Random& random, int count, int octaves = 8) {
  Features<256> f;
  for (int i = 0; i < count; ++i) {
    f.keypoints.push_back({.x = static_cast<float>(random.uniform(0, 639)),
                           .y = static_cast<float>(random.uniform(0, 399)),
                           .angle = static_cast<float>(random.uniform(-3.14, 3.14)),
                           .response = 1,
                           .octave = static_cast<std::int32_t>(random.index(octaves))});
    f.descriptors.push_back(random_descriptor(random));
  }
  return f;
}

/// Features of which most resemble one of a, in another order.
inline Features<256> disturbed(Random& random, const Features<256>& a, int count, int bits) {
  Features<256> f = random_features(random, count);
  for (std::size_t i = 0; i < f.size() && a.size() > 0; ++i)
    if (random.uniform() < 0.8)
      f.descriptors[i] = disturbed(random, a.descriptors[random.index(a.size())], bits);
  return f;
}

}  // namespace sweepkit
