// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <vector>

#include "sweepkit/core/view.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/feature/orb_pattern.hpp"

namespace sweepkit {

/// Rotated BRIEF: compares pairs of pixels of a smoothed image around a key point, the pattern turned by the
/// key point's angle. Angles are taken to the nearest of kAngles; the turned patterns are kept as offsets for
/// one row stride, so that all levels of a pyramid share them.
template <PairPattern Pattern = OrbPattern>
class RotatedBrief {
 public:
  static constexpr int kBits = Pattern::kBits;
  static constexpr int kWords = kBits / 64;
  static constexpr int kAngles = 128;

  /// No turned pattern reaches further from its centre [px].
  static constexpr int radius() {
    int largest = 0;
    for (const PixelPair& p : Pattern::kPairs)
      largest = std::max({largest, p.x1 * p.x1 + p.y1 * p.y1, p.x2 * p.x2 + p.y2 * p.y2});
    int r = 0;
    while (r * r < largest) ++r;
    return r;
  }

  /// Makes the turned patterns for images of this stride; does nothing if they are there.
  void prepare(std::ptrdiff_t stride) {
    if (stride == stride_) return;
    offsets_.resize(static_cast<std::size_t>(kAngles) * 2 * kBits);
    auto* out = offsets_.data();
    for (int a = 0; a < kAngles; ++a) {
      const double angle = 2 * std::numbers::pi * a / kAngles;
      const double c = std::cos(angle), s = std::sin(angle);
      const auto turned = [&](int x, int y) {
        return static_cast<std::int32_t>(std::lround(s * x + c * y) * stride + std::lround(c * x - s * y));
      };
      for (int bit = 63; bit >= 0; --bit)
        for (int word = 0; word < kWords; ++word) {
          const PixelPair& p = Pattern::kPairs[word * 64 + bit];
          *out++ = turned(p.x1, p.y1);
          *out++ = turned(p.x2, p.y2);
        }
    }
    stride_ = stride;
  }

  /// The descriptor at (x, y), at least radius() from the sides; prepare() came before with the image's
  /// stride.
  /// @param smoothed the image, smoothed
  /// @param angle [rad], any turn
  BinaryDescriptor<kBits> describe(GrayView smoothed, int x, int y, float angle) const {
    constexpr float kStep = kAngles / (2 * std::numbers::pi_v<float>);
    const int index = static_cast<int>(std::lround(angle * kStep)) & (kAngles - 1);
    const std::int32_t* offset = offsets_.data() + static_cast<std::size_t>(index) * 2 * kBits;
    const std::uint8_t* centre = smoothed.row(y) + x;
    BinaryDescriptor<kBits> descriptor;
    // All words grow at once, highest bit first: independent chains of compare and add-with-carry.
    for (int bit = 0; bit < 64; ++bit, offset += 2 * kWords) {
#pragma GCC unroll 8
      for (int w = 0; w < kWords; ++w) {
        auto& word = descriptor.words[w];
        word = word + word + (centre[offset[2 * w]] < centre[offset[2 * w + 1]]);
      }
    }
    return descriptor;
  }

 private:
  static_assert((kAngles & (kAngles - 1)) == 0, "angles wrap around by a mask");
  std::vector<std::int32_t> offsets_;
  std::ptrdiff_t stride_ = 0;
};

}  // namespace sweepkit
