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

#include "sweepkit/map/impl/id_table.hpp"
#include "sweepkit/map/keyframe.hpp"
#include "sweepkit/map/point.hpp"

namespace sweepkit {

/// What stands for a keyframe that was removed.
struct RemovedKeyframe {
  KeyframeId parent;     ///< its parent then; may have been removed since
  SE3d T_camera_parent;  ///< from that one's camera, as it stood to it then
};

/// All that a map is made of, in the open: what a file brings back.
struct MapParts {
  std::uint32_t map_count = 0;
  std::vector<std::unique_ptr<Keyframe>> keyframes;  ///< by id; null where it was removed
  std::vector<std::unique_ptr<MapPoint>> points;     ///< by id; null where it was removed
  std::unordered_map<KeyframeId, RemovedKeyframe> removed;
};

/// Keyframes, points and who saw what: plain data behind operations that keep these invariants:
/// - an observation of a point by a keyframe stands on both sides (`MapPoint::observations`,
/// `Keyframe::points`);
/// - a point has at least one observation, and at most one by each keyframe;
/// - `Keyframe::covisible` counts shared points exactly, the same on both sides;
/// - a parent is a living keyframe of the same map, and parents form trees;
/// - odometry comes from a living keyframe of the same map;
/// - a removed keyframe leads to a living one.
///
/// Ids are given in order of creation and never used again. Removed keyframes and points leave their id
/// empty. Not thread safe: it has one owner.
class Map {
 public:
  Map() = default;
  /// A map again from its parts. Throws Error(argument) that names the first invariant that they break.
  explicit Map(MapParts&& parts);
  Map(Map&&) = default;
  Map& operator=(Map&&) = default;
  Map(const Map&) = delete;
  Map& operator=(const Map&) = delete;

  /// Starts another map, that is a tree of keyframes in a frame of its own.
  MapId add_map() { return MapId{map_count_++}; }
  std::uint32_t map_count() const { return map_count_; }
  /// The maps that have keyframes, in order.
  std::vector<MapId> maps() const;
  /// Two maps are found to be of one place: keyframes and points of `from` move into the frame of `into`, and
  /// its tree hangs on below `parent`, from `child` on, the way up from there turned round. `from` is empty
  /// then.
  /// @param child of `from` @param parent of `into` @param T_into_from between the frames of the two
  void join_maps(KeyframeId child, KeyframeId parent, const SE3d& T_into_from);

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
  /// The point that stands for this id after merges; none if it was removed. A merge is forgotten after some
  /// hundred further keyframes: whoever holds an id that long asks in between.
  PointId resolve(PointId id) const;

  /// World to camera of a keyframe; of a removed one through the keyframe that was its parent, as it stood to
  /// it then.
  SE3d T_camera_world(KeyframeId id) const;
  /// What is kept of a removed keyframe; null for any other.
  const RemovedKeyframe* find_removed(KeyframeId id) const;
  void set_pose(KeyframeId id, const SE3d& T_camera_world) { at(id).T_camera_world = T_camera_world; }
  void set_covariance(KeyframeId id, const Mat6<double>& covariance) { at(id).covariance = covariance; }
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
  const MapPoint* find(PointId id) const { return points_.find(id.value); }
  /// As find, but throws Error(argument) where there is none.
  const Keyframe& keyframe(KeyframeId id) const;
  const MapPoint& point(PointId id) const;

  std::size_t keyframe_count() const { return live_keyframes_; }
  std::size_t point_count() const { return points_.living(); }
  /// One past the largest id given so far: loop from 0 and `find`.
  std::uint32_t keyframe_id_end() const { return static_cast<std::uint32_t>(keyframes_.size()); }
  std::uint32_t point_id_end() const { return points_.end(); }

  /// The keyframes sharing at least `min_points` points, most first, at most `count`; ties by id.
  std::vector<Covisible> best_covisible(KeyframeId id, std::size_t count, int min_points = 1) const;
  /// How many points two keyframes share.
  int shared_points(KeyframeId a, KeyframeId b) const;

  /// What it takes: everything, with what vectors hold in reserve and the allocator's overhead [bytes].
  std::size_t memory_bytes() const;

  /// The first invariant found broken, in words; nothing when all hold. Counts anew who shares
  /// what with whom: for files, tests and debug builds.
  std::optional<std::string> broken_invariant() const;

 private:
  Keyframe& at(KeyframeId id) { return const_cast<Keyframe&>(keyframe(id)); }
  MapPoint& at(PointId id) { return const_cast<MapPoint&>(point(id)); }
  void change_covisibility(KeyframeId a, KeyframeId b, int by);
  void detach(MapPoint& point, std::size_t observation);

  std::vector<std::unique_ptr<Keyframe>> keyframes_;  // by id
  impl::IdTable<MapPoint> points_;
  struct Merge {
    PointId into;
    std::uint32_t keyframe_id_end;  // when
  };
  std::unordered_map<PointId, Merge> merged_into_;
  std::unordered_map<KeyframeId, RemovedKeyframe> removed_;
  std::size_t live_keyframes_ = 0;
  std::uint32_t map_count_ = 0;
};

}  // namespace sweepkit
