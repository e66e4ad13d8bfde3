// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "sweepkit/feature/descriptor.hpp"

namespace sweepkit {

/// A straight edge found in an image. It runs from (x1, y1) to (x2, y2) with its dark side on the left hand,
/// seen as the image is displayed (y down): on a dark ceiling above a bright wall it runs to the right.
/// Coordinates are those of the full-size image, centre of the first pixel at (0, 0).
struct LineSegment {
  float x1 = 0;  ///< start, to a part of a pixel [px]
  float y1 = 0;
  float x2 = 0;  ///< end [px]
  float y2 = 0;
  float width = 0;          ///< spread of the edge points about the line, twice their standard deviation [px]
  float contrast = 0;       ///< mean gradient across the edge [grey levels / px]
  float response = 0;       ///< -log10 of the expected number of false alarms: larger is surer
  std::int32_t octave = 0;  ///< pyramid level it was found in, 0 the full image

  float dx() const { return x2 - x1; }
  float dy() const { return y2 - y1; }
  float length() const { return std::hypot(dx(), dy()); }
  /// From the x axis towards the y axis [rad], in [-pi, pi].
  float angle() const { return std::atan2(dy(), dx()); }

  friend bool operator==(const LineSegment&, const LineSegment&) = default;
};

/// Segments of one image and their descriptors, index by index.
template <int Bits = 256>
struct LineFeatures {
  std::vector<LineSegment> segments;
  std::vector<BinaryDescriptor<Bits>> descriptors;

  std::size_t size() const { return segments.size(); }
  void clear() {
    segments.clear();
    descriptors.clear();
  }
};

}  // namespace sweepkit
