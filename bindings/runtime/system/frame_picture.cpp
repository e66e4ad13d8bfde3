// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/frame_picture.hpp"

#include <png.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

#include "sweepkit/core/error.hpp"

namespace sweepkit {
namespace {

using Color = std::array<std::uint8_t, 3>;
constexpr Color kTracked{40, 230, 60}, kStereo{255, 150, 30}, kAlone{150, 150, 150};

class Canvas {
 public:
  explicit Canvas(GrayView image) : width_(image.width), height_(image.height) {
    pixels_.reserve(static_cast<std::size_t>(width_) * height_ * 3);
    for (int y = 0; y < height_; ++y)
      for (int x = 0; x < width_; ++x) pixels_.insert(pixels_.end(), 3, image(x, y));
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

}  // namespace

void write_frame_picture(const std::filesystem::path& file, const StereoRig& rig, GrayView left,
                         const StereoFrame& frame) {
  Canvas canvas(left);
  // Tracked points last, so that nothing hides them.
  for (const bool tracked : {false, true})
    for (std::size_t i = 0; i < frame.measurements.size(); ++i) {
      const Measurement& m = frame.measurements[i];
      if ((i < frame.points.size() && frame.points[i].valid()) != tracked) continue;
      const auto pixel = rig.unrectify_fast(Side::left, {m.u, m.v});
      if (!pixel) continue;
      if (tracked)
        canvas.circle(pixel->x(), pixel->y(), 2.5 + m.octave, kTracked);
      else
        canvas.dot(pixel->x(), pixel->y(), m.stereo() ? kStereo : kAlone);
    }
  canvas.write(file);
}

}  // namespace sweepkit
