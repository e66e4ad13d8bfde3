// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <png.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <numbers>
#include <string>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/view.hpp"

namespace sweepkit {

using Color = std::array<std::uint8_t, 3>;

/// A grey image in colour, to be drawn on.
class Canvas {
 public:
  /// @param brightness multiplies the image, so that what is drawn stands out
  explicit Canvas(GrayView image, double brightness = 1.0) : width_(image.width), height_(image.height) {
    pixels_.reserve(static_cast<std::size_t>(width_) * height_ * 3);
    for (int y = 0; y < height_; ++y)
      for (int x = 0; x < width_; ++x)
        pixels_.insert(pixels_.end(), 3, static_cast<std::uint8_t>(brightness * image(x, y)));
  }

  void dot(double x, double y, const Color& color) {
    for (int dy = 0; dy < 2; ++dy)
      for (int dx = 0; dx < 2; ++dx)
        set(static_cast<int>(std::floor(x)) + dx, static_cast<int>(std::floor(y)) + dy, color);
  }
  void circle(double x, double y, double radius, const Color& color) {
    const int steps = static_cast<int>(8 * radius);
    for (int i = 0; i < steps; ++i) {
      const double angle = 2 * std::numbers::pi * i / steps;
      set(static_cast<int>(std::lround(x + radius * std::cos(angle))),
          static_cast<int>(std::lround(y + radius * std::sin(angle))), color);
    }
  }
  void line(double x1, double y1, double x2, double y2, const Color& color) {
    const int steps = static_cast<int>(std::ceil(std::max({std::abs(x2 - x1), std::abs(y2 - y1), 1.0})));
    for (int i = 0; i <= steps; ++i) {
      const double s = static_cast<double>(i) / steps;
      const int x = static_cast<int>(std::lround(x1 + s * (x2 - x1)));
      const int y = static_cast<int>(std::lround(y1 + s * (y2 - y1)));
      set(x, y, color);
      // Two pixels thick, across the line.
      std::abs(x2 - x1) > std::abs(y2 - y1) ? set(x, y + 1, color) : set(x + 1, y, color);
    }
  }

  /// @throws Error(io) if the file cannot be written
  void write(const std::filesystem::path& file) const {
    png_image png{};
    png.version = PNG_IMAGE_VERSION;
    png.width = static_cast<png_uint_32>(width_);
    png.height = static_cast<png_uint_32>(height_);
    png.format = PNG_FORMAT_RGB;
    if (!png_image_write_to_file(&png, file.c_str(), 0, pixels_.data(), 0, nullptr))
      throw Error(ErrorKind::io, file.string(), std::string("cannot be written: ") + png.message);
  }

 private:
  void set(int x, int y, const Color& color) {
    if (x < 0 || y < 0 || x >= width_ || y >= height_) return;
    for (int k = 0; k < 3; ++k) pixels_[(static_cast<std::size_t>(y) * width_ + x) * 3 + k] = color[k];
  }

  int width_, height_;
  std::vector<std::uint8_t> pixels_;
};

}  // namespace sweepkit
