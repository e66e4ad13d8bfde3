// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/map_culling.hpp"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>
#include <set>
#include <vector>

#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

// A flat of landmarks, and a robot that goes through it again and again.
class Drive {
 public:
  explicit Drive(std::uint64_t seed) : random_(seed) {
    for (int i = 0; i < 400; ++i)
      landmarks_.push_back({random_.uniform(-1, 11), random_.uniform(-1, 7), random_.uniform(-0.3, 2)});
    point_of_.resize(landmarks_.size());
    id_ = map.add_map();
  }

  // One way round, with a turn on the spot at each corner.
  void round() {
    const Vec3<double> corners[] = {{0, 0, 0}, {10, 0, 0}, {10, 6, 0}, {5, 6, 0}, {5, 3, 0}, {0, 3, 0}};
    for (std::size_t c = 0; c < std::size(corners); ++c) {
      const Vec3<double> from = corners[c], to = corners[(c + 1) % std::size(corners)];
      const double yaw = std::atan2(to.y() - from.y(), to.x() - from.x());
      for (double s = 0; s < (to - from).norm(); s += 0.3)
        keyframe(from + s * (to - from).normalized() + noise(0.02), yaw + random_.normal() * 0.03);
      for (int turn = 0; turn < 6; ++turn) keyframe(to + noise(0.02), yaw + turn * std::numbers::pi / 3);
    }
  }

  void keyframe(const Vec3<double>& p, double yaw) {
    // The camera looks along its z axis, its y axis down.
    Mat3<double> R;
    R << std::sin(yaw), 0, std::cos(yaw), -std::cos(yaw), 0, std::sin(yaw), 0, -1, 0;
    Keyframe next;
    next.map = id_;
    next.parent = last_;
    next.T_camera_world = SE3d(SO3d(R), p).inverse();
    std::vector<std::size_t> seen;
    for (std::size_t i = 0; i < landmarks_.size(); ++i) {
      const Vec3<double> q = next.T_camera_world * landmarks_[i];
      if (q.z() > 0.3 && q.z() < 4 && std::abs(q.x()) < q.z() && random_.uniform() < 0.9) seen.push_back(i);
    }
    next.measurements.resize(seen.size() + 1);
    next.descriptors.resize(seen.size() + 1);
    if (last_.valid() && map.keyframe_id_end() % 17 == 0) {  // the lights go off
      next.measurements.clear();
      next.descriptors.clear();
      seen.clear();
    }
    last_ = map.add_keyframe(std::move(next));
    for (std::uint32_t k = 0; k < seen.size(); ++k) {
      PointId& point = point_of_[seen[k]];
      if (map.find(point))
        map.add_observation(point, last_, k);
      else
        point = map.add_point(landmarks_[seen[k]], last_, k);
    }
  }

  KeyframeId last() const { return last_; }

  Map map;

 private:
  Vec3<double> noise(double sigma) {
    return {sigma * random_.normal(), sigma * random_.normal(), 0.1 * sigma * random_.normal()};
  }

  Random random_;
  std::vector<Vec3<double>> landmarks_;
  std::vector<PointId> point_of_;
  MapId id_;
  KeyframeId last_;
};

std::vector<KeyframeId> keyframes_of(const Map& map) {
  std::vector<KeyframeId> ids;
  for (std::uint32_t i = 0; i < map.keyframe_id_end(); ++i)
    if (map.find(KeyframeId{i})) ids.push_back(KeyframeId{i});
  return ids;
}

Map after(std::uint64_t seed, int rounds, const std::vector<KeyframeId>& culls) {
  Drive drive(seed);
  for (int r = 0; r < rounds; ++r) drive.round();
  for (const KeyframeId id : culls) drive.map.remove_keyframe(id);
  REQUIRE(!drive.map.broken_invariant());
  return std::move(drive.map);
}

bool sees(const Keyframe& keyframe) {
  return std::any_of(keyframe.points.begin(), keyframe.points.end(), [](PointId p) { return p.valid(); });
}

}  // namespace

TEST_CASE("a map within its caps is left alone") {
  Drive drive(1);
  CHECK(choose_culls(drive.map, {}).empty());
  drive.round();
  CHECK(choose_culls(drive.map, {}).empty());
  const int count = static_cast<int>(drive.map.keyframe_count());
  CHECK(choose_culls(drive.map, {.max_keyframes = count}).empty());
  CHECK(!choose_culls(drive.map, {.max_keyframes = count - 1}).empty());
}

