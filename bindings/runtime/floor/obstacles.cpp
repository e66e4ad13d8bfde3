// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/obstacles.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <utility>

#include "sweepkit/core/error.hpp"
#include "sweepkit/floor/floor_tolerance.hpp"

namespace sweepkit {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kPixelSigma = 0.5;  // of a thing's place in the image [px]
constexpr double kTail = 0.02;       // of a thing's points are left out at each side of its box
constexpr double kTopShare = 0.9;    // see ObstacleOptions::min_top
constexpr double kTiltFactor = 3;    // standard deviations of the floor's tilt that may be
constexpr float kSeen = 4;           // a window whose pixel is so far inside the right image is inside [px]
constexpr std::size_t kMostOrder = std::numeric_limits<std::uint16_t>::max() - 1;

/// The value below which a share of the values lies; reorders them.
float quantile(std::vector<float>& values, double share) {
  const auto k = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), values.begin() + k, values.end());
  return values[static_cast<std::size_t>(k)];
}

double half_turn(double angle) {
  while (angle > kPi / 2) angle -= kPi;
  while (angle <= -kPi / 2) angle += kPi;
  return angle;
}

}  // namespace

SE3d floor_frame(const GroundPlane& plane) {
  const Vec3<double> up = -plane.down_camera;
  Vec3<double> forward = Vec3<double>::UnitZ() - up.z() * up;
  if (forward.norm() < 1e-6) forward = -(Vec3<double>::UnitY() - up.y() * up);
  forward.normalize();
  Mat3<double> R_floor_camera;
  R_floor_camera.row(0) = forward;
  R_floor_camera.row(1) = up.cross(forward);
  R_floor_camera.row(2) = up;
  return {SO3d(R_floor_camera), {0, 0, plane.height}};
}

FloorBox moved(const FloorBox& box, const SE3d& T_to_floor) {
  FloorBox result = box;
  const Vec3<double> centre = T_to_floor * Vec3<double>(box.centre.x(), box.centre.y(), 0);
  const Vec3<double> along = T_to_floor.rotation() * Vec3<double>(std::cos(box.yaw), std::sin(box.yaw), 0);
  result.centre = centre.head<2>();
  result.yaw = half_turn(std::atan2(along.y(), along.x()));
  result.bottom += centre.z();
  result.top += centre.z();
  return result;
}

ObstacleFinder::ObstacleFinder(const ObstacleOptions& options) : options_(options) {
  check_options(options_);
}

std::int32_t ObstacleFinder::root(std::int32_t i) {
  while (parents_[static_cast<std::size_t>(i)] != i) {
    std::int32_t& parent = parents_[static_cast<std::size_t>(i)];
    parent = parents_[static_cast<std::size_t>(parent)];
    i = parent;
  }
  return i;
}

template <DisparityPixel D>
void ObstacleFinder::link(View2d<const D> disparity, GrayView mask, ObstacleKind kind) {
  const auto label =
      static_cast<std::uint8_t>(kind == ObstacleKind::hole ? FloorLabel::hole : FloorLabel::obstacle);
  const float focal_baseline = static_cast<float>(camera_.focal * camera_.baseline);
  const float farthest = focal_baseline / static_cast<float>(options_.max_range);
  const float h = static_cast<float>(plane_.height);
  const float gap = static_cast<float>(options_.link_gap) / focal_baseline;
  const float least_step = static_cast<float>(options_.link_disparity);
  const float low = static_cast<float>(options_.min_height), high = static_cast<float>(options_.max_height);
  const float deep = static_cast<float>(-options_.hole_depth);
  const float along_u = static_cast<float>(floor_.along_u);
  const int reach = options_.link_pixels;
  pixels_.clear();
  parents_.clear();
  nodes_.resize(disparity.width, disparity.height);
  for (int v = 0; v < disparity.height; ++v) {
    const float floor_at_zero = static_cast<float>(floor_.at_origin + floor_.along_v * v);
    std::int32_t* nodes = nodes_.row(v);
    std::fill_n(nodes, disparity.width, -1);
    const std::uint8_t* labels = mask.row(v);
    const D* row = disparity.row(v);
    for (int u = 0; u < disparity.width; ++u) {
      if (labels[u] != label) continue;
      const float d = static_cast<float>(row[u]) * kDisparityUnit<D>;
      const float f = floor_at_zero + along_u * static_cast<float>(u);
      const float height = h * (1 - f / d);
      // Where the floor's partner is outside the right image it cannot be found, but others by chance.
      if (kind == ObstacleKind::hole
              ? !(height <= deep && f >= farthest && static_cast<float>(u) - f >= kSeen)
              : !(height >= low && height <= high && d >= farthest))
        continue;
      const auto node = static_cast<std::int32_t>(parents_.size());
      parents_.push_back(node);
      pixels_.push_back({static_cast<std::int16_t>(u), static_cast<std::int16_t>(v), d, height});
      nodes[u] = node;
      const float step = std::max(least_step, d * d * gap);
      const auto try_link = [&](int u2, int v2) {
        if (u2 < 0 || u2 >= disparity.width || v2 < 0) return;
        const std::int32_t other = nodes_.row(v2)[u2];
        if (other < 0 || std::abs(pixels_[static_cast<std::size_t>(other)].disparity - d) > step) return;
        const std::int32_t a = root(node), b = root(other);
        // The earlier pixel stays root: roots do not depend on the order of links.
        parents_[static_cast<std::size_t>(std::max(a, b))] = std::min(a, b);
      };
      for (int k = 1; k <= reach; ++k) {
        try_link(u - k, v);
        try_link(u, v - k);
      }
      try_link(u - 1, v - 1);
      try_link(u + 1, v - 1);
    }
  }
}

