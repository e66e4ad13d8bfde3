// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstdint>
#include <type_traits>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/view.hpp"
#include "sweepkit/feature/impl/edge_rows.hpp"
#include "sweepkit/image/image.hpp"

namespace sweepkit {

/// Pixels that an EdgeMap reads. 8 bits: grey levels. 16 bits: the whole range stands for 255 grey levels;
/// shift the values of cameras with fewer bits up. float: grey levels, cut to [0, 255], not-a-number is 0.
template <class P>
concept EdgePixel = std::same_as<P, std::uint8_t> || std::same_as<P, std::uint16_t> || std::same_as<P, float>;

/// Gradient of a smoothed image (binomial 5x5, then Sobel 3x3) and its ridges: pixels where the gradient is
/// longest across the edge. Integers throughout: portable and SIMD paths are identical. The image's border is
/// repeated outside. Keeps its memory between images.
class EdgeMap {
 public:
  static constexpr int kUnit = 128;         ///< gradient() and magnitude() of one grey level per pixel
  static constexpr double kNoRidges = 1e9;  ///< a threshold that no gradient reaches
  static constexpr int kMargin = 2;         ///< ridges lie at least so far from the sides [px]

  /// @param threshold least gradient of a ridge [grey levels / px], positive
  template <EdgePixel Pixel>
  void build(View2d<const Pixel> image, double threshold) {
    require(std::isfinite(threshold) && threshold > 0, "EdgeMap::build threshold", "must be positive",
            threshold);
    width_ = std::max(image.width, 0);
    height_ = std::max(image.height, 0);
    if (width_ < 2 * kMargin + 1 || height_ < 2 * kMargin + 1) width_ = height_ = 0;
    if (width_ == 0) return;
    const std::ptrdiff_t stride = width_ + 2 * impl::kEdgeLanes;
    gradient_.resize(width_, height_, stride);
    gx_.resize(width_, 2, stride);
    gy_.resize(width_, 2, stride);
    magnitude_.resize(width_, height_, stride);
    ridge_.resize(width_, height_, stride);
    along_.resize(width_, 5, stride);
    smooth_.resize(width_, 3, stride);
    const int least = static_cast<int>(std::min(std::ceil(threshold * kUnit), 32767.0));
    int next_along = 0, next_smooth = 0;
    for (int y = 0; y < height_; ++y) {
      for (; next_along < std::min(y + 4, height_); ++next_along)
        smooth_along(image.row(next_along), along_.row(next_along % 5));
      for (; next_smooth < std::min(y + 2, height_); ++next_smooth) smooth_across(next_smooth);
      impl::sobel_row(smooth_row(y - 1), smooth_row(y), smooth_row(y + 1), width_, gx_.row(y % 2),
                      gy_.row(y % 2), gradient_.row(y), magnitude_.row(y));
      if (y - 1 >= kMargin && y - 1 < height_ - kMargin) mark_ridges(y - 1, least);
    }
    for (int y : {0, 1, height_ - 2, height_ - 1}) std::fill_n(ridge_.row(y), width_, std::uint8_t{0});
  }

  int width() const { return width_; }
  int height() const { return height_; }

  /// [1 / kUnit grey levels / px]
  View2d<const impl::EdgeGradient> gradient() const { return gradient_.view(); }
  View2d<const std::uint16_t> magnitude() const { return magnitude_.view(); }
  /// 0, impl::kSteepRidge or impl::kShallowRidge. Who follows ridges may clear what it has visited.
  View2d<std::uint8_t> ridge() { return ridge_.view(); }

 private:
  template <class Pixel>
  void smooth_along(const Pixel* source, std::uint16_t* target) {
    if constexpr (std::is_same_v<Pixel, std::uint8_t>) {
      impl::binomial_5_bytes(source, width_, target);
    } else {
      fixed_.resize(static_cast<std::size_t>(width_) + 4 + 2 * impl::kEdgeLanes);
      std::uint16_t* row = fixed_.data() + 2;
      for (int x = 0; x < width_; ++x) row[x] = to_fixed(source[x]);
      row[-2] = row[-1] = row[0];
      row[width_] = row[width_ + 1] = row[width_ - 1];
      const std::uint16_t* shifted[5];
      for (int i = 0; i < 5; ++i) shifted[i] = row + i - 2;
      impl::binomial_5_rows(shifted, width_, target);
    }
  }

  /// Grey levels with four fractional bits.
  static std::uint16_t to_fixed(std::uint16_t pixel) {
    return static_cast<std::uint16_t>((pixel * 4080u + 32767u) / 65535u);
  }
  static std::uint16_t to_fixed(float pixel) {
    return static_cast<std::uint16_t>((pixel > 0 ? std::min(pixel, 255.0f) : 0.0f) * 16.0f + 0.5f);
  }

  void smooth_across(int y) {
    const std::uint16_t* rows[5];
    for (int i = 0; i < 5; ++i) rows[i] = along_.row(std::clamp(y + i - 2, 0, height_ - 1) % 5);
    std::uint16_t* target = smooth_.row(y % 3) + impl::kEdgeLanes;  // room for column -1
    impl::binomial_5_rows(rows, width_, target);
    target[-1] = target[0];
    target[width_] = target[width_ - 1];
  }

  const std::uint16_t* smooth_row(int y) const {
    return smooth_.row(std::clamp(y, 0, height_ - 1) % 3) + impl::kEdgeLanes;
  }

  void mark_ridges(int y, int threshold) {
    std::uint8_t* ridge = ridge_.row(y);
    impl::ridge_row(magnitude_.row(y - 1), magnitude_.row(y), magnitude_.row(y + 1), gx_.row(y % 2),
                    gy_.row(y % 2), width_, threshold, ridge);
    std::fill_n(ridge, kMargin, std::uint8_t{0});
    std::fill_n(ridge + width_ - kMargin, kMargin + 8, std::uint8_t{0});
  }

  int width_ = 0, height_ = 0;
  Image<impl::EdgeGradient> gradient_;
  Image<std::int16_t> gx_, gy_;  // of two rows
  Image<std::uint16_t> magnitude_, along_, smooth_;
  Image<std::uint8_t> ridge_;
  std::vector<std::uint16_t> fixed_;
};

}  // namespace sweepkit
