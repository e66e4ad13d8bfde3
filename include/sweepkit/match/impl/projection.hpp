// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "sweepkit/core/error.hpp"
#include "sweepkit/match/projection.hpp"

namespace sweepkit {

template <ProjectableKeypoint Keypoint>
int ProjectionMatcher::match(std::span<const ProjectionQuery> queries,
                             std::span<const OrbDescriptor> query_descriptors, const KeypointGrid& grid,
                             std::span<const Keypoint> keypoints, std::span<const OrbDescriptor> descriptors,
                             std::span<Match> matches, std::span<const std::uint8_t> taken) {
  require(query_descriptors.size() == queries.size(), "ProjectionMatcher::match query_descriptors",
          "must be as long as queries", query_descriptors.size());
  require(descriptors.size() == keypoints.size(), "ProjectionMatcher::match descriptors",
          "must be as long as keypoints", descriptors.size());
  require(matches.size() == queries.size(), "ProjectionMatcher::match matches", "must be as long as queries",
          matches.size());
  require(taken.empty() || taken.size() == keypoints.size(), "ProjectionMatcher::match taken",
          "must be as long as keypoints", taken.size());
  require(grid.size() <= keypoints.size(), "ProjectionMatcher::match grid", "must be built over keypoints",
          grid.size());

  const auto u = grid.u(), v = grid.v();
  const auto octave = grid.octave(), index = grid.index();
  owner_.assign(keypoints.size(), -1);
  for (std::size_t i = 0; i < queries.size(); ++i) {
    const ProjectionQuery& q = queries[i];
    matches[i] = {};
    // Distance first, then index, so that the winner does not hang on the order of the cells.
    std::uint64_t best = std::numeric_limits<std::uint64_t>::max(), second = best;
    const auto scan = [&](std::int32_t first, std::int32_t last) {
      for (std::int32_t k = first; k < last; ++k) {
        if (!(std::abs(u[k] - q.u) <= q.radius) || !(std::abs(v[k] - q.v) <= q.radius)) continue;
        if (octave[k] < q.min_octave || octave[k] > q.max_octave) continue;
        const std::int32_t j = index[k];
        if (!taken.empty() && taken[j]) continue;
        const float u_right = keypoints[j].u_right;
        if (q.u_right >= 0 && u_right >= 0 && std::abs(u_right - q.u_right) > q.radius) continue;
        const auto distance =
            static_cast<std::uint64_t>(hamming_distance(query_descriptors[i], descriptors[j]));
        const std::uint64_t key = distance << 32 | static_cast<std::uint32_t>(j);
        if (key < best) {
          second = best;
          best = key;
        } else if (key < second) {
          second = key;
        }
      }
    };
    grid.for_each_range(q.u - q.radius, q.u + q.radius, q.v - q.radius, q.v + q.radius, scan);

    if (best == std::numeric_limits<std::uint64_t>::max()) continue;
    const auto distance = static_cast<std::int32_t>(best >> 32);
    const auto j = static_cast<std::int32_t>(best & 0xffffffffu);
    if (distance > options_.max_distance) continue;
    if (options_.ratio < 1 && second != std::numeric_limits<std::uint64_t>::max()) {
      const auto distance2 = static_cast<std::int32_t>(second >> 32);
      const auto j2 = static_cast<std::int32_t>(second & 0xffffffffu);
      if (keypoints[j].octave == keypoints[j2].octave && distance > options_.ratio * distance2) continue;
    }
    const std::int32_t rival = owner_[j];
    if (rival >= 0) {
      if (matches[rival].distance <= distance) continue;
      matches[rival] = {};
    }
    owner_[j] = static_cast<std::int32_t>(i);
    matches[i] = {j, distance};
  }

  if (options_.check_orientation) {
    orientation_.clear();
    for (std::size_t i = 0; i < queries.size(); ++i)
      if (matches[i].found()) orientation_.add(queries[i].angle, keypoints[matches[i].index].angle);
    orientation_.finish();
    std::size_t k = 0;
    for (Match& match : matches)
      if (match.found() && !orientation_.agrees(k++)) match = {};
  }
  return static_cast<int>(std::ranges::count_if(matches, &Match::found));
}

}  // namespace sweepkit
