// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "image/random_image.hpp"

namespace sweepkit {

/// Turned by 90 degrees so that (x, y) comes to (height - 1 - y, x): angles grow by 90 degrees.
inline GrayImage turned(GrayView image) {
  GrayImage result(image.height, image.width);
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) result(image.height - 1 - y, x) = image(x, y);
  return result;
}

}  // namespace sweepkit
