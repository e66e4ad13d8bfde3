// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <catch2/catch.hpp>
#include <functional>
#include <memory>
#include <string>

#include "sweepkit/core/error.hpp"
#include "sweepkit/map/map.hpp"

using namespace sweepkit;

namespace {

Keyframe blank_keyframe(MapId map, KeyframeId parent) {
  Keyframe keyframe;
  keyframe.map = map;
  keyframe.parent = parent;
  keyframe.measurements.resize(6);
  keyframe.descriptors.resize(6);
  return keyframe;
}

// Keyframes 0 - 1 - 2 in one map, 3 in another, 4 removed, 5 on odometry alone; points 0 to 3 seen by 0, 1
// and partly 2, point 4 removed, point 5 by 3.
Map small_map() {
  Map map;
  const MapId first = map.add_map(), second = map.add_map();
  const KeyframeId a = map.add_keyframe(blank_keyframe(first, {}));
  const KeyframeId b = map.add_keyframe(blank_keyframe(first, a));
  const KeyframeId c = map.add_keyframe(blank_keyframe(first, b));
  const KeyframeId d = map.add_keyframe(blank_keyframe(second, {}));
  for (std::uint32_t i = 0; i < 5; ++i) {
    const PointId p = map.add_point({0.1 * i, 0, 1}, a, i);
    map.add_observation(p, b, i);
    if (i < 2) map.add_observation(p, c, i);
  }
  map.remove_point(PointId{4});
  map.add_point({1, 2, 3}, d, 5);
  map.remove_keyframe(map.add_keyframe(blank_keyframe(first, c)));
  Keyframe blind;
  blind.map = first;
  blind.parent = c;
  blind.odometry = OdometryEdge{c, {SE3d::exp(Vec6<double>::Constant(0.1)), Mat6<double>::Identity()}};
  map.add_keyframe(blind);
  return map;
}

MapParts parts_of(const Map& map) {
  MapParts parts;
  parts.map_count = map.map_count();
  for (std::uint32_t i = 0; i < map.keyframe_id_end(); ++i) {
    const Keyframe* keyframe = map.find(KeyframeId{i});
    parts.keyframes.push_back(keyframe ? std::make_unique<Keyframe>(*keyframe) : nullptr);
    if (const auto* removed = map.find_removed(KeyframeId{i})) parts.removed[KeyframeId{i}] = *removed;
  }
  for (std::uint32_t i = 0; i < map.point_id_end(); ++i) {
    const MapPoint* point = map.find(PointId{i});
    parts.points.push_back(point ? std::make_unique<MapPoint>(*point) : nullptr);
  }
  return parts;
}

}  // namespace

TEST_CASE("a map comes back from its parts and goes on") {
  const Map map = small_map();
  Map again(parts_of(map));
  CHECK(again.map_count() == 2);
  CHECK(again.keyframe_count() == 5);
  CHECK(again.keyframe_id_end() == 6);
  CHECK(again.point_count() == 5);
  CHECK(again.point_id_end() == 6);
  CHECK(again.shared_points(KeyframeId{0}, KeyframeId{1}) == 4);
  CHECK(again.T_camera_world(KeyframeId{4}).matrix() == map.T_camera_world(KeyframeId{4}).matrix());
  again.remove_keyframe(KeyframeId{2});
  again.merge_points(PointId{0}, PointId{1});
  CHECK(again.add_keyframe(blank_keyframe(MapId{1}, KeyframeId{3})) == KeyframeId{6});
  CHECK(!again.broken_invariant());
  CHECK(Map(MapParts{}).keyframe_count() == 0);
}