void ObstacleFinder::take_things(ObstacleKind kind) {
  // Pixels sorted by their root, each thing's in the order of the image.
  const std::size_t count = pixels_.size();
  starts_.assign(count + 1, 0);
  for (std::size_t i = 0; i < count; ++i) {
    parents_[i] = root(static_cast<std::int32_t>(i));
    ++starts_[static_cast<std::size_t>(parents_[i]) + 1];
  }
  std::partial_sum(starts_.begin(), starts_.end(), starts_.begin());
  order_.resize(count);
  nexts_.assign(starts_.begin(), starts_.end() - 1);
  for (std::size_t i = 0; i < count; ++i)
    order_[static_cast<std::size_t>(nexts_[static_cast<std::size_t>(parents_[i])]++)] =
        static_cast<std::int32_t>(i);
  const int least = kind == ObstacleKind::hole ? options_.hole_pixels : options_.min_pixels;
  for (std::size_t i = 0; i < count; ++i) {
    const auto begin = static_cast<std::size_t>(starts_[i]), end = static_cast<std::size_t>(starts_[i + 1]);
    if (static_cast<int>(end - begin) < least) continue;
    std::vector<Pixel> thing;
    thing.reserve(end - begin);
    for (std::size_t k = begin; k < end; ++k) thing.push_back(pixels_[static_cast<std::size_t>(order_[k])]);
    take(thing, kind);
  }
}

