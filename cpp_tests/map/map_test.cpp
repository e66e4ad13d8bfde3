// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/map/map.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

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

TEST_CASE("odometry of a removed keyframe joins what it stood between") {
  Map map;
  const MapId id = map.add_map();
  const auto edge = [](KeyframeId from, int seed) {
    Vec6<double> xi;
    Mat6<double> A;
    for (int i = 0; i < 6; ++i) xi[i] = 0.3 * std::sin(1.7 * seed + i);
    for (int i = 0; i < 36; ++i) A(i) = 0.01 * std::cos(2.3 * seed + i);
    return OdometryEdge{from, {SE3d::exp(xi), A * A.transpose() + 1e-5 * Mat6<double>::Identity()}};
  };
  std::vector<KeyframeId> ids;
  for (int k = 0; k < 4; ++k) {
    Keyframe keyframe = blank_keyframe(id, k > 0 ? ids.back() : KeyframeId{});
    if (k > 0) keyframe.odometry = edge(ids.back(), k);
    ids.push_back(map.add_keyframe(keyframe));
  }
  map.remove_keyframe(ids[1]);
  CHECK(!map.broken_invariant());
  map.remove_keyframe(ids[2]);
  CHECK(!map.broken_invariant());
  REQUIRE(map.keyframe(ids[3]).odometry);
  const OdometryEdge joined = *map.keyframe(ids[3]).odometry;
  CHECK(joined.from == ids[0]);

  // T = A Exp(a) B Exp(b) C Exp(c): the errors carried to the end by central differences.
  const UncertainMotion<double> A = edge(ids[0], 1).motion, B = edge(ids[1], 2).motion,
                                C = edge(ids[2], 3).motion;
  const SE3d T = A.T * B.T * C.T;
  CHECK((joined.motion.T.matrix() - T.matrix()).norm() < 1e-12);
  Mat6<double> J_a, J_b;
  constexpr double h = 1e-6;
  for (int i = 0; i < 6; ++i) {
    const Vec6<double> d = h * Vec6<double>::Unit(i);
    const auto end = [&](const SE3d& moved) { return Vec6<double>((T.inverse() * moved).log()); };
    J_a.col(i) = (end(A.T * SE3d::exp(d) * B.T * C.T) - end(A.T * SE3d::exp(-d) * B.T * C.T)) / (2 * h);
    J_b.col(i) = (end(A.T * B.T * SE3d::exp(d) * C.T) - end(A.T * B.T * SE3d::exp(-d) * C.T)) / (2 * h);
  }
  const Mat6<double> expected =
      J_a * A.covariance * J_a.transpose() + J_b * B.covariance * J_b.transpose() + C.covariance;
  CHECK((joined.motion.covariance - expected).norm() < 1e-7 * expected.norm());
}

TEST_CASE("odometry ends where a removed keyframe had none") {
  Map map;
  const MapId id = map.add_map();
  const KeyframeId a = map.add_keyframe(blank_keyframe(id, {}));
  const KeyframeId b = map.add_keyframe(blank_keyframe(id, a));  // no odometry came with it
  Keyframe next = blank_keyframe(id, b);
  next.odometry = OdometryEdge{b, {SE3d(), Mat6<double>::Identity()}};
  const KeyframeId c = map.add_keyframe(next);
  map.remove_keyframe(b);
  CHECK(!map.keyframe(c).odometry);
  CHECK(!map.broken_invariant());
}

TEST_CASE("blind keyframes hang on odometry alone") {
  Map map;
  const MapId id = map.add_map();
  const KeyframeId a = map.add_keyframe(blank_keyframe(id, {}));
  const PointId p = map.add_point({0, 0, 1}, a, 0);
  Keyframe blind;
  blind.map = id;
  blind.parent = a;
  blind.odometry = OdometryEdge{a, {SE3d::exp(Vec6<double>::Constant(0.1)), Mat6<double>::Identity()}};
  const KeyframeId b = map.add_keyframe(blind);
  CHECK(map.keyframe(b).blind());
  CHECK_FALSE(map.keyframe(a).blind());
  CHECK_THROWS_AS(map.add_observation(p, b, 0), Error);
  CHECK_THROWS_AS(map.add_point({0, 0, 1}, b, 0), Error);
  CHECK(map.shared_points(a, b) == 0);
  CHECK(!map.broken_invariant());
  map.shift_disparities(0.3);
  Keyframe next = blank_keyframe(id, b);
  next.odometry = OdometryEdge{b, {SE3d(), Mat6<double>::Identity()}};
  const KeyframeId c = map.add_keyframe(next);
  map.remove_keyframe(b);
  CHECK(!map.broken_invariant());
  CHECK(map.keyframe(c).odometry->from == a);
  CHECK(map.keyframe(c).parent == a);
}

