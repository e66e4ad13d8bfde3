// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "sweepkit/core/error.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/feature/edge_map.hpp"
#include "sweepkit/feature/impl/lbd_rows.hpp"
#include "sweepkit/feature/segment.hpp"

namespace sweepkit {

using LineDescriptor = BinaryDescriptor<256>;

/// Line band descriptor (L. Zhang, R. Koch, An efficient and robust line segment matching approach based on
/// LBD descriptor and pairwise geometric consistency, JVCI 2013) with bits for numbers. The strip of Bands *
/// BandWidth rows about a segment is cut into bands along it; of each band and its neighbours the gradient,
/// in the frame of the segment, gives eight numbers: mean and spread over the rows of the sums of its
/// positive and negative parts across and along. A bit tells which of two of them is larger, so that contrast
/// and brightness do not matter: nine bits compare the numbers of one band, the others those of near bands.
/// A long segment is sampled at kMaxColumns places along it, which changes little and bounds the time.
/// SIMD and portable paths give identical descriptors. Immutable; any number of threads may use one.
template <int Bands, int BandWidth>
class BasicLbd {
 public:
  static_assert(Bands >= 9 && BandWidth >= 3 && BandWidth % 2 == 1);
  static constexpr int kRows = Bands * BandWidth;
  static constexpr int kMaxColumns = 64;
  static constexpr float kMaxCoordinate = 16384;

  BasicLbd() {
    const double across_sigma = 0.5 * (kRows - 1), band_sigma = BandWidth;
    for (int b = 0; b < Bands; ++b)
      for (int i = 0; i < 3 * BandWidth; ++i) {
        const double from_line = (b - 1) * BandWidth + i - 0.5 * (kRows - 1),
                     from_band = i - 1.5 * BandWidth + 0.5;
        weight_[b][i] =
            static_cast<float>(std::exp(-0.5 * (from_line * from_line / (across_sigma * across_sigma) +
                                                from_band * from_band / (band_sigma * band_sigma))));
      }
  }

  /// Describes a segment given in pixels of the image that `map` was built from; beyond the image its border
  /// is repeated. A segment that is shorter than a pixel, not finite or has a coordinate beyond
  /// kMaxCoordinate gets a descriptor of zeros.
  LineDescriptor describe(const EdgeMap& map, float x1, float y1, float x2, float y2) const;

 private:
  using Band = std::array<float, 8>;

  std::array<std::array<float, 3 * BandWidth>, Bands> weight_;
};

/// The usual descriptor: nine bands of seven rows.
using Lbd = BasicLbd<9, 7>;

template <int Bands, int BandWidth>
LineDescriptor BasicLbd<Bands, BandWidth>::describe(const EdgeMap& map, float x1, float y1, float x2,
                                                    float y2) const {
  LineDescriptor descriptor;
  const auto fits = [](float v) { return std::abs(v) <= kMaxCoordinate; };
  if (map.width() == 0 || !fits(x1) || !fits(y1) || !fits(x2) || !fits(y2)) return descriptor;
  const double dx = x2 - x1, dy = y2 - y1, length = std::sqrt(dx * dx + dy * dy);
  if (!(length >= 1)) return descriptor;

  impl::LbdGrid grid;
  grid.columns = std::clamp((static_cast<int>(length) + 7) / 8 * 8, 8, kMaxColumns);
  grid.rows = kRows;
  const double c = dx / length, s = dy / length, step = length / grid.columns, half = 0.5 * (kRows - 1);
  const auto fixed = [](double v) { return static_cast<std::int32_t>(std::lround(v * 65536)); };
  grid.along_x = fixed(step * c);
  grid.along_y = fixed(step * s);
  grid.across_x = fixed(-s);
  grid.across_y = fixed(c);
  grid.direction_x = static_cast<std::int16_t>(std::lround(c * 16384));
  grid.direction_y = static_cast<std::int16_t>(std::lround(s * 16384));
  grid.x = fixed(x1 + 0.5 * step * c + half * s + 0.5);
  grid.y = fixed(y1 + 0.5 * step * s - half * c + 0.5);
  grid.inside = true;
  for (const int row : {0, grid.rows - 1})
    for (const int column : {0, grid.columns - 1}) {
      const int x = (grid.x + row * grid.across_x + column * grid.along_x) >> 16;
      const int y = (grid.y + row * grid.across_y + column * grid.along_y) >> 16;
      grid.inside = grid.inside && x >= 0 && y >= 0 && x < map.width() && y < map.height();
    }
  std::array<impl::LbdRow, kRows> rows;
  impl::lbd_rows(map.gradient().data, map.gradient().stride, map.width(), map.height(), grid, rows.data());

  std::array<Band, Bands> bands;
  for (int b = 0; b < Bands; ++b) {
    const int first = std::max(0, (b - 1) * BandWidth), last = std::min(kRows, (b + 2) * BandWidth);
    Band sum{};
    for (int r = first; r < last; ++r) {
      const float w = weight_[b][r - (b - 1) * BandWidth];
      const float v[4] = {w * static_cast<float>(rows[r].across), w * static_cast<float>(rows[r].back),
                          w * static_cast<float>(rows[r].along), w * static_cast<float>(rows[r].against)};
      for (int i = 0; i < 4; ++i) {
        sum[i] += v[i];
        sum[4 + i] += v[i] * v[i];
      }
    }
    const float count = static_cast<float>(last - first);
    for (int i = 0; i < 4; ++i) {
      bands[b][i] = sum[i] / count;
      // Its root, the spread, has the same order.
      bands[b][4 + i] = sum[4 + i] / count - bands[b][i] * bands[b][i];
    }
  }
  int bit = 0;
  const auto tell = [&](bool more) {
    if (bit < LineDescriptor::kBits)
      descriptor.words[bit / 64] |= static_cast<std::uint64_t>(more) << (bit % 64), ++bit;
  };
  for (const Band& v : bands) {
    tell(v[0] > v[1]);
    tell(v[2] > v[3]);
    tell(v[0] > v[2]);
    tell(v[0] > v[3]);
    tell(v[1] > v[2]);
    tell(v[1] > v[3]);
    tell(v[2] + v[3] > v[0] + v[1]);
    tell(v[4] > v[5]);
    tell(v[6] > v[7]);
  }
  for (int apart = 1; apart < Bands; ++apart)
    for (int b = 0; b + apart < Bands; ++b)
      for (int i = 0; i < 8; ++i) tell(bands[b][i] > bands[b + apart][i]);
  return descriptor;
}

}  // namespace sweepkit
