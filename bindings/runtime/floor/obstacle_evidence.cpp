// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// Whether the images show what disparities claim.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>
#include <vector>

#include "sweepkit/floor/obstacles.hpp"

namespace sweepkit {
namespace {

/// How much the images differ around a pixel at a disparity: the mean square difference over a window, the
/// windows' means taken away; negative where the window leaves the right image.
/// @param half the right window is moved down by so many half pixels: -1, 0 or 1
float difference(GrayView left, GrayView right, int u, int v, float disparity, int half = 0) {
  constexpr int kReach = 2, kCount = (2 * kReach + 1) * (2 * kReach + 1);
  const float x = static_cast<float>(u) - disparity;
  const float whole = std::floor(x), part = x - whole;
  const int x0 = static_cast<int>(whole);
  if (u < kReach || v <= kReach || u + kReach >= left.width || v + kReach + 1 >= left.height || x0 < kReach ||
      x0 + kReach + 1 >= right.width)
    return -1;
  float sum = 0, square = 0;
  for (int dy = -kReach; dy <= kReach; ++dy) {
    const std::uint8_t* l = left.row(v + dy) + u;
    const std::uint8_t* r = right.row(v + dy) + x0;
    const std::uint8_t* s = right.row(v + dy + half) + x0;
    for (int dx = -kReach; dx <= kReach; ++dx) {
      const float here = 0.5f * static_cast<float>(r[dx] + s[dx]);
      const float next = 0.5f * static_cast<float>(r[dx + 1] + s[dx + 1]);
      const float d = static_cast<float>(l[dx]) - (here * (1 - part) + next * part);
      sum += d;
      square += d * d;
    }
  }
  return (square - sum * sum / kCount) / kCount;
}

/// Sums of the squares of an image's differences along the rows and across them, over a window.
Vec2<double> steepness(GrayView image, int u, int v) {
  constexpr int kReach = 2;
  Vec2<double> sum = Vec2<double>::Zero();
  for (int y = std::max(v - kReach, 1); y <= std::min(v + kReach, image.height - 2); ++y)
    for (int x = std::max(u - kReach, 1); x <= std::min(u + kReach, image.width - 2); ++x) {
      const double along = image(x + 1, y) - image(x - 1, y), across = image(x, y + 1) - image(x, y - 1);
      sum += Vec2<double>(along * along, across * across);
    }
  return sum;
}

/// The least of a parabola through the values at -1/2, 0 and 1/2, looked for up to kReach; not negative.
/// Rows of both images never meet exactly, and along an edge that runs nearly level a part of a row is worth
/// any disparity.
template <class T>
T least_over_rows(const std::array<T, 3>& values) {
  constexpr T kReach = T(0.75);
  const T slope = values[2] - values[0], curvature = 2 * (values[2] + values[0] - 2 * values[1]);
  if (!(curvature > 0)) return *std::min_element(values.begin(), values.end());
  const T at = std::clamp(-slope / (2 * curvature), -kReach, kReach);
  return std::max(values[1] + at * (slope + at * curvature), T(0));
}

}  // namespace

ObstacleFinder::Evidence ObstacleFinder::evidence(const std::vector<Pixel>& pixels, ObstacleKind kind) const {
  if (left_.empty()) return Evidence::clear;
  constexpr std::size_t kMost = 200;    // pixels that are tested
  constexpr double kLeastShare = 0.25;  // of them that must have the floor's partner in the right image
  // Surfaces without interest, and those that would be if the floor lay off its plane by the margin: part of
  // the height, and part of the margin.
  constexpr std::size_t kInner = 4, kMostLevels = 16, kCarpets = 8;
  constexpr double kStep = 0.5;  // px
  const auto steps = static_cast<std::size_t>(
      std::clamp(std::ceil(margin_ / kStep), 1.0, static_cast<double>(kMostLevels - kInner - 2)));
  const bool hole = kind == ObstacleKind::hole;
  // A carpet with a pattern that repeats can be taken for a hole.
  const std::size_t flats = kInner + 2 + steps, levels = flats + (hole ? kCarpets : 0);
  std::array<std::pair<double, double>, kMostLevels + kCarpets> level{
      {{0, 0}, {0.25, 0}, {0.5, 0}, {0.75, 0}, {0, -1}}};
  for (std::size_t k = 0; k <= steps; ++k)
    level[kInner + 1 + k] = {1.0, static_cast<double>(k) / static_cast<double>(steps)};
  const double highest = hole ? -options_.hole_depth : options_.min_height;
  for (std::size_t k = flats; k < levels; ++k)
    level[k] = {options_.min_height / highest * static_cast<double>(k + 1 - flats) / kCarpets, 0.0};
  const std::size_t stride = (pixels.size() + kMost - 1) / kMost;
  // Noise of both images.
  const double noise = 2 * options_.image_noise * options_.image_noise;
  double measured = 0;
  Vec2<double> steep = Vec2<double>::Zero();
  std::size_t tried = 0, complete = 0;
  std::array<double, kMostLevels + kCarpets> flat{};                 // the rows chosen for each pixel
  std::array<std::array<double, 3>, kMostLevels + kCarpets> rows{};  // for all together
  for (std::size_t i = 0; i < pixels.size(); i += stride) {
    const Pixel& p = pixels[i];
    const float own = difference(left_, right_, p.u, p.v, p.disparity);
    if (own < 0) continue;
    ++tried;
    std::array<std::array<float, 3>, kMostLevels + kCarpets> other;
    bool inside = true;
    for (std::size_t k = 0; k < levels && inside; ++k) {
      const double d = floor_(p.u, p.v) * plane_.height / (plane_.height - highest * level[k].first) +
                       (hole ? -margin_ : margin_) * level[k].second;
      for (int j = -1; j <= 1; ++j) {
        float& value = other[k][static_cast<std::size_t>(j + 1)];
        value = difference(left_, right_, p.u, p.v, static_cast<float>(d), j);
        inside = inside && value >= 0;
      }
    }
    if (!inside) continue;
    ++complete;
    measured += own + noise;
    steep += steepness(left_, p.u, p.v);
    for (std::size_t k = 0; k < levels; ++k) {
      flat[k] += least_over_rows(other[k]) + noise;
      for (std::size_t j = 0; j < 3; ++j) rows[k][j] += other[k][j] + noise;
    }
  }
  // Without the floor's partner nothing tells what stands on it from the floor.
  if (complete == 0 || static_cast<double>(complete) < kLeastShare * static_cast<double>(tried))
    return hole ? Evidence::none : Evidence::faint;
  double inner = std::numeric_limits<double>::infinity(), all = inner;
  for (std::size_t k = 0; k < levels; ++k) {
    if (k < kInner || k >= flats) inner = std::min(inner, least_over_rows(rows[k]));
    all = std::min(all, flat[k]);
  }
  if (measured > options_.likeness * inner) return Evidence::none;
  // Where all edges run nearly level, a quarter of a row is worth a pixel of disparity and more.
  const double least = std::tan(options_.clear_angle * std::numbers::pi / 180);
  const bool upright = steep.x() >= least * least * steep.y();
  return upright && measured <= options_.likeness * all ? Evidence::clear : Evidence::faint;
}

}  // namespace sweepkit
