// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/global_adjustment.hpp"

#include <algorithm>
#include <array>
#include <cstdint>

#include "sweepkit/core/error.hpp"

namespace sweepkit {
namespace {

constexpr int kCells = 4;  // along each side of the image

struct Candidate {
  PointId point;
  int seen_by;
};

}  // namespace

std::vector<PointId> choose_points(const Map& map, const std::vector<KeyframeId>& keyframes,
                                   const StereoRig::Bounds& view, int each) {
  require(each > 0, "choose_points", "each must be positive", each);
  std::vector<int> rank(map.keyframe_id_end(), -1);
  for (std::size_t i = 0; i < keyframes.size(); ++i) rank[keyframes[i].value] = static_cast<int>(i);
  std::vector<Candidate> candidates;
  for (std::uint32_t i = 0; i < map.point_id_end(); ++i) {
    const MapPoint* point = map.find(PointId{i});
    if (!point) continue;
    const auto seen_by = std::count_if(point->observations.begin(), point->observations.end(),
                                       [&](const Observation& o) { return rank[o.keyframe.value] >= 0; });
    if (seen_by > 1) candidates.push_back({point->id, static_cast<int>(seen_by)});
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.seen_by > b.seen_by; });

  const int quota = std::max(1, each / (kCells * kCells));
  std::vector<std::array<std::uint16_t, kCells * kCells>> chosen(keyframes.size());
  const auto cell_of = [&](const Measurement& m) {
    const auto along = [](double x, double from, double to) {
      return std::clamp(static_cast<int>(kCells * (x - from) / (to - from)), 0, kCells - 1);
    };
    return static_cast<std::size_t>(kCells * along(m.v, view.v_min, view.v_max) +
                                    along(m.u, view.u_min, view.u_max));
  };
  std::vector<PointId> points;
  for (const Candidate& candidate : candidates) {
    const MapPoint& point = map.point(candidate.point);
    bool wanted = false;
    for (const Observation& o : point.observations)
      if (const int k = rank[o.keyframe.value]; k >= 0)
        wanted |=
            chosen[static_cast<std::size_t>(k)][cell_of(map.keyframe(o.keyframe).measurements[o.index])] <
            quota;
    if (!wanted) continue;
    points.push_back(point.id);
    for (const Observation& o : point.observations)
      if (const int k = rank[o.keyframe.value]; k >= 0)
        ++chosen[static_cast<std::size_t>(k)][cell_of(map.keyframe(o.keyframe).measurements[o.index])];
  }
  std::sort(points.begin(), points.end());
  return points;
}

}  // namespace sweepkit