void ObstacleFinder::take(std::vector<Pixel>& pixels, ObstacleKind kind) {
  const bool hole = kind == ObstacleKind::hole;
  if (static_cast<int>(pixels.size()) < (hole ? options_.hole_pixels : options_.min_pixels)) return;
  if (obstacles_.size() >= kMostOrder) return;

  Obstacle obstacle;
  obstacle.kind = kind;
  obstacle.pixels = static_cast<int>(pixels.size());
  obstacle.image = {pixels[0].u, pixels[0].v, pixels[0].u, pixels[0].v};
  const std::size_t n = pixels.size();
  places_.resize(n);
  sorted_.resize(n);
  Vec3<double> sum = Vec3<double>::Zero();
  double area = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const Pixel& p = pixels[i];
    // A hole is where the floor is missing.
    const double d = hole ? floor_(p.u, p.v) : p.disparity;
    const double scale = camera_.baseline / d;
    const Vec3<double> p_camera(scale * (p.u - camera_.cx), scale * (p.v - camera_.cy),
                                scale * camera_.focal);
    sum += p_camera;
    places_[i] = (T_floor_camera_ * p_camera).head<2>().cast<float>();
    // Seen from above a pixel of the floor is longer by what the ray rises.
    area += hole ? scale * scale * p_camera.norm() / plane_.height : scale * scale;
    obstacle.image.u_min = std::min<int>(obstacle.image.u_min, p.u);
    obstacle.image.u_max = std::max<int>(obstacle.image.u_max, p.u);
    obstacle.image.v_min = std::min<int>(obstacle.image.v_min, p.v);
    obstacle.image.v_max = std::max<int>(obstacle.image.v_max, p.v);
  }
  if (area * 1e4 < (hole ? options_.hole_area : options_.min_area)) return;
  const auto heights = [&](double share) {
    for (std::size_t i = 0; i < n; ++i) sorted_[i] = pixels[i].height;
    return static_cast<double>(quantile(sorted_, share));
  };
  if (!hole && heights(kTopShare) < options_.min_top) return;

  // The axis along which it is longest.
  const Vec2<float> mean = std::accumulate(places_.begin(), places_.end(), Vec2<float>(Vec2<float>::Zero())) /
                           static_cast<float>(n);
  double xx = 0, xy = 0, yy = 0;
  for (const Vec2<float>& place : places_) {
    const Vec2<float> d = place - mean;
    xx += d.x() * d.x(), xy += d.x() * d.y(), yy += d.y() * d.y();
  }
  const double yaw = half_turn(0.5 * std::atan2(2 * xy, xx - yy));
  const Vec2<float> along(static_cast<float>(std::cos(yaw)), static_cast<float>(std::sin(yaw)));
  const Vec2<float> across(-along.y(), along.x());
  const auto span = [&](const Vec2<float>& axis) {
    for (std::size_t i = 0; i < n; ++i) sorted_[i] = axis.dot(places_[i]);
    const double low = quantile(sorted_, kTail);
    return std::pair(low, static_cast<double>(quantile(sorted_, 1 - kTail)));
  };
  const auto [from, to] = span(along);
  const auto [right, left] = span(across);

  if (!hole && to - from > options_.max_length) {
    const auto pieces = static_cast<std::size_t>(std::ceil((to - from) / options_.max_length));
    std::vector<std::vector<Pixel>> cut(pieces);
    for (std::size_t i = 0; i < n; ++i) {
      const double part = (along.dot(places_[i]) - from) / (to - from) * static_cast<double>(pieces);
      cut[static_cast<std::size_t>(std::clamp(part, 0.0, static_cast<double>(pieces) - 0.5))].push_back(
          pixels[i]);
    }
    for (auto& piece : cut)
      // Each is shorter than the whole.
      if (piece.size() < n) take(piece, kind);
    return;
  }
  const Evidence shown = evidence(pixels, kind);
  if (shown == Evidence::none) return;
  // Where another surface is seen in the floor's place all of it may seem a hole.
  obstacle.clear = shown == Evidence::clear && !(hole && doubt_.contradicted);
  obstacle.box.bottom = heights(kTail);
  obstacle.box.top = hole ? 0.0 : heights(1 - kTail);
  if (!hole) {
    if (obstacle.box.bottom > options_.clearance) return;
    if (obstacle.box.top < options_.carpet_top && to - from > options_.carpet_size &&
        left - right > options_.carpet_size)
      return;
  }
  obstacle.box.yaw = yaw;
  obstacle.box.length = to - from;
  obstacle.box.width = left - right;
  obstacle.box.centre =
      (0.5 * (from + to) * along.cast<double>() + 0.5 * (right + left) * across.cast<double>());
  for (std::size_t i = 0; i < n; ++i) sorted_[i] = places_[i].norm();
  obstacle.distance = quantile(sorted_, kTail);
  obstacle.p_camera = sum / static_cast<double>(n);
  if (const auto seen = camera_.project_stereo(obstacle.p_camera))
    if (const auto point = camera_.back_project(seen->x(), seen->y(), seen->x() - seen->z(), kPixelSigma,
                                                options_.disparity_sigma))
      obstacle.covariance = point->covariance;
  obstacles_.push_back(obstacle);
  const auto id = static_cast<std::uint16_t>(obstacles_.size());
  for (const Pixel& p : pixels) regions_(p.u, p.v) = id;
}

