// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <malloc.h>

#include <catch2/catch.hpp>

#include "sweepkit/map/impl/id_table.hpp"
#include "sweepkit/map/map.hpp"

using namespace sweepkit;

namespace {

KeyframeId add(Map& map, MapId id, KeyframeId parent, std::size_t measurements) {
  Keyframe keyframe;
  keyframe.map = id;
  keyframe.parent = parent;
  keyframe.measurements.resize(measurements);
  keyframe.descriptors.resize(measurements);
  return map.add_keyframe(keyframe);
}

}  // namespace

TEST_CASE("a table of ids gives back what is gone") {
  impl::IdTable<int> table;
  for (int i = 0; i < 10000; ++i) table.push_back(i % 7 ? std::make_unique<int>(i) : nullptr);
  CHECK(table.end() == 10000);
  CHECK(table.living() == 10000 - 1429);
  CHECK(table.find(7) == nullptr);
  CHECK(*table.find(8) == 8);
  CHECK(table.find(10000) == nullptr);
  const std::size_t full = table.memory_bytes();
  for (std::uint32_t i = 0; i < 9000; ++i)
    if (table.find(i)) table.erase(i);
  CHECK(table.find(8) == nullptr);
  CHECK(*table.find(9001) == 9001);
  CHECK(table.living() == 857);
  CHECK(table.memory_bytes() < full / 7);
}

TEST_CASE("the memory of a map is what malloc says") {
  // Sanitizers have a malloc of their own.
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
  const auto before = mallinfo2();
  Map map;
  const MapId id = map.add_map();
  KeyframeId last;
  for (int k = 0; k < 100; ++k) {
    const KeyframeId next = add(map, id, last, 500);
    for (std::uint32_t i = 0; i < 300; ++i) {
      if (last.valid() && i < 200)
        map.add_observation(map.keyframe(last).points[i], next, i);
      else
        map.add_point({1, 2, 3}, next, i);
    }
    last = next;
  }
  const auto after = mallinfo2();
  const auto taken = static_cast<double>(after.uordblks + after.hblkhd - before.uordblks - before.hblkhd);
  CHECK(static_cast<double>(map.memory_bytes()) == Approx(taken).epsilon(0.05));
#endif
}

TEST_CASE("a map whose keyframes and points come and go does not grow") {
  Map map;
  const MapId id = map.add_map();
  const KeyframeId root = add(map, id, {}, 1);
  std::vector<KeyframeId> alive{root};
  std::size_t early = 0;
  for (int k = 0; k < 6000; ++k) {
    const KeyframeId next = add(map, id, alive.back(), 60);
    for (std::uint32_t i = 0; i < 60; ++i) map.add_point({1, 2, 3}, next, i);
    for (std::uint32_t i = 1; i < 20; ++i)
      map.merge_points(map.keyframe(next).points[i], map.keyframe(next).points[0]);
    alive.push_back(next);
    if (alive.size() > 20) {
      map.remove_keyframe(alive[1]);
      alive.erase(alive.begin() + 1);
    }
    if (k == 1000) early = map.memory_bytes();
  }
  CHECK(map.point_id_end() == 360000);
  // What grows: a record for each removed keyframe and the ids themselves.
  CHECK(map.memory_bytes() - early < 5000 * 200 + 310000 / 256 * 16);
  CHECK(!map.broken_invariant());
}

TEST_CASE("a merge is remembered for hundreds of keyframes, not for ever") {
  Map map;
  const MapId id = map.add_map();
  KeyframeId last = add(map, id, {}, 2);
  const PointId a = map.add_point({1, 2, 3}, last, 0), b = map.add_point({1, 2, 3}, last, 1);
  map.merge_points(a, b);
  for (int k = 0; k < 250; ++k) last = add(map, id, last, 1);
  CHECK(map.resolve(a) == b);
  for (int k = 0; k < 400; ++k) last = add(map, id, last, 1);
  CHECK(!map.resolve(a).valid());
  CHECK(map.resolve(b) == b);
}
