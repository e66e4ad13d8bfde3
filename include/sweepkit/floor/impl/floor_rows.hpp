// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>

#include "sweepkit/core/simd.hpp"
#include "sweepkit/floor/impl/floor_rows_avx2.hpp"
#include "sweepkit/floor/impl/floor_rows_portable.hpp"
#include "sweepkit/image/disparity.hpp"

namespace sweepkit::impl {

template <DisparityPixel D>
inline void mask_row(const D* disparity, int width, const FloorRow& row, std::uint8_t* mask) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return mask_row_avx2(disparity, width, row, mask);
#endif
  mask_row_portable(disparity, 0, width, row, mask);
}

template <DisparityPixel D>
inline void planes_row(const D* disparity, int width, const FloorRow& row, const CloudRow& cloud,
                       const ChosenLabels& chosen, std::uint8_t* mask, const PlaneRows& to) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) return planes_row_avx2(disparity, width, row, cloud, chosen, mask, to);
#endif
  planes_row_portable(disparity, 0, width, row, cloud, chosen, mask, to);
}

/// What kernels may write beyond the last point, of found and pixels each.
inline constexpr std::size_t kPointSlack = 8;

/// @param found room for width + kPointSlack
/// @param pixels, xyz room for as many points
template <DisparityPixel D>
inline std::size_t points_row(const D* disparity, int width, const FloorRow& row, const CloudRow& cloud,
                              const ChosenLabels& chosen, std::int32_t first_pixel, std::uint8_t* mask,
                              float* found, std::int32_t* pixels, float* xyz) {
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) {
    const std::size_t count =
        gather_row_avx2(disparity, width, row, chosen, first_pixel, mask, found, pixels);
    points_avx2(found, pixels, count, first_pixel, cloud, xyz);
    return count;
  }
#endif
  const std::size_t count =
      gather_row_portable(disparity, 0, width, row, chosen, first_pixel, mask, found, pixels);
  points_portable(found, pixels, count, first_pixel, cloud, xyz);
  return count;
}

}  // namespace sweepkit::impl
