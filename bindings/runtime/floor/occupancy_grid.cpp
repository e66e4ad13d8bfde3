// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/occupancy_grid.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sweepkit/floor/impl/cell_walk.hpp"

namespace sweepkit {
namespace {

double odds(double probability) { return std::log(probability / (1.0 - probability)); }

std::int32_t steps(double log_odds) {
  return static_cast<std::int32_t>(std::lround(log_odds * OccupancyGrid::kOne));
}

int block_floor(int cell) {
  return cell >= 0 ? cell / OccupancyGrid::kBlock : -((-cell - 1) / OccupancyGrid::kBlock) - 1;
}

}  // namespace

OccupancyGrid::OccupancyGrid(const OccupancyGridOptions& options) : options_(options) {
  check_options(options);
}

void OccupancyGrid::clear() {
  cells_.clear();
  first_x_ = first_y_ = width_ = height_ = 0;
  full_ = false;
  left_out_ = 0;
}

std::int32_t OccupancyGrid::log_odds(const Vec2<double>& p) const {
  const double x = std::floor(p.x() / options_.cell) - first_x_,
               y = std::floor(p.y() / options_.cell) - first_y_;
  if (!(x >= 0 && y >= 0 && x < width_ && y < height_)) return 0;
  return cells_[static_cast<std::size_t>(y) * width_ + static_cast<std::size_t>(x)];
}

void OccupancyGrid::vote(const FloorScan& scan, const PlanarPose& pose) {
  votes_.clear();
  const double cell = options_.cell;
  double reach = scan.footprint_radius > 0 ? scan.footprint.norm() + scan.footprint_radius : 0.0;
  for (const FloorStretch& s : scan.stretches) reach = std::max(reach, 1e-3 * s.to);
  // A window of cells around the pose; 0 says nothing, a vote for an obstacle is positive, one for the floor
  // negative.
  const double px = pose.x / cell, py = pose.y / cell;
  constexpr double kFarthest = 1e8;  // [cells]
  if (!(std::abs(px) < kFarthest && std::abs(py) < kFarthest)) return;
  const int radius = static_cast<int>(std::ceil(reach / cell)) + 2;
  const int x0 = static_cast<int>(std::floor(px)) - radius, y0 = static_cast<int>(std::floor(py)) - radius;
  const int side = 2 * radius + 1;
  window_.assign(static_cast<std::size_t>(side) * side, 0);
  const auto at = [&](int x, int y) -> std::int32_t& {
    return window_[static_cast<std::size_t>(y - y0) * side + (x - x0)];
  };
  const double sharp = options_.sharp_range;
  for (const FloorStretch& s : scan.stretches) {
    const double bearing = pose.yaw + scan.bearing(s.bearing);
    const double c = std::cos(bearing) / cell, d = std::sin(bearing) / cell;
    const double from = 1e-3 * s.from, to = 1e-3 * s.to;
    if (s.label == FloorLabel::floor) {
      walk_cells(px + from * c, py + from * d, px + to * c, py + to * d, [&](int x, int y, double middle) {
        const double r = from + middle * (to - from);
        const double weight = r <= sharp ? 1.0 : (sharp * sharp) / (r * r);
        std::int32_t& w = at(x, y);
        if (w <= 0) w = std::min(w, -steps(weight * options_.free_evidence));
      });
    } else {
      // The part of the distance's distribution that falls into the cell.
      const double sigma = scan.range_noise * from * from;
      const double weight = std::min(1.0, 0.8 * 0.5 * cell / std::max(sigma, 1e-9));
      std::int32_t& w =
          at(static_cast<int>(std::floor(px + from * c)), static_cast<int>(std::floor(py + from * d)));
      w = std::max(w, steps(weight * options_.occupied_evidence));
    }
  }
  if (scan.footprint_radius > 0) {
    const double c = std::cos(pose.yaw), d = std::sin(pose.yaw);
    const double fx = px + (c * scan.footprint.x() - d * scan.footprint.y()) / cell,
                 fy = py + (d * scan.footprint.x() + c * scan.footprint.y()) / cell;
    const double r = scan.footprint_radius / cell;
    const std::int32_t own = -steps(options_.footprint_evidence);
    for (int y = static_cast<int>(std::floor(fy - r)); y <= static_cast<int>(std::floor(fy + r)); ++y)
      for (int x = static_cast<int>(std::floor(fx - r)); x <= static_cast<int>(std::floor(fx + r)); ++x)
        if (std::hypot(x + 0.5 - fx, y + 0.5 - fy) <= r) at(x, y) = own;
  }
  for (int y = 0; y < side; ++y)
    for (int x = 0; x < side; ++x)
      if (const std::int32_t w = window_[static_cast<std::size_t>(y) * side + x])
        votes_.push_back({x + x0, y + y0, w});
}

void OccupancyGrid::make_room() {
  if (votes_.empty() || full_) return;
  int low_x = std::numeric_limits<int>::max(), low_y = low_x, high_x = -low_x, high_y = -low_x;
  for (const Vote& v : votes_) {
    low_x = std::min(low_x, v.x);
    low_y = std::min(low_y, v.y);
    high_x = std::max(high_x, v.x);
    high_y = std::max(high_y, v.y);
  }
  low_x = block_floor(low_x) * kBlock;
  low_y = block_floor(low_y) * kBlock;
  high_x = (block_floor(high_x) + 1) * kBlock;
  high_y = (block_floor(high_y) + 1) * kBlock;
  if (width_ > 0) {
    low_x = std::min(low_x, first_x_);
    low_y = std::min(low_y, first_y_);
    high_x = std::max(high_x, first_x_ + width_);
    high_y = std::max(high_y, first_y_ + height_);
  }
  const std::int64_t width = static_cast<std::int64_t>(high_x) - low_x,
                     height = static_cast<std::int64_t>(high_y) - low_y;
  if (width == width_ && height == height_) return;
  if (width * height > options_.max_cells) {
    full_ = true;
    return;
  }
  std::vector<std::int32_t> grown(static_cast<std::size_t>(width * height), 0);
  for (int y = 0; y < height_; ++y)
    std::copy_n(cells_.begin() + static_cast<std::ptrdiff_t>(y) * width_, width_,
                grown.begin() + (y + first_y_ - low_y) * width + (first_x_ - low_x));
  cells_.swap(grown);
  first_x_ = low_x;
  first_y_ = low_y;
  width_ = static_cast<int>(width);
  height_ = static_cast<int>(height);
}

void OccupancyGrid::apply(const FloorScan& scan, const PlanarPose& pose, int sign) {
  vote(scan, pose);
  make_room();
  for (const Vote& v : votes_) {
    const std::int64_t x = static_cast<std::int64_t>(v.x) - first_x_,
                       y = static_cast<std::int64_t>(v.y) - first_y_;
    if (x < 0 || y < 0 || x >= width_ || y >= height_)
      left_out_ += sign;
    else
      cells_[static_cast<std::size_t>(y * width_ + x)] += sign * v.log_odds;
  }
}

OccupancyImage OccupancyGrid::image() const {
  int low_x = width_, low_y = height_, high_x = -1, high_y = -1;
  for (int y = 0; y < height_; ++y)
    for (int x = 0; x < width_; ++x)
      if (cells_[static_cast<std::size_t>(y) * width_ + x] != 0) {
        low_x = std::min(low_x, x);
        high_x = std::max(high_x, x);
        low_y = std::min(low_y, y);
        high_y = std::max(high_y, y);
      }
  OccupancyImage image;
  image.cell = options_.cell;
  if (high_x < 0) return image;
  --low_x;
  --low_y;
  const int width = high_x - low_x + 2, height = high_y - low_y + 2;
  image.origin = options_.cell * Vec2<double>(first_x_ + low_x, first_y_ + low_y);
  image.cells.resize(width, height);
  image.cells.fill(OccupancyImage::kUnknown);
  const std::int32_t free_below = steps(odds(options_.free_below)),
                     occupied_above = steps(odds(options_.occupied_above));
  for (int y = 1; y + 1 < height; ++y)
    for (int x = 1; x + 1 < width; ++x) {
      const std::int32_t l = cells_[static_cast<std::size_t>(y + low_y) * width_ + (x + low_x)];
      if (l == 0) continue;
      if (l < free_below) image.cells(x, height - 1 - y) = OccupancyImage::kFree;
      if (l > occupied_above) image.cells(x, height - 1 - y) = OccupancyImage::kOccupied;
    }
  return image;
}

}  // namespace sweepkit
