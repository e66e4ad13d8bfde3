// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/match/projection.hpp"

#include <catch2/catch.hpp>
#include <map>

#include "match/random_features.hpp"

using namespace sweepkit;

namespace {

struct FrameKeypoint {
  float u = 0, v = 0, u_right = -1, angle = 0;
  std::int32_t octave = 0;
};

struct Scene {
  std::vector<FrameKeypoint> keypoints;
  std::vector<OrbDescriptor> descriptors, query_descriptors;
  std::vector<ProjectionQuery> queries;
  std::vector<std::uint8_t> taken;
};

Scene random_scene(Random& random, int count) {
  Scene s;
  const Features<256> f = random_features(random, count);
  for (const KeyPoint& k : f.keypoints) {
    s.keypoints.push_back({k.x, k.y, random.uniform() < 0.5 ? k.x - 20 : -1, k.angle, k.octave});
    s.taken.push_back(random.uniform() < 0.1);
  }
  s.descriptors = f.descriptors;
  for (int i = 0; i < count; ++i) {
    const auto j = random.index(count);
    const FrameKeypoint& k = s.keypoints[j];
    s.queries.push_back(
        {.u = k.u + static_cast<float>(random.normal(0, 8)),
         .v = k.v + static_cast<float>(random.normal(0, 8)),
         .u_right = random.uniform() < 0.5 ? k.u - 20 + static_cast<float>(random.normal(0, 8)) : -1,
         .radius = static_cast<float>(random.uniform(5, 60)),
         .min_octave = k.octave - 1,
         .max_octave = k.octave + 2,
         .angle = k.angle});
    s.query_descriptors.push_back(disturbed(random, f.descriptors[j], 60));
  }
  return s;
}

std::vector<Match> slow_match(const Scene& s, const ProjectionOptions& o) {
  std::vector<Match> wish(s.queries.size());
  for (std::size_t i = 0; i < s.queries.size(); ++i) {
    const ProjectionQuery& q = s.queries[i];
    std::map<std::pair<int, int>, int> ranking;  // distance, index
    for (std::size_t j = 0; j < s.keypoints.size(); ++j) {
      const FrameKeypoint& k = s.keypoints[j];
      if (s.taken[j] || std::abs(k.u - q.u) > q.radius || std::abs(k.v - q.v) > q.radius) continue;
      if (k.octave < q.min_octave || k.octave > q.max_octave) continue;
      if (q.u_right >= 0 && k.u_right >= 0 && std::abs(q.u_right - k.u_right) > q.radius) continue;
      const int distance = hamming_distance(s.query_descriptors[i], s.descriptors[j]);
      ranking[{distance, static_cast<int>(j)}] = k.octave;
    }
    if (ranking.empty()) continue;
    const auto best = ranking.begin(), second = std::next(best);
    if (best->first.first > o.max_distance) continue;
    if (o.ratio < 1 && second != ranking.end() && second->second == best->second &&
        best->first.first > o.ratio * second->first.first)
      continue;
    wish[i] = {best->first.second, best->first.first};
  }
  std::vector<Match> matches = wish;
  for (std::size_t i = 0; i < wish.size(); ++i)
    for (std::size_t k = 0; k < wish.size(); ++k)
      if (k != i && wish[i].found() && wish[k].index == wish[i].index &&
          (wish[k].distance < wish[i].distance || (wish[k].distance == wish[i].distance && k < i)))
        matches[i] = {};
  return matches;
}

}  // namespace

TEST_CASE("projection matching finds what looking at every key point finds") {
  Random random(4);
  for (const int count : {1, 30, 300})
    for (const double ratio : {0.8, 1.0}) {
      const Scene s = random_scene(random, count);
      const ProjectionOptions options{.max_distance = 90, .ratio = ratio};
      ProjectionMatcher matcher(options);
      KeypointGrid grid;
      grid.build(s.keypoints);
      std::vector<Match> matches(s.queries.size());
      const int found = matcher.match(std::span(s.queries), s.query_descriptors, grid, std::span(s.keypoints),
                                      s.descriptors, matches, s.taken);
      CHECK(matches == slow_match(s, options));
      CHECK(found == std::ranges::count_if(matches, &Match::found));
      if (count == 300) CHECK(found > 100);
    }
}

