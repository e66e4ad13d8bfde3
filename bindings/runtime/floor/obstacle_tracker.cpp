// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/obstacle_tracker.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <tuple>

namespace sweepkit {
namespace {

/// How far a point lies outside a box's outline [m]; 0 inside.
double outside(const FloorBox& box, const Vec2<double>& p) {
  const Vec2<double> d = p - box.centre;
  const double c = std::cos(box.yaw), s = std::sin(box.yaw);
  const double along = std::max(std::abs(c * d.x() + s * d.y()) - 0.5 * box.length, 0.0);
  const double across = std::max(std::abs(-s * d.x() + c * d.y()) - 0.5 * box.width, 0.0);
  return std::hypot(along, across);
}

/// About how far two boxes are apart: from the middle of either to the other, the lesser.
double gap(const FloorBox& a, const FloorBox& b) {
  return std::min(outside(a, b.centre), outside(b, a.centre));
}

/// Whether an image looks through the place where something is thought to stand.
template <DisparityPixel D>
bool is_gone(const TrackedObstacle& thing, View2d<const D> disparity, const RectifiedCamera& camera,
             const SE3d& T_camera_world, double max_range) {
  constexpr int kReach = 2;        // around its place [px]
  constexpr float kBehind = 1.5f;  // farther by so much is behind [px]
  const Vec3<double> p_camera = T_camera_world * thing.p_world;
  if (p_camera.z() > max_range) return false;
  const auto seen = camera.project_stereo(p_camera);
  if (!seen) return false;
  // Not where the image ends: there it may be half seen.
  const double margin = 0.05 * disparity.width;
  if (!(seen->x() >= margin && seen->y() >= kReach && seen->x() < disparity.width - margin &&
        seen->y() < disparity.height - kReach))
    return false;
  const int u = static_cast<int>(std::lround(seen->x())), v = static_cast<int>(std::lround(seen->y()));
  const float expected = static_cast<float>(seen->x() - seen->z());
  int behind = 0, measured = 0;
  for (int y = std::max(v - kReach, 0); y <= std::min(v + kReach, disparity.height - 1); ++y)
    for (int x = std::max(u - kReach, 0); x <= std::min(u + kReach, disparity.width - 1); ++x) {
      const float d = static_cast<float>(disparity(x, y)) * kDisparityUnit<D>;
      if (!(d > 0)) continue;
      ++measured;
      // What is nearer hides it.
      if (thing.kind == ObstacleKind::hole ? d > expected - kBehind : d < expected - kBehind) ++behind;
    }
  return 2 * measured > (2 * kReach + 1) * (2 * kReach + 1) && 4 * behind > 3 * measured;
}

}  // namespace

ObstacleTracker::ObstacleTracker(const ObstacleTrackerOptions& options) : options_(options) {
  check_options(options_);
}

template <DisparityPixel D>
void ObstacleTracker::update(TimeNs t, std::span<const Obstacle> obstacles, View2d<const D> disparity,
                             const RectifiedCamera& camera, const GroundPlane& plane,
                             const SE3d& T_world_camera) {
  const SE3d T_world_floor = T_world_camera * floor_frame(plane).inverse();
  const Mat3<double> R = T_world_camera.rotation().matrix();
  std::vector<FloorBox> boxes;
  boxes.reserve(obstacles.size());
  for (const Obstacle& o : obstacles) boxes.push_back(moved(o.box, T_world_floor));

  // Pairs by their distance, the nearest first; what ties is settled by age and nearness to the robot.
  std::vector<std::tuple<double, std::size_t, std::size_t>> pairs;
  std::vector<bool> seen(tracked_.size(), false), clear(tracked_.size(), false),
      known(obstacles.size(), false);
  for (std::size_t i = 0; i < tracked_.size(); ++i) {
    tracked_[i].last = -1;
    for (std::size_t k = 0; k < obstacles.size(); ++k) {
      if (obstacles[k].kind != tracked_[i].kind) continue;
      const double apart = gap(tracked_[i].box, boxes[k]);
      if (apart > options_.gate + options_.gate_share * obstacles[k].distance) continue;
      seen[i] = known[k] = true;
      if (obstacles[k].clear) clear[i] = true;
      pairs.emplace_back((T_world_camera * obstacles[k].p_camera - tracked_[i].p_world).norm(), i, k);
    }
  }
  std::sort(pairs.begin(), pairs.end());
  std::vector<bool> taken(obstacles.size(), false);
  for (const auto& [distance, i, k] : pairs) {
    TrackedObstacle& thing = tracked_[i];
    if (thing.last >= 0 || taken[k]) continue;
    taken[k] = true;
    thing.last = static_cast<int>(k);
    const Vec3<double> p_world = T_world_camera * obstacles[k].p_camera;
    const Mat3<double> P = R * obstacles[k].covariance * R.transpose();
    // Errors of one thing's disparities stay alike while it is seen from nearly the same place: the better
    // of the two sightings counts, and they are averaged by their weights.
    const double weight = thing.covariance.trace() / (thing.covariance.trace() + P.trace());
    thing.p_world += weight * (p_world - thing.p_world);
    if (P.trace() < thing.covariance.trace()) thing.covariance = P;
    thing.box = boxes[k];
  }
  // Several pieces of one wall are one sighting for each thing that they touch.
  const SE3d T_camera_world = T_world_camera.inverse();
  for (std::size_t i = 0; i < tracked_.size(); ++i) {
    TrackedObstacle& thing = tracked_[i];
    if (seen[i]) {
      if (clear[i]) thing.log_odds = std::min(thing.log_odds + options_.hit, options_.most);
      ++thing.hits;
      thing.last_seen = t;
    } else if (is_gone(thing, disparity, camera, T_camera_world, options_.max_range)) {
      thing.log_odds -= options_.miss;
    }
    thing.confirmed = thing.confirmed || thing.log_odds >= options_.confirm;
  }
  std::erase_if(tracked_, [&](const TrackedObstacle& thing) {
    return thing.log_odds < options_.drop || to_seconds(t - thing.last_seen) > options_.memory;
  });
  for (std::size_t k = 0; k < obstacles.size(); ++k) {
    if (known[k]) continue;
    TrackedObstacle thing;
    thing.id = ++last_id_;
    thing.kind = obstacles[k].kind;
    thing.p_world = T_world_camera * obstacles[k].p_camera;
    thing.covariance = R * obstacles[k].covariance * R.transpose();
    thing.box = boxes[k];
    thing.log_odds = obstacles[k].clear ? std::min(options_.hit, options_.most) : 0.0;
    thing.confirmed = thing.log_odds >= options_.confirm;
    thing.hits = 1;
    thing.first_seen = thing.last_seen = t;
    thing.last = static_cast<int>(k);
    tracked_.push_back(thing);
  }
}

template void ObstacleTracker::update<float>(TimeNs, std::span<const Obstacle>, View2d<const float>,
                                             const RectifiedCamera&, const GroundPlane&, const SE3d&);
template void ObstacleTracker::update<std::int16_t>(TimeNs, std::span<const Obstacle>,
                                                    View2d<const std::int16_t>, const RectifiedCamera&,
                                                    const GroundPlane&, const SE3d&);

}  // namespace sweepkit
