// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/image/image.hpp"
#include "sweepkit/image/resize.hpp"

namespace sweepkit {

/// An image in several sizes, each a bilinear resize of the one before. Owns all levels (level 0 is a copy)
/// and keeps its memory from frame to frame. Levels have no border: who reads patches stays inside, or
/// clamps.
///
/// All levels have the same stride, so that an offset in elements means the same shift in each.
class ImagePyramid {
 public:
  static constexpr int kMaxLevels = 32;

  /// Builds all levels. Level l has round(width / factor^l) columns, rows alike, but at least one; the size
  /// rounded to whole pixels sets the true ratio, see scale_x().
  /// @param levels 1 to kMaxLevels
  /// @param factor size of a level against the next, above 1
  void build(GrayView image, int levels, double factor) {
    require(!image.empty(), "ImagePyramid::build", "the image is empty", image.width);
    require(levels >= 1 && levels <= kMaxLevels, "ImagePyramid::build", "levels out of range", levels);
    require(std::isfinite(factor) && factor > 1, "ImagePyramid::build", "the factor must exceed 1", factor);
    if (levels_.size() < static_cast<std::size_t>(levels)) {
      levels_.resize(levels);
      resizers_.resize(levels);
    }
    count_ = levels;
    factor_ = factor;
    double scale = 1;
    for (int l = 0; l < levels; ++l, scale *= factor) {
      const int width = std::max(1, static_cast<int>(std::lround(image.width / scale)));
      const int height = std::max(1, static_cast<int>(std::lround(image.height / scale)));
      levels_[l].image.resize(width, height, image.width);
      levels_[l].scale = static_cast<float>(scale);
      levels_[l].scale_x = static_cast<float>(static_cast<double>(image.width) / width);
      levels_[l].scale_y = static_cast<float>(static_cast<double>(image.height) / height);
      if (l == 0)
        for (int y = 0; y < height; ++y) std::copy_n(image.row(y), width, levels_[0].image.row(y));
      else
        resizers_[l](levels_[l - 1].image, levels_[l].image.view());
    }
  }

  int levels() const { return count_; }
  double factor() const { return factor_; }
  bool empty() const { return count_ == 0; }
  GrayView level(int l) const { return levels_[l].image.view(); }
  std::ptrdiff_t stride() const { return levels_[0].image.stride(); }  ///< of all levels [elements]

  /// Nominal size of a pixel of level l in pixels of level 0: factor^l.
  float scale(int l) const { return levels_[l].scale; }
  /// The true horizontal ratio, width of level 0 / width of level l.
  float scale_x(int l) const { return levels_[l].scale_x; }
  float scale_y(int l) const { return levels_[l].scale_y; }

  /// Coordinates of level l to those of level 0 and back; pixel centres are at whole numbers in both.
  float to_full_x(int l, float x) const { return (x + 0.5f) * levels_[l].scale_x - 0.5f; }
  float to_full_y(int l, float y) const { return (y + 0.5f) * levels_[l].scale_y - 0.5f; }
  float to_level_x(int l, float x) const { return (x + 0.5f) / levels_[l].scale_x - 0.5f; }
  float to_level_y(int l, float y) const { return (y + 0.5f) / levels_[l].scale_y - 0.5f; }

 private:
  struct Level {
    GrayImage image;
    float scale = 1;
    float scale_x = 1;
    float scale_y = 1;
  };

  std::vector<Level> levels_;
  std::vector<BilinearResizer> resizers_;
  int count_ = 0;
  double factor_ = 1;
};

}  // namespace sweepkit
