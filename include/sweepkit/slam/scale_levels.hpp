// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>

namespace sweepkit {

/// The pyramid in which key points were found, as far as the map cares: what octave shows a point at what
/// distance.
struct ScaleLevels {
  double factor = 1.2;
  int count = 8;

  double scale(int octave) const { return std::pow(factor, octave); }
  double coarsest() const { return scale(count - 1); }

  /// The octave in which a point appears as it did in the full image from `max_distance` away.
  int octave(double max_distance, double distance) const {
    const int octave = static_cast<int>(std::lround(std::log(max_distance / distance) / std::log(factor)));
    return std::clamp(octave, 0, count - 1);
  }
};

}  // namespace sweepkit
