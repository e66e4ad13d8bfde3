// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/map/map.hpp"

#include <catch2/catch.hpp>
#include <cstdint>

#include "sweepkit/core/error.hpp"

using namespace sweepkit;

namespace {

constexpr int kMeasurements = 12;

Keyframe blank_keyframe(MapId map, KeyframeId parent) {
  Keyframe keyframe;
  keyframe.map = map;
  keyframe.parent = parent;
  keyframe.measurements.resize(kMeasurements);
  keyframe.descriptors.resize(kMeasurements);
  return keyframe;
}

// A small generator: the test needs variety, not quality.
struct Dice {
  std::uint64_t state;
  std::uint32_t operator()(std::uint32_t sides) {
    state = state * 6364136223846793005ull + 1442695040888963407ull;
    return static_cast<std::uint32_t>(state >> 33) % sides;
  }
};

}  // namespace

TEST_CASE("any sequence of operations keeps the invariants") {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    Dice dice{seed};
    Map map;
    const MapId id = map.add_map();
    KeyframeId last = map.add_keyframe(blank_keyframe(id, {}));
    for (int step = 0; step < 400; ++step) {
      const KeyframeId keyframe{dice(map.keyframe_id_end())};
      const PointId a{dice(map.point_id_end() + 1)}, b{dice(map.point_id_end() + 1)};
      const std::uint32_t index = dice(kMeasurements);
      switch (dice(8)) {
        case 0:
          last = map.add_keyframe(blank_keyframe(id, last));
          break;
        case 1:
        case 2:
          if (map.find(keyframe) && !map.keyframe(keyframe).points[index].valid())
            map.add_point({1, 2, 3}, keyframe, index);
          break;
        case 3:
        case 4:
        case 5:
          if (map.find(keyframe) && map.find(a)) map.add_observation(a, keyframe, index);
          break;
        case 6:
          if (map.find(a) && map.find(b) && a != b) {
            map.merge_points(a, b);
            REQUIRE(map.resolve(a) == b);
          } else if (map.find(a) && map.find(keyframe)) {
            map.remove_observation(a, keyframe);
          }
          break;
        case 7:
          if (dice(3) == 0 && map.find(keyframe) && map.keyframe(keyframe).parent.valid()) {
            if (keyframe == last) last = map.keyframe(keyframe).parent;
            map.remove_keyframe(keyframe);
          }
          break;
      }
      const auto broken = map.broken_invariant();
      INFO("seed " << seed << ", step " << step << ": " << broken.value_or(""));
      REQUIRE(!broken);
    }
    CHECK(map.keyframe_count() > 10);
  }
}

TEST_CASE("covisibility counts shared points") {
  Map map;
  const MapId id = map.add_map();
  const KeyframeId a = map.add_keyframe(blank_keyframe(id, {}));
  const KeyframeId b = map.add_keyframe(blank_keyframe(id, a));
  const KeyframeId c = map.add_keyframe(blank_keyframe(id, b));
  for (std::uint32_t i = 0; i < 5; ++i) {
    const PointId p = map.add_point({0, 0, 1}, a, i);
    CHECK(map.add_observation(p, b, i));
    if (i < 2) CHECK(map.add_observation(p, c, i));
  }
  CHECK(map.shared_points(a, b) == 5);
  CHECK(map.shared_points(c, a) == 2);
  const auto best = map.best_covisible(a, 5);
  REQUIRE(best.size() == 2);
  CHECK(best[0].keyframe == b);
  CHECK(map.best_covisible(a, 5, 3).size() == 1);

  map.remove_keyframe(b);
  CHECK(map.keyframe(c).parent == a);
  CHECK(map.shared_points(a, c) == 2);
  CHECK(map.point_count() == 5);
}

TEST_CASE("wrong use says what and where") {
  Map map;
  const MapId id = map.add_map();
  const KeyframeId a = map.add_keyframe(blank_keyframe(id, {}));
  const PointId p = map.add_point({0, 0, 1}, a, 0);
  CHECK_THROWS_AS(map.remove_keyframe(a), Error);
  CHECK_THROWS_AS(map.add_point({0, 0, 1}, a, 0), Error);
  CHECK_THROWS_AS(map.add_point({0, 0, 1}, a, kMeasurements), Error);
  CHECK_THROWS_AS(map.merge_points(p, p), Error);
  CHECK_THROWS_AS(map.add_keyframe(blank_keyframe(MapId{7}, {})), Error);
  CHECK_THROWS_WITH(map.keyframe(KeyframeId{9}), Catch::Contains("9"));
  CHECK(!map.broken_invariant());
  CHECK(map.point_count() == 1);
}

TEST_CASE("a removed keyframe keeps its place beside its parent") {
  Map map;
  const MapId id = map.add_map();
  const KeyframeId a = map.add_keyframe(blank_keyframe(id, {}));
  Keyframe next = blank_keyframe(id, a);
  next.T_camera_world = SE3d::exp((Vec6<double>() << 1, 2, 3, 0.1, 0.2, 0.3).finished());
  const KeyframeId b = map.add_keyframe(next);
  next.parent = b;
  next.T_camera_world = SE3d::exp((Vec6<double>() << 2, 1, 0, 0.3, 0.1, 0.2).finished());
  const KeyframeId c = map.add_keyframe(next);
  const SE3d T_c_world = map.T_camera_world(c);
  map.remove_keyframe(c);
  map.remove_keyframe(b);
  CHECK((map.T_camera_world(c).matrix() - T_c_world.matrix()).norm() < 1e-12);

  const SE3d T_shift = SE3d::exp((Vec6<double>() << 5, 0, 0, 0, 0, 1).finished());
  map.set_pose(a, map.T_camera_world(a) * T_shift);
  CHECK((map.T_camera_world(c).matrix() - (T_c_world * T_shift).matrix()).norm() < 1e-12);
}
