// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/view.hpp"
#include "sweepkit/floor/floor_tolerance.hpp"
#include "sweepkit/floor/ground_plane.hpp"
#include "sweepkit/floor/impl/floor_rows.hpp"
#include "sweepkit/image/disparity.hpp"

namespace sweepkit {

namespace impl {

template <class T>
std::string size_text(View2d<T> view) {
  return std::to_string(view.width) + "x" + std::to_string(view.height) + " px";
}

}  // namespace impl

/// Labels each pixel of a disparity image as a FloorLabel by the floor's disparity there:
///   obstacle  nearer than the floor beyond the tolerance; above the floor's horizon, all that is near enough
///             to tell from infinity
///   hole      farther than the floor beyond the tolerance: a hole or a step down
///   floor     the floor within the tolerance
///   unknown   no disparity, or too far away above the horizon
/// Branch-free; AVX2 and portable kernels agree bit by bit.
/// @param disparity float in pixels or int16 in sixteenths; not positive, infinite and not-a-number: unknown
/// @param mask as large; throws Error(argument), naming both sizes, otherwise, and for a floor or a tolerance
///   that is not finite
template <DisparityPixel D>
void obstacle_mask(View2d<const D> disparity, const FloorDisparity& floor, const FloorTolerance& tolerance,
                   View2d<std::uint8_t> mask) {
  if (mask.width != disparity.width || mask.height != disparity.height)
    throw Error(ErrorKind::argument, "obstacle_mask mask",
                "must be as large as the disparities, " + impl::size_text(disparity), impl::size_text(mask));
  const impl::FloorRows rows(floor, tolerance, kDisparityUnit<D>);
  for (int v = 0; v < disparity.height; ++v)
    impl::mask_row(disparity.row(v), disparity.width, rows.row(v), mask.row(v));
}

}  // namespace sweepkit
