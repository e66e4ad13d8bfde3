// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "sweepkit/data/scene.hpp"

namespace sweepkit {

/// A grey texture that repeats in both directions, with all its half sizes (Williams, Pyramidal parametrics,
/// 1983). Values are albedo in 1/65535.
class Texture {
 public:
  /// @param values size x size, a power of two, row by row
  /// @param period what the texture spans in both directions [m]
  Texture(const std::vector<float>& values, int size, float period);

  float period() const { return period_; }
  int size() const { return size_; }
  float mean() const { return levels_.back().texels.front() * (1.0f / 65535.0f); }

  /// The mean of `probes` values about u, v [periods], spread evenly over (du, dv), each filtered to the
  /// level `lod` (0: full size; in between: blended).
  float sample(float u, float v, float du, float dv, int probes, float lod) const {
    lod = std::clamp(lod, 0.0f, static_cast<float>(levels_.size() - 1));
    const int index = static_cast<int>(lod);
    const float share = lod - static_cast<float>(index);
    const float step = 1.0f / static_cast<float>(probes);
    const float first = 0.5f * step - 0.5f;
    const auto sum = [&](const Level& level) {
      const auto size = static_cast<float>(level.size);
      float x = (u + first * du) * size - 0.5f, y = (v + first * dv) * size - 0.5f;
      const float sx = step * du * size, sy = step * dv * size;
      float total = 0;
      for (int i = 0; i < probes; ++i, x += sx, y += sy) total += bilinear(level, x, y);
      return total;
    };
    const Level& fine = levels_[static_cast<std::size_t>(index)];
    float total = sum(fine);
    if (share > 0.0f) total += share * (sum(levels_[static_cast<std::size_t>(index) + 1]) - total);
    return total * step * (1.0f / 65535.0f);
  }

 private:
  struct Level {
    int size;
    std::vector<std::uint16_t> texels;
  };

  /// Between the texels around (x, y) of a level [texels].
  static float bilinear(const Level& level, float x, float y) {
    // Down to whole numbers, also below zero; std::floor is a call on baseline x86.
    int ix = static_cast<int>(x), iy = static_cast<int>(y);
    ix -= static_cast<float>(ix) > x;
    iy -= static_cast<float>(iy) > y;
    const float ax = x - static_cast<float>(ix), ay = y - static_cast<float>(iy);
    const int mask = level.size - 1;
    const int x0 = ix & mask, x1 = (x0 + 1) & mask;
    const int y0 = iy & mask, y1 = (y0 + 1) & mask;
    const std::uint16_t* top =
        level.texels.data() + static_cast<std::size_t>(y0) * static_cast<std::size_t>(level.size);
    const std::uint16_t* bottom =
        level.texels.data() + static_cast<std::size_t>(y1) * static_cast<std::size_t>(level.size);
    const float a = static_cast<float>(top[x0]) + ax * static_cast<float>(top[x1] - top[x0]);
    const float b = static_cast<float>(bottom[x0]) + ax * static_cast<float>(bottom[x1] - bottom[x0]);
    return a + ay * (b - a);
  }

  int size_;
  float period_;
  std::vector<Level> levels_;
};

/// Fine structure laid over textures, below their texels.
enum class Detail : std::uint8_t { none, grain, fibre, cloth };

/// A material made ready to be looked up.
struct Skin {
  std::shared_ptr<const Texture> texture;
  Detail detail = Detail::none;
  float detail_strength = 0.0f;  ///< relative
  int columns = 0, rows = 0;     ///< of single pictures in the texture; 0: a continuous pattern
  bool along_longest = false;    ///< its u axis follows the longer side of what it covers
};

/// Made once for each material and shared by all that ask while anybody holds it.
Skin make_skin(const Material& material);
/// Values about 0.5, relative: 1 doubles. Null for none.
std::shared_ptr<const Texture> detail_texture(Detail detail);

}  // namespace sweepkit