TEST_CASE("projection matching with orientation keeps the turn most agree on") {
  Random random(6);
  Scene s = random_scene(random, 0);
  for (int i = 0; i < 50; ++i) {
    const auto x = static_cast<float>(12 * i);
    s.keypoints.push_back({.u = x, .v = 50, .angle = i % 5 ? 0.3f : 1.7f});
    s.queries.push_back({.u = x, .v = 50, .radius = 3, .angle = 0});
    s.descriptors.push_back(random_descriptor(random));
  }
  KeypointGrid grid;
  grid.build(s.keypoints);
  ProjectionMatcher matcher({.check_orientation = true});
  std::vector<Match> matches(50);
  CHECK(matcher.match(std::span<const ProjectionQuery>(s.queries), s.descriptors, grid,
                      std::span<const FrameKeypoint>(s.keypoints), s.descriptors, matches) == 40);
  for (int i = 0; i < 50; ++i) CHECK(matches[i].found() == (i % 5 != 0));
}

TEST_CASE("the grid answers area queries as looking at every point does") {
  Random random(2);
  KeypointGrid grid({.width = 17, .height = 5});
  for (const int count : {0, 1, 2, 400, 100}) {  // buffers shrink and grow
    const Features<256> f = random_features(random, count);
    std::vector<FrameKeypoint> points;
    std::vector<std::uint8_t> skip;
    for (const KeyPoint& k : f.keypoints) {
      points.push_back({.u = k.x - 100, .v = k.y, .octave = k.octave});
      skip.push_back(random.uniform() < 0.2);
    }
    grid.build(points, skip);
    for (int q = 0; q < 50; ++q) {
      const auto u = static_cast<float>(random.uniform(-300, 900)),
                 v = static_cast<float>(random.uniform(-300, 700));
      const auto radius = static_cast<float>(random.uniform(0, 100));
      std::vector<std::int32_t> found, expected;
      grid.query(u, v, radius, 1, 4, found);
      for (int i = 0; i < count; ++i)
        if (!skip[i] && std::abs(points[i].u - u) <= radius && std::abs(points[i].v - v) <= radius &&
            points[i].octave >= 1 && points[i].octave <= 4)
          expected.push_back(i);
      std::ranges::sort(found);
      CHECK(found == expected);
    }
  }
  std::vector<FrameKeypoint> far{{.u = -1e9f, .v = 0}, {.u = 1e9f, .v = 1e9f}, {.u = 5, .v = 5}};
  grid.build(far);
  std::vector<std::int32_t> found;
  grid.query(5, 5, 1, 0, 10, found);
  CHECK(found == std::vector<std::int32_t>{2});
}

TEST_CASE("projection matching refuses lengths that disagree") {
  ProjectionMatcher matcher;
  KeypointGrid grid;
  std::vector<ProjectionQuery> queries(2);
  std::vector<OrbDescriptor> descriptors(2);
  std::vector<FrameKeypoint> keypoints;
  std::vector<Match> matches(2);
  const auto run = [&](std::span<const OrbDescriptor> q, std::span<const OrbDescriptor> d,
                       std::span<Match> m) {
    return matcher.match(std::span<const ProjectionQuery>(queries), q, grid,
                         std::span<const FrameKeypoint>(keypoints), d, m);
  };
  CHECK(run(descriptors, {}, matches) == 0);
  CHECK_THROWS_AS(run({}, {}, matches), Error);
  CHECK_THROWS_AS(run(descriptors, descriptors, matches), Error);
  CHECK_THROWS_AS(run(descriptors, {}, {}), Error);
}