TEST_CASE("parts that break an invariant are refused by its name") {
  using Damage = std::function<void(MapParts&)>;
  const std::pair<const char*, Damage> damages[] = {
      {"point 0 has the id 9", [](MapParts& m) { m.points[0]->id = PointId{9}; }},
      {"point 5 has no observation", [](MapParts& m) { m.points[5]->observations.clear(); }},
      {"point 0 is seen by the dead keyframe 4",
       [](MapParts& m) { m.points[0]->observations[2].keyframe = KeyframeId{4}; }},
      {"point 0 is not known to keyframe 2", [](MapParts& m) { m.points[0]->observations[2].index = 5; }},
      {"point 0 is not known to keyframe 2", [](MapParts& m) { m.points[0]->observations[2].index = 600; }},
      {"point 0 has observations out of order",
       [](MapParts& m) { std::swap(m.points[0]->observations[0], m.points[0]->observations[1]); }},
      {"point 0 has observations out of order",
       [](MapParts& m) { m.points[0]->observations[1] = m.points[0]->observations[0]; }},
      {"keyframe 1 has the id 7", [](MapParts& m) { m.keyframes[1]->id = KeyframeId{7}; }},
      {"keyframe 0 is in no map", [](MapParts& m) { m.keyframes[0]->map = MapId{2}; }},
      {"keyframe 0 has not as many points", [](MapParts& m) { m.keyframes[0]->descriptors.pop_back(); }},
      {"keyframe 1 sees the dead point 4", [](MapParts& m) { m.keyframes[1]->points[5] = PointId{4}; }},
      {"keyframe 0 sees the dead point 77", [](MapParts& m) { m.keyframes[0]->points[5] = PointId{77}; }},
      {"keyframes hold", [](MapParts& m) { m.keyframes[3]->points[4] = PointId{5}; }},
      {"keyframe 0 is covisible with the dead keyframe 4",
       [](MapParts& m) { m.keyframes[0]->covisible[0].keyframe = KeyframeId{4}; }},
      {"keyframe 0 counts 3 points", [](MapParts& m) { m.keyframes[0]->covisible[0].points = 3; }},
      {"keyframe 3 counts 0 points",
       [](MapParts& m) {
         m.keyframes[3]->covisible.push_back({KeyframeId{1}, 0});
       }},
      {"keyframe 0 shares points with 2 keyframes, not 1",
       [](MapParts& m) { m.keyframes[0]->covisible.pop_back(); }},
      {"covisible keyframes out of order",
       [](MapParts& m) { std::swap(m.keyframes[0]->covisible[0], m.keyframes[0]->covisible[1]); }},
      {"keyframe 5 has odometry from a dead keyframe",
       [](MapParts& m) { m.keyframes[5]->odometry->from = KeyframeId{4}; }},
      {"keyframe 5 has odometry from another map",
       [](MapParts& m) { m.keyframes[5]->odometry->from = KeyframeId{3}; }},
      {"keyframe 2 has a dead parent", [](MapParts& m) { m.keyframes[2]->parent = KeyframeId{4}; }},
      {"keyframe 2 has no parent", [](MapParts& m) { m.keyframes[2]->parent = KeyframeId{70}; }},
      {"keyframe 2 has a parent in another map", [](MapParts& m) { m.keyframes[2]->parent = KeyframeId{3}; }},
      {"is its own ancestor", [](MapParts& m) { m.keyframes[2]->parent = KeyframeId{2}; }},
      {"is its own ancestor", [](MapParts& m) { m.keyframes[0]->parent = KeyframeId{2}; }},
      {"keyframe 4 is its own ancestor",
       [](MapParts& m) { m.removed[KeyframeId{4}].parent = KeyframeId{4}; }},
      {"keyframe 4 has no parent", [](MapParts& m) { m.removed[KeyframeId{4}].parent = KeyframeId{}; }},
      {"of 1 removed keyframes 0 are told", [](MapParts& m) { m.removed.clear(); }},
      {"of 1 removed keyframes 2 are told", [](MapParts& m) { m.removed[KeyframeId{9}] = {}; }},
      {"is not either living or removed",
       [](MapParts& m) {
         m.removed[KeyframeId{2}] = m.removed[KeyframeId{4}];
         m.removed.erase(KeyframeId{4});
       }},
  };
  for (const auto& [message, damage] : damages) {
    MapParts parts = parts_of(small_map());
    damage(parts);
    INFO(message);
    CHECK_THROWS_WITH(Map(std::move(parts)), Catch::Contains(message));
  }
}
