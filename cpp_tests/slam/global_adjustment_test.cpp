// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/global_adjustment.hpp"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <map>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

constexpr StereoRig::Bounds kView{0, 639, 0, 399};

// Keyframes that see points at random places, each the points of its own stretch of the way.
struct Drive {
  Map map;
  std::vector<KeyframeId> keyframes;

  explicit Drive(std::uint64_t seed) {
    Random random(seed);
    const MapId id = map.add_map();
    std::vector<PointId> known(1500);
    for (int k = 0; k < 40; ++k) {
      Keyframe keyframe;
      keyframe.map = id;
      keyframe.t = k * kNsPerSecond;
      std::vector<std::size_t> seen;
      for (std::size_t p = 0; p < known.size(); ++p) {
        const double along = std::abs(static_cast<double>(p) - 30.0 * k);
        if (random.uniform() > 0.8 * std::exp(-along / 80)) continue;
        Measurement m;
        m.u = static_cast<float>(random.uniform(0, 639));
        m.v = static_cast<float>(399 * std::pow(random.uniform(), 2));  // crowded at the top
        keyframe.measurements.push_back(m);
        seen.push_back(p);
      }
      keyframe.descriptors.resize(keyframe.measurements.size());
      keyframes.push_back(map.add_keyframe(keyframe));
      for (std::uint32_t i = 0; i < seen.size(); ++i) {
        PointId& point = known[seen[i]];
        if (point.valid())
          map.add_observation(point, keyframes.back(), i);
        else
          point = map.add_point(Vec3<double>::Zero(), keyframes.back(), i);
      }
    }
  }
};

std::vector<Observation> seen_by(const Map& map, PointId point, const std::vector<KeyframeId>& keyframes) {
  std::vector<Observation> all;
  for (const Observation& o : map.point(point).observations)
    if (std::find(keyframes.begin(), keyframes.end(), o.keyframe) != keyframes.end()) all.push_back(o);
  return all;
}

}  // namespace

TEST_CASE("points that hold a map together reach every part of every keyframe", "[slam]") {
  const Drive drive(3);
  const std::vector<KeyframeId> some(drive.keyframes.begin() + 4, drive.keyframes.end());
  std::vector<PointId> shared;
  for (std::uint32_t p = 0; p < drive.map.point_id_end(); ++p)
    if (seen_by(drive.map, PointId{p}, some).size() > 1) shared.push_back(PointId{p});
  CHECK(choose_points(drive.map, some, kView, 100000) == shared);

  const int quota = 2;
  const std::vector<PointId> chosen = choose_points(drive.map, some, kView, 16 * quota);
  CHECK(std::is_sorted(chosen.begin(), chosen.end()));
  CHECK(chosen.size() < shared.size() / 2);
  CHECK(std::includes(shared.begin(), shared.end(), chosen.begin(), chosen.end()));
  using Cells = std::map<std::pair<KeyframeId, int>, int>;
  const auto count = [&](const std::vector<PointId>& points) {
    Cells cells;
    for (const PointId point : points)
      for (const Observation& o : seen_by(drive.map, point, some)) {
        const Measurement& m = drive.map.keyframe(o.keyframe).measurements[o.index];
        ++cells[{o.keyframe, 4 * std::min(3, static_cast<int>(m.v * 4 / 399)) +
                                 std::min(3, static_cast<int>(m.u * 4 / 639))}];
      }
    return cells;
  };
  Cells there = count(shared), taken = count(chosen);
  for (const auto& [cell, available] : there) CHECK(taken[cell] >= std::min(quota, available));
  // Those that many see come first.
  const auto mean = [&](const std::vector<PointId>& points) {
    double sum = 0;
    for (const PointId point : points) sum += static_cast<double>(seen_by(drive.map, point, some).size());
    return sum / static_cast<double>(points.size());
  };
  CHECK(mean(chosen) > 1.1 * mean(shared));
  CHECK_THROWS_AS(choose_points(drive.map, some, kView, 0), Error);
}
