// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/grid_stage.hpp"

#include <algorithm>
#include <numbers>
#include <utility>

#include "canvas.hpp"
#include "sweepkit/floor/grid_file.hpp"

namespace sweepkit {
namespace {

constexpr Color kPath{40, 90, 220}, kEnd{220, 40, 40};
constexpr int kPictureSide = 1000;  // about as many pixels along the longer side
constexpr int kLargestScale = 8;    // of a cell's side [pixels]

/// The map to which a keyframe belongs, also one that was removed.
MapId map_of(const Map& map, KeyframeId id) {
  while (id.valid()) {
    if (const Keyframe* keyframe = map.find(id)) return keyframe->map;
    const RemovedKeyframe* removed = map.find_removed(id);
    if (!removed) break;
    id = removed->parent;
  }
  return {};
}

}  // namespace

GridStage::GridStage(const RectifiedCamera& camera, const Vec3<double>& base_camera,
                     const GridStageOptions& options)
    : camera_(camera),
      base_camera_(base_camera),
      options_(options),
      scanner_(options.scan),
      floor_(options.map) {
  check_options(options);
}

bool GridStage::is_due(const GridView& view) const {
  const std::scoped_lock lock(mutex_);
  if (!view.reference.valid()) return false;
  if (!T_smooth_last_) return true;
  const SE3d step = T_smooth_last_->inverse() * view.T_smooth_camera;
  return step.translation().norm() >= options_.every_distance ||
         step.rotation().angle() >= options_.every_turn * std::numbers::pi / 180;
}

bool GridStage::add(DisparityView disparity, const GroundPlane& plane, const GridView& view) {
  if (!is_due(view)) return false;
  const std::scoped_lock lock(mutex_);
  FloorScan scan;
  scanner_.scan(disparity, camera_, plane, base_camera_, scan);
  floor_.add(view.reference, view.T_camera_reference.inverse() * camera_from_scan(plane), std::move(scan));
  T_smooth_last_ = view.T_smooth_camera;
  return true;
}

OccupancyImage GridStage::image(const Map& map, MapId shown) {
  const std::scoped_lock lock(mutex_);
  for (const KeyframeId id : floor_.keyframes())
    floor_.set_pose(
        id, map_of(map, id) == shown ? std::optional(map.T_camera_world(id).inverse()) : std::nullopt);
  floor_.update();
  return floor_.image();
}

std::size_t GridStage::scans() const {
  const std::scoped_lock lock(mutex_);
  return floor_.scans();
}

std::size_t GridStage::bytes() const {
  const std::scoped_lock lock(mutex_);
  return floor_.bytes();
}

void write_grid_picture(const std::filesystem::path& file, const OccupancyImage& map,
                        std::span<const StampedPose> path) {
  GrayImage unknown(1, 1);
  unknown.fill(OccupancyImage::kUnknown);
  const GrayView cells = map.cells.empty() ? unknown.view() : map.cells.view();
  const int scale = std::clamp(kPictureSide / std::max(cells.width, cells.height), 1, kLargestScale);
  GrayImage large(cells.width * scale, cells.height * scale);
  for (int y = 0; y < large.height(); ++y)
    for (int x = 0; x < large.width(); ++x) large(x, y) = cells(x / scale, y / scale);
  Canvas canvas(large);
  const auto place = [&](const StampedPose& pose) {
    const Vec2<double> p = (pose.T_world_body.translation().head<2>() - map.origin) * (scale / map.cell);
    return Vec2<double>(p.x(), large.height() - p.y());
  };
  const auto inside = [&](const Vec2<double>& p) {
    return p.x() >= 0 && p.y() >= 0 && p.x() < large.width() && p.y() < large.height();
  };
  for (std::size_t i = 1; i < path.size(); ++i) {
    const Vec2<double> a = place(path[i - 1]), b = place(path[i]);
    if (inside(a) && inside(b)) canvas.line(a.x(), a.y(), b.x(), b.y(), kPath);
  }
  if (!path.empty() && inside(place(path.back())))
    for (const double radius : {2.0, 3.0, 4.0})
      canvas.circle(place(path.back()).x(), place(path.back()).y(), radius, kEnd);
  canvas.write(file);
}

void write_grid_results(const std::filesystem::path& folder, const OccupancyImage& map,
                        std::span<const StampedPose> path) {
  write_grid(map, folder);
  write_grid_picture(folder / "grid.png", map, path);
}

}  // namespace sweepkit
