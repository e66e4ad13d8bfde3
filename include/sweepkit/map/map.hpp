// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

#include "sweepkit/map/keyframe.hpp"
#include "sweepkit/map/point.hpp"

namespace sweepkit {

/// Keyframes, points and who saw what: plain data behind operations that keep these invariants:
/// - an observation of a point by a keyframe stands on both sides (`MapPoint::observations`,
/// `Keyframe::points`);
/// - a point has at least one observation, and at most one by each keyframe;
/// - `Keyframe::covisible` counts shared points exactly, the same on both sides;
/// - a parent is a living keyframe of the same map, and parents form trees;
/// - odometry comes from a living keyframe of the same map.
///
/// Ids are given in order of creation and never used again. Removed keyframes and points leave their id
/// empty. Not thread safe: it has one owner.
class Map {
 public:
  /// Starts another map, that is a tree of keyframes in a frame of its own.
  MapId add_map() { return MapId{map_count_++}; }
  std::uint32_t map_count() const { return map_count_; }

  /// Takes a keyframe over; `id`, `points` and `covisible` are set here. A parent must live and be of the
  /// same map.
  KeyframeId add_keyframe(Keyframe keyframe);
  /// Its points lose an observation, those without another vanish; its children go to its parent,
  /// the odometry from it and to it becomes one. The root of a map stays: throws Error(argument).
  void remove_keyframe(KeyframeId id);

  /// Makes a point seen at measurement `index` of a keyframe, which must be free.
  PointId add_point(const Vec3<double>& p_world, KeyframeId keyframe, std::uint32_t index);
  void remove_point(PointId id);
  /// Says that the point was seen. False, and nothing changes, if the keyframe sees it already or the
  /// measurement is taken.
  bool add_observation(PointId point, KeyframeId keyframe, std::uint32_t index);
  /// The point vanishes with its last observation. Nothing happens if there is no such observation.
  void remove_observation(PointId point, KeyframeId keyframe);
  /// Two points were one: `drop` vanishes, its observations and counts go to `keep` where they do not clash,
  /// and `resolve(drop)` is `keep` from now on.
  void merge_points(PointId drop, PointId keep);
  /// The point that stands for this id after merges; none if it was removed.
  PointId resolve(PointId id) const;

  /// World to camera of a keyframe; of a removed one through the keyframe that was its parent, as it stood to
  /// it then.
  SE3d T_camera_world(KeyframeId id) const;
  void set_pose(KeyframeId id, const SE3d& T_camera_world) { at(id).T_camera_world = T_camera_world; }
  void set_position(PointId id, const Vec3<double>& p_world) { at(id).p_world = p_world; }
  void set_appearance(PointId id, const OrbDescriptor& descriptor, const Vec3<float>& normal,
                      float min_distance, float max_distance);
  /// The rig was found to measure all disparities too large by `bias` [px]: takes it off those of all
  /// keyframes.
  void shift_disparities(double bias);
  void count_prediction(PointId id, int predicted, int found);

  /// The keyframe or point, or null if there is none of this id (any more). Valid until it is removed.
  const Keyframe* find(KeyframeId id) const {
    return id.value < keyframes_.size() ? keyframes_[id.value].get() : nullptr;
  }
  const MapPoint* find(PointId id) const {
    return id.value < points_.size() ? points_[id.value].get() : nullptr;
  }
  /// As find, but throws Error(argument) where there is none.
  const Keyframe& keyframe(KeyframeId id) const;
  const MapPoint& point(PointId id) const;

  std::size_t keyframe_count() const { return live_keyframes_; }
  std::size_t point_count() const { return live_points_; }
  /// One past the largest id given so far: loop from 0 and `find`.
  std::uint32_t keyframe_id_end() const { return static_cast<std::uint32_t>(keyframes_.size()); }
  std::uint32_t point_id_end() const { return static_cast<std::uint32_t>(points_.size()); }

  /// The keyframes sharing at least `min_points` points, most first, at most `count`; ties by id.
  std::vector<Covisible> best_covisible(KeyframeId id, std::size_t count, int min_points = 1) const;
  /// How many points two keyframes share.
  int shared_points(KeyframeId a, KeyframeId b) const;

  /// The first invariant found broken, in words; nothing when all hold. Slow: for tests and debug builds.
  std::optional<std::string> broken_invariant() const;

 private:
  Keyframe& at(KeyframeId id) { return const_cast<Keyframe&>(keyframe(id)); }
  MapPoint& at(PointId id) { return const_cast<MapPoint&>(point(id)); }
  void change_covisibility(KeyframeId a, KeyframeId b, int by);
  void detach(MapPoint& point, std::size_t observation);

  std::vector<std::unique_ptr<Keyframe>> keyframes_;  // by id
  std::vector<std::unique_ptr<MapPoint>> points_;     // by id
  struct Removed {
    KeyframeId parent;
    SE3d T_camera_parent;
  };

  std::unordered_map<PointId, PointId> merged_into_;
  std::unordered_map<KeyframeId, Removed> removed_;
  std::size_t live_keyframes_ = 0;
  std::size_t live_points_ = 0;
  std::uint32_t map_count_ = 0;
};

}  // namespace sweepkit
