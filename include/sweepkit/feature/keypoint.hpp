// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

namespace sweepkit {

/// A corner found in an image pyramid.
struct KeyPoint {
  float x = 0;              ///< column in the full-size image, centre of the first pixel at 0 [px]
  float y = 0;              ///< row [px]
  float angle = 0;          ///< orientation, from the x axis towards the y axis [rad], in (-pi, pi]
  float response = 0;       ///< corner score, larger is stronger
  std::int32_t octave = 0;  ///< pyramid level it was found in, 0 the full image
};

}  // namespace sweepkit
