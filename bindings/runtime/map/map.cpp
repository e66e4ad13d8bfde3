// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/map/map.hpp"

#include <algorithm>
#include <utility>

#include "sweepkit/core/error.hpp"

namespace sweepkit {
namespace {

// How many keyframes later a merge may be forgotten.
constexpr std::uint32_t kRememberMerges = 256;
// What malloc takes beside each piece, on average with rounding up.
constexpr std::size_t kPiece = 16;

auto lower_bound_keyframe(auto& list, KeyframeId id) {
  return std::lower_bound(list.begin(), list.end(), id,
                          [](const auto& entry, KeyframeId key) { return entry.keyframe < key; });
}

void add_covisible(std::vector<Covisible>& list, KeyframeId id, int by) {
  auto it = lower_bound_keyframe(list, id);
  if (it == list.end() || it->keyframe != id) it = list.insert(it, {id, 0});
  it->points += by;
  if (it->points <= 0) list.erase(it);
}

}  // namespace

Map::Map(MapParts&& parts)
    : keyframes_(std::move(parts.keyframes)),
      removed_(std::move(parts.removed)),
      map_count_(parts.map_count) {
  live_keyframes_ = static_cast<std::size_t>(std::count_if(
      keyframes_.begin(), keyframes_.end(), [](const auto& entry) { return entry != nullptr; }));
  for (auto& point : parts.points) points_.push_back(std::move(point));
  if (const auto broken = broken_invariant()) throw Error(ErrorKind::argument, "Map(parts)", *broken);
}

const Keyframe& Map::keyframe(KeyframeId id) const {
  const Keyframe* found = find(id);
  require(found != nullptr, "Map::keyframe(id)", "there is no such keyframe", id.value);
  return *found;
}

const MapPoint& Map::point(PointId id) const {
  const MapPoint* found = find(id);
  require(found != nullptr, "Map::point(id)", "there is no such point", id.value);
  return *found;
}

KeyframeId Map::add_keyframe(Keyframe keyframe) {
  require(keyframe.map.value < map_count_, "Map::add_keyframe(keyframe.map)", "there is no such map",
          keyframe.map.value);
  require(keyframe.measurements.size() == keyframe.descriptors.size(),
          "Map::add_keyframe(keyframe.descriptors)", "one descriptor for each measurement is needed",
          keyframe.descriptors.size());
  if (keyframe.parent.valid())
    require(this->keyframe(keyframe.parent).map == keyframe.map, "Map::add_keyframe(keyframe.parent)",
            "the parent belongs to another map", keyframe.parent.value);
  if (keyframe.odometry)
    require(this->keyframe(keyframe.odometry->from).map == keyframe.map,
            "Map::add_keyframe(keyframe.odometry)", "the keyframe before belongs to another map",
            keyframe.odometry->from.value);
  keyframe.id = KeyframeId{keyframe_id_end()};
  keyframe.points.assign(keyframe.measurements.size(), PointId{});
  keyframe.covisible.clear();
  keyframes_.push_back(std::make_unique<Keyframe>(std::move(keyframe)));
  ++live_keyframes_;
  // Now and then, so that it costs nothing.
  if (keyframe_id_end() % kRememberMerges == 0)
    std::erase_if(merged_into_, [&](const auto& entry) {
      return entry.second.keyframe_id_end + kRememberMerges <= keyframe_id_end();
    });
  return keyframes_.back()->id;
}

void Map::remove_keyframe(KeyframeId id) {
  Keyframe& gone = at(id);
  require(gone.parent.valid(), "Map::remove_keyframe(id)", "the root of a map cannot be removed", id.value);
  for (const PointId point : gone.points)
    if (point.valid()) remove_observation(point, id);
  for (auto& other : keyframes_) {
    if (!other) continue;
    if (other->parent == id) other->parent = gone.parent;
    if (other->odometry && other->odometry->from == id) {
      if (gone.odometry)
        other->odometry = {gone.odometry->from, gone.odometry->motion * other->odometry->motion};
      else
        other->odometry.reset();
    }
  }
  removed_[id] = {gone.parent, gone.T_camera_world * keyframe(gone.parent).T_camera_world.inverse()};
  keyframes_[id.value].reset();
  --live_keyframes_;
}

std::vector<MapId> Map::maps() const {
  std::vector<bool> used(map_count_, false);
  for (const auto& keyframe : keyframes_)
    if (keyframe) used[keyframe->map.value] = true;
  std::vector<MapId> ids;
  for (std::uint32_t i = 0; i < map_count_; ++i)
    if (used[i]) ids.push_back(MapId{i});
  return ids;
}

void Map::join_maps(KeyframeId child, KeyframeId parent, const SE3d& T_into_from) {
  const MapId from = keyframe(child).map, into = keyframe(parent).map;
  require(from != into, "Map::join_maps(parent)", "both keyframes belong to one map", parent.value);
  for (KeyframeId below = parent, here = child; here.valid();) {
    const KeyframeId above = std::exchange(at(here).parent, below);
    below = here;
    here = above;
  }
  std::vector<bool> moved(point_id_end(), false);
  const SE3d T_from_into = T_into_from.inverse();
  for (auto& keyframe : keyframes_) {
    if (!keyframe || keyframe->map != from) continue;
    keyframe->map = into;
    keyframe->T_camera_world = keyframe->T_camera_world * T_from_into;
    for (const PointId id : keyframe->points) {
      if (!id.valid() || moved[id.value]) continue;
      moved[id.value] = true;
      MapPoint& point = at(id);
      point.p_world = T_into_from * point.p_world;
      point.normal = (T_into_from.rotation() * point.normal.cast<double>()).cast<float>();
    }
  }
}

SE3d Map::T_camera_world(KeyframeId id) const {
  SE3d T_camera_ancestor;
  for (auto it = removed_.find(id); it != removed_.end(); it = removed_.find(id)) {
    T_camera_ancestor = T_camera_ancestor * it->second.T_camera_parent;
    id = it->second.parent;
  }
  return T_camera_ancestor * keyframe(id).T_camera_world;
}

PointId Map::add_point(const Vec3<double>& p_world, KeyframeId keyframe_id, std::uint32_t index) {
  const Keyframe& keyframe = this->keyframe(keyframe_id);
  require(index < keyframe.points.size(), "Map::add_point(index)", "the keyframe has no such measurement",
          index);
  require(!keyframe.points[index].valid(), "Map::add_point(index)", "the measurement already has a point",
          index);
  const PointId id{point_id_end()};
  auto point = std::make_unique<MapPoint>();
  point->id = id;
  point->p_world = p_world;
  point->first_keyframe = keyframe_id;
  point->predicted = point->found = 1;
  points_.push_back(std::move(point));
  add_observation(id, keyframe_id, index);
  return id;
}

bool Map::add_observation(PointId point_id, KeyframeId keyframe_id, std::uint32_t index) {
  MapPoint& point = at(point_id);
  Keyframe& keyframe = at(keyframe_id);
  require(index < keyframe.points.size(), "Map::add_observation(index)",
          "the keyframe has no such measurement", index);
  if (keyframe.points[index].valid()) return false;
  const auto it = lower_bound_keyframe(point.observations, keyframe_id);
  if (it != point.observations.end() && it->keyframe == keyframe_id) return false;
  for (const Observation& other : point.observations) change_covisibility(keyframe_id, other.keyframe, 1);
  point.observations.insert(it, {keyframe_id, index});
  keyframe.points[index] = point_id;
  return true;
}

void Map::detach(MapPoint& point, std::size_t observation) {
  const Observation gone = point.observations[observation];
  at(gone.keyframe).points[gone.index] = PointId{};
  point.observations.erase(point.observations.begin() + static_cast<std::ptrdiff_t>(observation));
  for (const Observation& other : point.observations) change_covisibility(gone.keyframe, other.keyframe, -1);
}

void Map::remove_observation(PointId point_id, KeyframeId keyframe_id) {
  MapPoint& point = at(point_id);
  const auto it = lower_bound_keyframe(point.observations, keyframe_id);
  if (it == point.observations.end() || it->keyframe != keyframe_id) return;
  detach(point, static_cast<std::size_t>(it - point.observations.begin()));
  if (point.observations.empty()) remove_point(point_id);
}

void Map::remove_point(PointId id) {
  MapPoint& gone = at(id);
  while (!gone.observations.empty()) detach(gone, gone.observations.size() - 1);
  points_.erase(id.value);
}

void Map::merge_points(PointId drop, PointId keep) {
  require(drop != keep, "Map::merge_points(drop)", "a point cannot be merged into itself", drop.value);
  MapPoint& dropped = at(drop);
  MapPoint& kept = at(keep);
  const std::vector<Observation> moved = dropped.observations;
  kept.predicted += dropped.predicted;
  kept.found += dropped.found;
  remove_point(drop);
  for (const Observation& o : moved) add_observation(keep, o.keyframe, o.index);
  merged_into_[drop] = {keep, keyframe_id_end()};
}

const RemovedKeyframe* Map::find_removed(KeyframeId id) const {
  const auto it = removed_.find(id);
  return it == removed_.end() ? nullptr : &it->second;
}

PointId Map::resolve(PointId id) const {
  while (id.valid() && find(id) == nullptr) {
    const auto it = merged_into_.find(id);
    id = it == merged_into_.end() ? PointId{} : it->second.into;
  }
  return id;
}

void Map::set_appearance(PointId id, const OrbDescriptor& descriptor, const Vec3<float>& normal,
                         float min_distance, float max_distance) {
  MapPoint& point = at(id);
  point.descriptor = descriptor;
  point.normal = normal;
  point.min_distance = min_distance;
  point.max_distance = max_distance;
}

void Map::shift_disparities(double bias) {
  for (auto& keyframe : keyframes_)
    if (keyframe)
      for (Measurement& m : keyframe->measurements) m.shift_disparity(bias);
}

void Map::count_prediction(PointId id, int predicted, int found) {
  MapPoint& point = at(id);
  point.predicted += predicted;
  point.found += found;
}

void Map::change_covisibility(KeyframeId a, KeyframeId b, int by) {
  add_covisible(at(a).covisible, b, by);
  add_covisible(at(b).covisible, a, by);
}

std::vector<Covisible> Map::best_covisible(KeyframeId id, std::size_t count, int min_points) const {
  std::vector<Covisible> best;
  for (const Covisible& c : keyframe(id).covisible)
    if (c.points >= min_points) best.push_back(c);
  std::stable_sort(best.begin(), best.end(),
                   [](const Covisible& a, const Covisible& b) { return a.points > b.points; });
  if (best.size() > count) best.resize(count);
  return best;
}

int Map::shared_points(KeyframeId a, KeyframeId b) const {
  const auto& list = keyframe(a).covisible;
  const auto it = lower_bound_keyframe(list, b);
  return it != list.end() && it->keyframe == b ? it->points : 0;
}

std::size_t Map::memory_bytes() const {
  const auto list = [](const auto& v) { return v.capacity() > 0 ? v.capacity() * sizeof(v[0]) + kPiece : 0; };
  const auto table = [](const auto& t) {
    return t.size() * (sizeof(*t.begin()) + sizeof(void*) + kPiece) + t.bucket_count() * sizeof(void*);
  };
  std::size_t bytes =
      sizeof(Map) + list(keyframes_) + points_.memory_bytes() + table(merged_into_) + table(removed_);
  for (const auto& k : keyframes_)
    if (k)
      bytes += sizeof(Keyframe) + kPiece + list(k->measurements) + list(k->descriptors) + list(k->points) +
               list(k->covisible);
  for (std::uint32_t i = 0; i < point_id_end(); ++i)
    if (const MapPoint* p = find(PointId{i})) bytes += sizeof(MapPoint) + kPiece + list(p->observations);
  return bytes;
}

std::optional<std::string> Map::broken_invariant() const {
  using std::to_string;
  std::size_t observations = 0;
  for (std::uint32_t i = 0; i < point_id_end(); ++i) {
    const MapPoint* point = find(PointId{i});
    if (!point) continue;
    const std::string name = "point " + to_string(i);
    if (point->id.value != i) return name + " has the id " + to_string(point->id.value);
    if (point->observations.empty()) return name + " has no observation";
    KeyframeId before;
    for (const Observation& o : point->observations) {
      const Keyframe* keyframe = find(o.keyframe);
      if (!keyframe) return name + " is seen by the dead keyframe " + to_string(o.keyframe.value);
      if (o.index >= keyframe->points.size() || keyframe->points[o.index] != point->id)
        return name + " is not known to keyframe " + to_string(o.keyframe.value);
      if (before.valid() && !(before < o.keyframe)) return name + " has observations out of order";
      before = o.keyframe;
    }
    observations += point->observations.size();
  }
  std::size_t slots = 0;
  std::vector<int> shared(keyframes_.size(), 0);  // with the keyframe at hand, by id
  for (std::uint32_t i = 0; i < keyframe_id_end(); ++i) {
    const Keyframe* keyframe = find(KeyframeId{i});
    if (!keyframe) continue;
    const std::string name = "keyframe " + to_string(i);
    if (keyframe->id.value != i) return name + " has the id " + to_string(keyframe->id.value);
    if (keyframe->map.value >= map_count_) return name + " is in no map";
    if (keyframe->points.size() != keyframe->measurements.size() ||
        keyframe->descriptors.size() != keyframe->measurements.size())
      return name + " has not as many points and descriptors as measurements";
    std::size_t others = 0;
    for (const PointId id : keyframe->points) {
      if (!id.valid()) continue;
      ++slots;
      const MapPoint* point = find(id);
      if (!point) return name + " sees the dead point " + to_string(id.value);
      for (const Observation& o : point->observations)
        others += o.keyframe.value != i && shared[o.keyframe.value]++ == 0;
    }
    KeyframeId before;
    for (const Covisible& c : keyframe->covisible) {
      if (!find(c.keyframe))
        return name + " is covisible with the dead keyframe " + to_string(c.keyframe.value);
      if (c.points < 1 || shared[c.keyframe.value] != c.points)
        return name + " counts " + to_string(c.points) + " points shared with keyframe " +
               to_string(c.keyframe.value);
      if (before.valid() && !(before < c.keyframe)) return name + " has covisible keyframes out of order";
      before = c.keyframe;
      shared[c.keyframe.value] = 0;
    }
    if (keyframe->covisible.size() != others)
      return name + " shares points with " + to_string(others) + " keyframes, not " +
             to_string(keyframe->covisible.size());
    if (keyframe->odometry) {
      const Keyframe* from = find(keyframe->odometry->from);
      if (!from) return name + " has odometry from a dead keyframe";
      if (from->map != keyframe->map) return name + " has odometry from another map";
    }
  }
  if (slots != observations)
    return "keyframes hold " + to_string(slots) + " points, points " + to_string(observations);

  // The way up, over parents and what stood for those removed, until it meets an end or an earlier way.
  if (removed_.size() != keyframes_.size() - live_keyframes_)
    return "of " + to_string(keyframes_.size() - live_keyframes_) + " removed keyframes " +
           to_string(removed_.size()) + " are told";
  std::vector<std::uint32_t> way(keyframes_.size(), 0);
  for (std::uint32_t i = 0; i < keyframe_id_end(); ++i) {
    for (KeyframeId id{i}; way[id.value] == 0;) {
      way[id.value] = i + 1;
      const std::string name = "keyframe " + to_string(id.value);
      const Keyframe* keyframe = find(id);
      const RemovedKeyframe* removed = find_removed(id);
      if (!keyframe == !removed) return name + " is not either living or removed";
      const KeyframeId up = keyframe ? keyframe->parent : removed->parent;
      if (keyframe && !up.valid()) break;
      if (up.value >= keyframes_.size()) return name + " has no parent";
      if (keyframe && !find(up)) return name + " has a dead parent";
      if (keyframe && find(up)->map != keyframe->map) return name + " has a parent in another map";
      if (way[up.value] == i + 1) return name + " is its own ancestor";
      id = up;
    }
  }
  return std::nullopt;
}

}  // namespace sweepkit
