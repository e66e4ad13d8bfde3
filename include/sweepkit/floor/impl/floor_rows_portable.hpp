// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "sweepkit/core/error.hpp"
#include "sweepkit/floor/floor_tolerance.hpp"
#include "sweepkit/image/disparity.hpp"

namespace sweepkit::impl {

/// The floor's disparity along a row and how far a disparity may lie off it, in single precision and in units
/// of the disparity image, the same for all kernels.
struct FloorRow {
  float at_zero, along_u;  // the floor's disparity
  float base, slope;       // of the noise
  float above, below;      // parts of the floor's disparity that are too low to matter
};

class FloorRows {
 public:
  /// @param unit pixels that one unit of the disparity image stands for, a power of two
  FloorRows(const FloorDisparity& floor, const FloorTolerance& t, float unit)
      : floor_(floor),
        per_pixel_(1.0f / unit),
        row_{0,
             static_cast<float>(floor.along_u) * per_pixel_,
             static_cast<float>(t.base) * per_pixel_,
             static_cast<float>(t.slope),
             static_cast<float>(t.above),
             static_cast<float>(t.below)} {
    const double sum = floor.at_origin + floor.along_u + floor.along_v + t.base + t.slope + t.above + t.below;
    require(std::isfinite(sum), "FloorDisparity, FloorTolerance", "must be finite", sum);
  }

  FloorRow row(int v) const {
    FloorRow r = row_;
    r.at_zero = static_cast<float>(floor_.at_origin + floor_.along_v * v) * per_pixel_;
    return r;
  }

 private:
  FloorDisparity floor_;
  float per_pixel_;
  FloorRow row_;
};

/// From a pixel and its disparity, in units of the image, to a point.
struct CloudRow {
  float baseline, focal, cx;  // baseline in units of the image, too
  float y;                    // v - cy
};

/// Three coordinates of a row of pixels.
struct PlaneRows {
  float *x, *y, *z;
};

/// For each FloorLabel, whether its pixels become points: 0 or ~0.
struct ChosenLabels {
  alignas(32) std::int32_t of_label[8] = {};
};

// The larger as vector instructions take it: the second unless the first is truly beyond.
inline float larger(float a, float b) { return a > b ? a : b; }

/// Less is no disparity: its point would lie beyond all numbers. In units of the image.
inline constexpr float kLeastDisparity = 1.0f / 1024;

/// The label of a disparity in column u, both in units of the image.
inline FloorLabel floor_label(float d, int u, const FloorRow& r) {
  const float f = larger(r.at_zero + r.along_u * static_cast<float>(u), 0.0f);
  const float off = d - f;
  const float allowed = larger(f * r.slope + r.base, f * (off < 0 ? r.below : r.above));
  if (!(d >= kLeastDisparity && d <= std::numeric_limits<float>::max())) return FloorLabel::unknown;
  if (std::fabs(off) > allowed) return off < 0 ? FloorLabel::hole : FloorLabel::obstacle;
  return f > 0 ? FloorLabel::floor : FloorLabel::unknown;
}

template <DisparityPixel D>
inline void mask_row_portable(const D* disparity, int from, int width, const FloorRow& row,
                              std::uint8_t* mask) {
  for (int u = from; u < width; ++u)
    mask[u] = static_cast<std::uint8_t>(floor_label(static_cast<float>(disparity[u]), u, row));
}

template <DisparityPixel D>
inline void planes_row_portable(const D* disparity, int from, int width, const FloorRow& row,
                                const CloudRow& cloud, const ChosenLabels& chosen, std::uint8_t* mask,
                                const PlaneRows& to) {
  constexpr float kNan = std::bit_cast<float>(~std::uint32_t{0});
  for (int u = from; u < width; ++u) {
    const float d = static_cast<float>(disparity[u]);
    mask[u] = static_cast<std::uint8_t>(floor_label(d, u, row));
    const bool is_point = chosen.of_label[mask[u]] != 0;
    const float scale = cloud.baseline / d;
    to.x[u] = is_point ? scale * (static_cast<float>(u) - cloud.cx) : kNan;
    to.y[u] = is_point ? scale * cloud.y : kNan;
    to.z[u] = is_point ? scale * cloud.focal : kNan;
  }
}

/// Writes the disparities of a row's points and their pixels, first_pixel + u; returns their number.
template <DisparityPixel D>
inline std::size_t gather_row_portable(const D* disparity, int from, int width, const FloorRow& row,
                                       const ChosenLabels& chosen, std::int32_t first_pixel,
                                       std::uint8_t* mask, float* found, std::int32_t* pixels) {
  std::size_t count = 0;
  for (int u = from; u < width; ++u) {
    const float d = static_cast<float>(disparity[u]);
    mask[u] = static_cast<std::uint8_t>(floor_label(d, u, row));
    found[count] = d;
    pixels[count] = first_pixel + u;
    count += chosen.of_label[mask[u]] != 0;
  }
  return count;
}

/// The points of what gather_row found, as x y z one after the other.
inline void points_portable(const float* found, const std::int32_t* pixels, std::size_t count,
                            std::int32_t first_pixel, const CloudRow& cloud, float* xyz) {
  for (std::size_t i = 0; i < count; ++i) {
    const float scale = cloud.baseline / found[i];
    xyz[3 * i] = scale * (static_cast<float>(pixels[i] - first_pixel) - cloud.cx);
    xyz[3 * i + 1] = scale * cloud.y;
    xyz[3 * i + 2] = scale * cloud.focal;
  }
}

}  // namespace sweepkit::impl
