// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>

namespace sweepkit {

/// A rectangle of values that somebody else owns, row by row; rows may be padded. Cheap to copy.
/// `View2d<const T>` cannot write.
template <class T>
struct View2d {
  T* data = nullptr;
  int width = 0;              ///< [pixels]
  int height = 0;             ///< [pixels]
  std::ptrdiff_t stride = 0;  ///< from a row to the next [elements]

  constexpr View2d() = default;
  constexpr View2d(T* data, int width, int height, std::ptrdiff_t stride)
      : data(data), width(width), height(height), stride(stride) {}
  constexpr View2d(T* data, int width, int height) : View2d(data, width, height, width) {}
  constexpr operator View2d<const T>() const { return {data, width, height, stride}; }

  constexpr bool empty() const { return width <= 0 || height <= 0; }
  constexpr T* row(int y) const { return data + y * stride; }
  constexpr T& operator()(int x, int y) const { return row(y)[x]; }
};

/// An 8-bit grey image.
using GrayView = View2d<const std::uint8_t>;

}  // namespace sweepkit