template <DisparityPixel D>
void ObstacleFinder::add_feet(View2d<const D> disparity, GrayView mask) {
  const float gap = static_cast<float>(options_.link_gap / (camera_.focal * camera_.baseline));
  const float h = static_cast<float>(plane_.height);
  // From row to row: a foot grows by one pixel from what stands above it.
  for (int v = 1; v < disparity.height; ++v) {
    const float floor_at_zero = static_cast<float>(floor_.at_origin + floor_.along_v * v);
    const std::uint16_t* above = regions_.row(v - 1);
    std::uint16_t* here = regions_.row(v);
    for (int u = 0; u < disparity.width; ++u) {
      if (above[u] == 0 || here[u] != 0 || mask(u, v) != static_cast<std::uint8_t>(FloorLabel::obstacle))
        continue;
      Obstacle& obstacle = obstacles_[above[u] - std::size_t{1}];
      if (obstacle.kind != ObstacleKind::obstacle) continue;
      const float d = static_cast<float>(disparity(u, v)) * kDisparityUnit<D>;
      const float before = static_cast<float>(disparity(u, v - 1)) * kDisparityUnit<D>;
      const float f = floor_at_zero + static_cast<float>(floor_.along_u) * static_cast<float>(u);
      const float height = h * (1 - f / d);
      // What lies flat comes nearer from row to row as the floor does; a foot hardly does.
      const float nearer = 0.5f * static_cast<float>(floor_.along_v);
      if (height > options_.min_height || d - before > std::max(nearer, d * d * gap * 0.1f) ||
          before - d > std::max(1.0f, d * d * gap))
        continue;
      here[u] = above[u];
      ++obstacle.pixels;
      obstacle.image.v_max = std::max(obstacle.image.v_max, v);
      obstacle.box.bottom = std::min<double>(obstacle.box.bottom, height);
    }
  }
}

template <DisparityPixel D>
const std::vector<Obstacle>& ObstacleFinder::find(View2d<const D> disparity, GrayView mask,
                                                  const RectifiedCamera& camera, const GroundPlane& plane,
                                                  GrayView left, GrayView right, const FloorDoubt& doubt) {
  require(mask.width == disparity.width && mask.height == disparity.height, "ObstacleFinder::find mask",
          "must be as wide and high as the disparities", mask.width);
  constexpr int kMost = std::numeric_limits<std::int16_t>::max();
  require(disparity.width <= kMost && disparity.height <= kMost, "ObstacleFinder::find disparity",
          "must not have sides above 32767", std::max(disparity.width, disparity.height));
  require(camera.focal > 0 && camera.baseline > 0, "ObstacleFinder::find camera",
          "needs a focal length and a baseline", camera.baseline);
  require(plane.height > 0, "ObstacleFinder::find plane", "the camera must be above the floor", plane.height);
  const bool with_images = !left.empty() || !right.empty();
  require(!with_images || (left.width == disparity.width && left.height == disparity.height &&
                           right.width == disparity.width && right.height == disparity.height),
          "ObstacleFinder::find left, right", "must be as wide and high as the disparities", right.width);
  left_ = left;
  right_ = right;
  margin_ = std::max(options_.clear_margin,
                     kTiltFactor * doubt.sigma_tilt * camera.focal * camera.baseline / plane.height);
  doubt_ = doubt;
  camera_ = camera;
  plane_ = plane;
  floor_ = plane.disparity(camera);
  T_floor_camera_ = floor_frame(plane);
  obstacles_.clear();
  regions_.resize(disparity.width, disparity.height);
  regions_.fill(0);
  for (const ObstacleKind kind : {ObstacleKind::obstacle, ObstacleKind::hole}) {
    link(disparity, mask, kind);
    take_things(kind);
  }
  if (obstacles_.empty()) return obstacles_;
  add_feet(disparity, mask);

  // From near to far.
  std::vector<std::size_t> order(obstacles_.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return obstacles_[a].distance < obstacles_[b].distance;
  });
  std::vector<Obstacle> sorted;
  std::vector<std::uint16_t> renamed(obstacles_.size() + 1, 0);
  for (const std::size_t i : order) {
    sorted.push_back(obstacles_[i]);
    renamed[i + 1] = static_cast<std::uint16_t>(sorted.size());
  }
  obstacles_.swap(sorted);
  for (int v = 0; v < regions_.height(); ++v) {
    std::uint16_t* row = regions_.row(v);
    for (int u = 0; u < regions_.width(); ++u) row[u] = renamed[row[u]];
  }
  return obstacles_;
}

template const std::vector<Obstacle>& ObstacleFinder::find<float>(View2d<const float>, GrayView,
                                                                  const RectifiedCamera&, const GroundPlane&,
                                                                  GrayView, GrayView, const FloorDoubt&);
template const std::vector<Obstacle>& ObstacleFinder::find<std::int16_t>(View2d<const std::int16_t>, GrayView,
                                                                         const RectifiedCamera&,
                                                                         const GroundPlane&, GrayView,
                                                                         GrayView, const FloorDoubt&);

}  // namespace sweepkit