TEST_CASE("odometry that comes from nowhere or from another map is a broken invariant or an error") {
  const auto broken = [](Map& map, const Keyframe& keyframe) {
    try {
      map.add_keyframe(keyframe);
    } catch (const Error&) {
      return true;
    }
    const auto text = map.broken_invariant();
    return text && text->find("odometry") != std::string::npos;
  };
  {
    Map map;
    const MapId id = map.add_map();
    const KeyframeId a = map.add_keyframe(blank_keyframe(id, {}));
    Keyframe keyframe = blank_keyframe(id, a);
    keyframe.odometry = OdometryEdge{KeyframeId{9}, {}};
    CHECK(broken(map, keyframe));
  }
  Map map;
  const MapId one = map.add_map(), other = map.add_map();
  const KeyframeId a = map.add_keyframe(blank_keyframe(one, {}));
  Keyframe keyframe = blank_keyframe(other, {});
  keyframe.odometry = OdometryEdge{a, {}};
  CHECK(broken(map, keyframe));
}

TEST_CASE("joined maps are one tree, and what was seen is where it was seen") {
  Map map;
  const MapId a = map.add_map(), b = map.add_map();
  const auto add = [&](MapId id, KeyframeId parent, double x) {
    Keyframe keyframe = blank_keyframe(id, parent);
    keyframe.T_camera_world = SE3d::exp(Vec6<double>{x, 0.2, -0.1, 0.1 * x, 0.3, -0.2});
    return map.add_keyframe(keyframe);
  };
  const KeyframeId a0 = add(a, {}, 0), a1 = add(a, a0, 1);
  const KeyframeId b0 = add(b, {}, 2), b1 = add(b, b0, 3), gone = add(b, b1, 3.5), b2 = add(b, b1, 4);
  const KeyframeId b3 = add(b, b0, 5);
  const PointId in_a = map.add_point({1, 2, 3}, a1, 0), in_b = map.add_point({4, 5, 6}, b2, 0);
  map.add_observation(in_b, b3, 1);
  map.remove_keyframe(gone);
  CHECK(map.maps() == std::vector<MapId>{a, b});

  const SE3d T_a_b = SE3d::exp(Vec6<double>{1, 2, 3, 0.4, -0.5, 0.6});
  const Vec3<double> seen_before = map.T_camera_world(b2) * map.point(in_b).p_world;
  const SE3d between_before = map.T_camera_world(gone) * map.T_camera_world(b0).inverse();
  const SE3d T_b2_b = map.T_camera_world(b2);
  map.join_maps(b2, a1, T_a_b);

  CHECK_FALSE(map.broken_invariant());
  CHECK(map.maps() == std::vector<MapId>{a});
  CHECK(map.keyframe(b2).parent == a1);
  CHECK(map.keyframe(b1).parent == b2);
  CHECK(map.keyframe(b0).parent == b1);
  CHECK(map.keyframe(b3).parent == b0);
  CHECK((map.T_camera_world(b2) * map.point(in_b).p_world - seen_before).norm() < 1e-12);
  CHECK((map.T_camera_world(b2) * T_a_b * T_b2_b.inverse()).log().norm() < 1e-12);
  CHECK(
      (map.T_camera_world(gone) * map.T_camera_world(b0).inverse() * between_before.inverse()).log().norm() <
      1e-12);
  CHECK(map.point(in_a).p_world == Vec3<double>(1, 2, 3));
  CHECK_THROWS_AS(map.join_maps(b2, a1, SE3d()), Error);
}
