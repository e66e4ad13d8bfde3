// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/floor_map.hpp"

#include <cmath>
#include <numbers>
#include <utility>

#include "sweepkit/core/error.hpp"
#include "sweepkit/floor/reachable_floor.hpp"

namespace sweepkit {
namespace {

constexpr double kRadians = std::numbers::pi / 180.0;

double turned(double a, double b) { return std::abs(std::remainder(a - b, 2 * std::numbers::pi)); }

}  // namespace

FloorMap::FloorMap(const FloorMapOptions& options) : options_(options), grid_(options.grid) {
  check_options(options);
}

void FloorMap::add(KeyframeId keyframe, const SE3d& T_keyframe_scan, FloorScan scan) {
  require(keyframe.valid(), "FloorMap::add keyframe", "must name a keyframe", keyframe.value);
  scan.stretches.shrink_to_fit();
  keyframes_[keyframe].scans.push_back({T_keyframe_scan, std::move(scan), std::nullopt});
}

void FloorMap::set_pose(KeyframeId keyframe, const std::optional<SE3d>& T_map_keyframe) {
  const auto found = keyframes_.find(keyframe);
  if (found != keyframes_.end()) found->second.T_map_keyframe = T_map_keyframe;
}

void FloorMap::rehang(KeyframeId from, KeyframeId to, const SE3d& T_to_from) {
  require(to.valid() && to != from, "FloorMap::rehang to", "must name another keyframe", to.value);
  auto node = keyframes_.extract(from);
  if (node.empty()) return;
  Keyframe& target = keyframes_[to];
  for (Scan& scan : node.mapped().scans) {
    scan.T_keyframe_scan = T_to_from * scan.T_keyframe_scan;
    target.scans.push_back(std::move(scan));
  }
}

void FloorMap::undraw(Scan& scan) {
  if (scan.drawn) grid_.remove(scan.scan, *scan.drawn);
  scan.drawn.reset();
}

void FloorMap::erase(KeyframeId keyframe) {
  const auto found = keyframes_.find(keyframe);
  if (found == keyframes_.end()) return;
  for (Scan& scan : found->second.scans) undraw(scan);
  keyframes_.erase(found);
}

std::size_t FloorMap::update() {
  std::size_t drawn = 0;
  for (auto& [id, keyframe] : keyframes_)
    for (Scan& scan : keyframe.scans) {
      std::optional<PlanarPose> pose;
      if (keyframe.T_map_keyframe)
        pose = PlanarPose::of(*keyframe.T_map_keyframe * scan.T_keyframe_scan, options_.max_tilt * kRadians);
      if (!pose) {
        undraw(scan);
        continue;
      }
      if (scan.drawn) {
        const PlanarPose& old = *scan.drawn;
        if (std::hypot(pose->x - old.x, pose->y - old.y) <= options_.move &&
            turned(pose->yaw, old.yaw) <= options_.turn * kRadians)
          continue;
        undraw(scan);
      }
      grid_.add(scan.scan, *pose);
      scan.drawn = pose;
      ++drawn;
    }
  return drawn;
}

void FloorMap::rebuild() {
  grid_.clear();
  for (auto& [id, keyframe] : keyframes_)
    for (Scan& scan : keyframe.scans) scan.drawn.reset();
  update();
}

OccupancyImage FloorMap::image() const {
  // Where the robot stood, and the floor that it saw first: what lies between the two is below the image.
  constexpr double kBlind = 0.3;  // [m]
  std::vector<Vec2<double>> places;
  for (const auto& [id, keyframe] : keyframes_)
    for (const Scan& scan : keyframe.scans) {
      if (!scan.drawn) continue;
      const PlanarPose& pose = *scan.drawn;
      const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
      const auto put = [&](double x, double y) {
        places.emplace_back(pose.x + c * x - s * y, pose.y + s * x + c * y);
      };
      put(scan.scan.footprint.x(), scan.scan.footprint.y());
      for (const FloorStretch& stretch : scan.scan.stretches) {
        const double r = 1e-3 * stretch.from + 0.5 * options_.grid.cell;
        if (stretch.label != FloorLabel::floor || r > kBlind || r > 1e-3 * stretch.to) continue;
        const double bearing = scan.scan.bearing(stretch.bearing);
        put(r * std::cos(bearing), r * std::sin(bearing));
      }
    }
  OccupancyImage map = grid_.image();
  keep_reachable(map, places);
  return map;
}

std::vector<KeyframeId> FloorMap::keyframes() const {
  std::vector<KeyframeId> ids;
  for (const auto& [id, keyframe] : keyframes_) ids.push_back(id);
  return ids;
}

std::size_t FloorMap::scans() const {
  std::size_t count = 0;
  for (const auto& [id, keyframe] : keyframes_) count += keyframe.scans.size();
  return count;
}

std::size_t FloorMap::drawn() const {
  std::size_t count = 0;
  for (const auto& [id, keyframe] : keyframes_)
    for (const Scan& scan : keyframe.scans) count += scan.drawn.has_value();
  return count;
}

std::size_t FloorMap::bytes() const {
  std::size_t bytes = 0;
  for (const auto& [id, keyframe] : keyframes_)
    for (const Scan& scan : keyframe.scans) bytes += scan.scan.bytes();
  return bytes;
}

}  // namespace sweepkit
