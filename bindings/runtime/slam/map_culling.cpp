// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/map_culling.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <numbers>
#include <queue>

namespace sweepkit {
namespace {

// Doublings after which direction, and then position, tell no views apart any more.
constexpr int kAllDirections = 3;
constexpr int kAllPlaces = 12;

using ViewKey = std::array<std::int64_t, 7>;  // map, cell of position, cell of the optical axis on the sphere

// Views of more doublings are unions of those of fewer: what keeps the large ones in number never costs one.
ViewKey view_of(const Keyframe& keyframe, const MapCaps& caps, int doublings) {
  const SE3d T_world_camera = keyframe.T_camera_world.inverse();
  const Vec3<double>& p = T_world_camera.translation();
  const Vec3<double> axis = T_world_camera.rotation() * Vec3<double>::UnitZ();
  // A grid through the unit ball, which needs no vertical; as wide as the chord of a sector. Zero lies in the
  // middle of cells: a camera that stays level or at the height of the origin is on no border.
  const double chord = 2 * std::sin(caps.sector * std::numbers::pi / 360);
  ViewKey key{keyframe.map.value, 0, 0, 0, 0, 0, 0};
  for (std::size_t i = 0; i < 3; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    // Anything beyond is one far cell: no overflow.
    if (doublings < kAllPlaces)
      key[1 + i] =
          static_cast<std::int64_t>(std::floor(std::clamp(p[k] / caps.cell, -1e15, 1e15) + 0.5)) >> doublings;
    if (doublings < kAllDirections)
      key[4 + i] = static_cast<std::int64_t>(std::floor(axis[k] / chord + 0.5)) >> doublings;
  }
  return key;
}

bool sees(const Keyframe& keyframe) {
  return std::any_of(keyframe.points.begin(), keyframe.points.end(), [](PointId p) { return p.valid(); });
}

class Culling {
 public:
  Culling(const Map& map, const MapCaps& caps, std::span<const KeyframeId> keep)
      : map_(map), caps_(caps), stays_(map.keyframe_id_end(), false), observations_(map.point_id_end(), 0) {
    for (const KeyframeId id : keep)
      if (id.value < stays_.size()) stays_[id.value] = true;
    for (std::uint32_t i = 0; i < map.point_id_end(); ++i)
      if (const MapPoint* point = map.find(PointId{i}))
        observations_[i] = static_cast<std::uint32_t>(point->observations.size());
    for (std::uint32_t i = 0; i < map.keyframe_id_end(); ++i) {
      const Keyframe* keyframe = map.find(KeyframeId{i});
      if (!keyframe) continue;
      living_.push_back(keyframe);
      if (!keyframe->parent.valid()) stays_[i] = true;
    }
  }

  std::vector<KeyframeId> choose() {
    count_ = living_.size();
    bytes_ = static_cast<double>(map_.memory_bytes());
    if (within(1)) return {};
    remove_sightless();
    for (int doublings = 0; doublings <= kAllPlaces && !done(); ++doublings) thin_out(doublings);
    return std::move(chosen_);
  }

 private:
  struct Candidate {
    double redundancy;
    KeyframeId id;
    std::size_t view;
    // For the queue, whose top is the largest: most redundant first, then oldest.
    bool operator<(const Candidate& other) const {
      return redundancy != other.redundancy ? redundancy < other.redundancy : other.id < id;
    }
  };

  bool within(double part) const {
    return static_cast<double>(count_) <= part * caps_.max_keyframes &&
           bytes_ <= part * 1e6 * caps_.max_memory;
  }
  bool done() const { return within(1 - caps_.slack); }

  /// The part of a keyframe's points that enough others see.
  double redundancy(const Keyframe& keyframe) const {
    int seen = 0, elsewhere = 0;
    for (const PointId point : keyframe.points) {
      if (!point.valid()) continue;
      ++seen;
      elsewhere += observations_[point.value] > static_cast<std::uint32_t>(caps_.seen_by);
    }
    return static_cast<double>(elsewhere) / std::max(seen, 1);
  }

  void take(const Keyframe& keyframe) {
    const auto list = [](const auto& v) { return static_cast<double>(v.capacity() * sizeof(v[0])); };
    bytes_ -= sizeof(Keyframe) + list(keyframe.measurements) + list(keyframe.descriptors) +
              list(keyframe.points) + list(keyframe.covisible);
    // A record of it stays.
    bytes_ += sizeof(RemovedKeyframe) + 64;
    for (const PointId point : keyframe.points)
      if (point.valid() && --observations_[point.value] == 0) bytes_ -= sizeof(MapPoint);
    --count_;
    stays_[keyframe.id.value] = true;  // gone; not to be chosen again
    chosen_.push_back(keyframe.id);
  }

  void remove_sightless() {
    for (const Keyframe* keyframe : living_) {
      if (done()) return;
      if (!sees(*keyframe) && !stays_[keyframe->id.value]) take(*keyframe);
    }
    std::erase_if(living_, [](const Keyframe* k) { return !sees(*k); });
  }

  // Removes keyframes of views that others show, until each view has one.
  void thin_out(int doublings) {
    std::map<ViewKey, std::size_t> views;
    std::vector<int> shown;
    std::priority_queue<Candidate> queue;
    for (const Keyframe* keyframe : living_) {
      const std::size_t view =
          views.try_emplace(view_of(*keyframe, caps_, doublings), shown.size()).first->second;
      if (view == shown.size()) shown.push_back(0);
      ++shown[view];
      if (!stays_[keyframe->id.value]) queue.push({redundancy(*keyframe), keyframe->id, view});
    }
    while (!queue.empty() && !done()) {
      Candidate best = queue.top();
      queue.pop();
      if (shown[best.view] < 2) continue;
      // What was removed since makes it less redundant, never more: it may have to wait.
      const double now = redundancy(map_.keyframe(best.id));
      if (now < best.redundancy) {
        best.redundancy = now;
        queue.push(best);
        continue;
      }
      take(map_.keyframe(best.id));
      --shown[best.view];
    }
    std::vector<bool> gone(stays_.size(), false);
    for (const KeyframeId id : chosen_) gone[id.value] = true;
    std::erase_if(living_, [&](const Keyframe* k) { return gone[k->id.value]; });
  }

  const Map& map_;
  const MapCaps& caps_;
  std::vector<bool> stays_;
  std::vector<std::uint32_t> observations_;  // by point, of the keyframes left
  std::vector<const Keyframe*> living_;
  std::size_t count_ = 0;
  double bytes_ = 0;
  std::vector<KeyframeId> chosen_;
};

}  // namespace

std::vector<KeyframeId> choose_culls(const Map& map, const MapCaps& caps, std::span<const KeyframeId> keep) {
  return Culling(map, caps, keep).choose();
}

std::size_t count_views(const Map& map, const MapCaps& caps, int doublings) {
  std::map<ViewKey, int> views;
  for (std::uint32_t i = 0; i < map.keyframe_id_end(); ++i)
    if (const Keyframe* keyframe = map.find(KeyframeId{i}); keyframe && sees(*keyframe))
      ++views[view_of(*keyframe, caps, doublings)];
  return views.size();
}

}  // namespace sweepkit