TEST_CASE("the caps hold, and what must stay stays") {
  Drive drive(2);
  for (int r = 0; r < 3; ++r) drive.round();
  const std::vector<KeyframeId> all = keyframes_of(drive.map);
  const std::vector<KeyframeId> keep(all.end() - 20, all.end());
  for (const int cap : {300, 100, 40, 25}) {
    const MapCaps caps{.max_keyframes = cap, .slack = 0};
    const auto culls = choose_culls(drive.map, caps, keep);
    CHECK(culls == choose_culls(drive.map, caps, keep));
    CHECK(all.size() - culls.size() == static_cast<std::size_t>(cap));
    const std::set<KeyframeId> gone(culls.begin(), culls.end());
    CHECK(gone.size() == culls.size());
    CHECK(gone.count(all.front()) == 0);
    for (const KeyframeId id : keep) CHECK(gone.count(id) == 0);
  }
  // What has to stay is more than the cap.
  CHECK(choose_culls(drive.map, {.max_keyframes = 5}, keep).size() == all.size() - 21);

  const MapCaps small{.max_memory = 0.6e-6 * static_cast<double>(drive.map.memory_bytes())};
  for (const KeyframeId id : choose_culls(drive.map, small, keep)) drive.map.remove_keyframe(id);
  CHECK(static_cast<double>(drive.map.memory_bytes()) <= 1e6 * small.max_memory);
  CHECK(static_cast<double>(drive.map.memory_bytes()) > 0.8e6 * small.max_memory);
  CHECK(choose_culls(drive.map, small, keep).empty());
}

TEST_CASE("no view is lost while another is shown twice") {
  for (const std::uint64_t seed : {3, 4}) {
    const Map whole = after(seed, 3, {});
    const std::vector<KeyframeId> all = keyframes_of(whole);
    for (const std::size_t cap : {400, 200, 100, 50, 20, 5}) {
      const MapCaps caps{.max_keyframes = static_cast<int>(cap), .slack = 0};
      const auto culls = choose_culls(whole, caps);
      // What else could have been done: to forget the newest, or any.
      const std::vector<KeyframeId> newest(all.end() - static_cast<std::ptrdiff_t>(culls.size()), all.end());
      std::vector<KeyframeId> random(all.begin() + 1, all.end());
      Random(seed).shuffle(std::span<KeyframeId>(random));
      random.resize(culls.size());
      const Map ours = after(seed, 3, culls), without_newest = after(seed, 3, newest),
                by_chance = after(seed, 3, random);
      for (int doublings = 0; doublings < 6; ++doublings) {
        const std::size_t kept = count_views(ours, caps, doublings);
        INFO("cap " << cap << ", doublings " << doublings);
        CHECK(kept == std::min(count_views(whole, caps, doublings), cap));  // there cannot be more
        CHECK(kept >= count_views(without_newest, caps, doublings));
        CHECK(kept >= count_views(by_chance, caps, doublings));
      }
    }
  }
}

TEST_CASE("keyframes that see nothing go first, then those whose points others see") {
  Drive drive(5);
  drive.round();
  drive.round();
  const int count = static_cast<int>(drive.map.keyframe_count());
  std::size_t blind = 0;
  for (const KeyframeId id : keyframes_of(drive.map)) blind += !sees(drive.map.keyframe(id));
  REQUIRE(blind > 5);
  const auto culls =
      choose_culls(drive.map, {.max_keyframes = count - static_cast<int>(blind) - 3, .slack = 0});
  REQUIRE(culls.size() == blind + 3);
  for (std::size_t i = 0; i < blind; ++i) CHECK(!sees(drive.map.keyframe(culls[i])));
  for (std::size_t i = blind; i < culls.size(); ++i) CHECK(sees(drive.map.keyframe(culls[i])));
}

TEST_CASE("driving on and on takes no more memory than the cap") {
  Drive drive(6);
  drive.round();
  const std::size_t views = count_views(drive.map, {});
  const MapCaps caps{.max_keyframes =
                         static_cast<int>(1.5 * static_cast<double>(drive.map.keyframe_count()))};
  std::size_t early = 0;
  for (int r = 2; r <= 12; ++r) {
    drive.round();
    const KeyframeId last = drive.last();
    for (const KeyframeId id : choose_culls(drive.map, caps, {&last, 1})) drive.map.remove_keyframe(id);
    REQUIRE(drive.map.keyframe_count() <= static_cast<std::size_t>(caps.max_keyframes));
    if (r == 3) early = drive.map.memory_bytes();
    CHECK(count_views(drive.map, {}) >= views);
  }
  // A record of each keyframe removed remains: 150 bytes, 150 times a round.
  CHECK(static_cast<double>(drive.map.memory_bytes()) < 1.1 * static_cast<double>(early) + 9 * 150 * 150);
  CHECK(!drive.map.broken_invariant());
}
