// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstdint>

#include "sweepkit/core/view.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"

namespace sweepkit {

/// What a disparity image may hold: float in pixels, or int16 in sixteenths of a pixel. Everywhere a value
/// that is not positive (below 1/1024 px), not a number or not finite says that the disparity is not known.
template <class D>
concept DisparityPixel = std::same_as<D, float> || std::same_as<D, std::int16_t>;

/// Pixels that one unit of a disparity image stands for.
template <DisparityPixel D>
inline constexpr float kDisparityUnit = std::same_as<D, float> ? 1.0f : 1.0f / 16;

/// An image of disparities as dense matching gives it.
using DisparityView = View2d<const std::int16_t>;

/// A disparity to expect, linear in the row: that of a floor [px]. Not positive above its horizon, where it
/// counts as 0.
struct DisparityRamp {
  double at_top = 0.0;   ///< in row 0 [px]
  double per_row = 0.0;  ///< [px]

  int sixteenths(int v) const {
    return std::max(0, static_cast<int>(std::lround(16 * (at_top + per_row * v))));
  }
};

/// Whatever turns a raw stereo pair into disparities of the rectified left image: our StereoDisparity, a
/// network, a depth camera whose depth z is written as focal * baseline / z. It offers
///   camera()           the rectified left camera that the disparities belong to
///   match(left, right) a View2d of const float or const int16; may look at memory of the source that the
///                      next call writes over
/// What takes disparities in this toolkit takes either pixel type and asks for nothing else.
template <class S>
concept DisparitySource = requires(S& source, const S& same, GrayView image) {
  { same.camera() } -> std::convertible_to<RectifiedCamera>;
  requires std::convertible_to<decltype(source.match(image, image)), View2d<const float>> ||
      std::convertible_to<decltype(source.match(image, image)), View2d<const std::int16_t>>;
};

}  // namespace sweepkit
