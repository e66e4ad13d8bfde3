// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/local_mapper.hpp"

#include <catch2/catch.hpp>

#include "slam/point_cloud.hpp"

using namespace sweepkit;

namespace {

SE3d camera_pose(int i) { return SE3d::exp(Vec6<double>{0.1 * i, 0, -0.05 * i, 0, 0.02 * i, 0}); }

// A keyframe whose frame has found no points: fusion has to.
KeyframeCandidate candidate(const PointCloud& cloud, int i, const SE3d& T_camera_world, bool starts) {
  KeyframeCandidate c;
  c.frame = cloud.see(camera_pose(i), 0.3, 50 + static_cast<std::uint64_t>(i), 0, (i + 1) * kNsPerSecond);
  c.frame.points.assign(c.frame.measurements.size(), PointId{});
  c.frame.T_camera_world = T_camera_world;
  c.starts_map = starts;
  return c;
}

LocalMapper mapper_for(const PointCloud& cloud, const LocalMapperOptions& options = {}) {
  return LocalMapper(cloud.camera(), cloud.view(), cloud.levels(), options);
}

}  // namespace

TEST_CASE("LocalMapper makes a map of the first keyframe's stereo points", "[local_mapper]") {
  const PointCloud cloud(300, 1);
  LocalMapper mapper = mapper_for(cloud);
  const KeyframeCandidate first = candidate(cloud, 0, SE3d(), true);
  int certain = 0;
  for (const Measurement& m : first.frame.measurements)
    certain += m.stereo() && m.sigma_right < LocalMapperOptions{}.max_depth_uncertainty * m.disparity();
  const auto local = mapper.process(KeyframeCandidate(first));
  CHECK(mapper.map().keyframe_count() == 1);
  CHECK(static_cast<int>(mapper.map().point_count()) == certain);
  CHECK_FALSE(mapper.map().broken_invariant());
  REQUIRE(local);
  CHECK(local->newest_t == first.frame.t);
  CHECK(local->points.size() == mapper.map().point_count());
  CHECK(local->newest_points.size() == first.frame.measurements.size());
  REQUIRE(local->find(local->newest));
  for (const LocalPoint& point : local->points) {
    CHECK(local->find(point.id) == &point);
    CHECK(point.p_world.allFinite());
    CHECK(point.spread.allFinite());
    CHECK(point.min_distance < point.max_distance);
    CHECK(point.normal.norm() == Approx(1).margin(1e-3));
  }
}

TEST_CASE("LocalMapper joins views of the same points and sharpens them", "[local_mapper]") {
  const PointCloud cloud(300, 1);
  LocalMapper mapper = mapper_for(cloud);
  std::shared_ptr<const LocalMap> local;
  // Poses of later keyframes are a little wrong, as tracking gives them.
  for (int i = 0; i < 5; ++i) {
    const SE3d disturbed =
        SE3d::exp(Vec6<double>{0.003, -0.002, 0.004, 0.001, -0.001, 0.001} * (i > 0)) * camera_pose(i);
    KeyframeCandidate c = candidate(cloud, i, i ? disturbed : camera_pose(0), i == 0);
    if (local) {
      // As tracking would: the points whose descriptors it knows.
      for (std::size_t m = 0; m < c.frame.measurements.size(); ++m)
        for (const LocalPoint& point : local->points)
          if (m % 2 == 0 && hamming_distance(point.descriptor, c.frame.descriptors[m]) < 30)
            c.frame.points[m] = point.id;
    }
    local = mapper.process(std::move(c));
    REQUIRE_FALSE(mapper.map().broken_invariant());
  }
  // Each true point is in the map about once, though half of the views did not know it.
  const Map& map = mapper.map();
  int seen_by_more = 0;
  double squares = 0;
  for (std::uint32_t i = 0; i < map.point_id_end(); ++i) {
    const MapPoint* point = map.find(PointId{i});
    if (!point || point->observations.size() < 3) continue;
    ++seen_by_more;
    double nearest = 1e9;
    for (const auto& truth : cloud.points()) nearest = std::min(nearest, (truth - point->p_world).norm());
    squares += nearest * nearest;
  }
  CHECK(seen_by_more > 100);
  CHECK(map.point_count() < 400);
  CHECK(std::sqrt(squares / seen_by_more) < 0.06);
  // And the poses have come closer to the truth.
  for (std::uint32_t k = 0; k < map.keyframe_id_end(); ++k) {
    const Keyframe* keyframe = map.find(KeyframeId{k});
    if (!keyframe) continue;
    const int i = static_cast<int>(keyframe->t / kNsPerSecond) - 1;
    CAPTURE(i);
    CHECK((keyframe->T_camera_world * camera_pose(i).inverse()).log().norm() < 0.0055);
  }
}

TEST_CASE("LocalMapper leaves bundle adjustment when it is told to", "[local_mapper]") {
  const PointCloud cloud(300, 1);
  LocalMapper mapper = mapper_for(cloud);
  mapper.process(candidate(cloud, 0, camera_pose(0), true));
  const std::atomic<bool> stop = true;
  const auto local = mapper.process(candidate(cloud, 1, camera_pose(1), false), &stop);
  REQUIRE(local);
  CHECK(mapper.map().keyframe_count() == 2);
  CHECK_FALSE(mapper.map().broken_invariant());
}

TEST_CASE("A map that starts again is one of its own", "[local_mapper]") {
  const PointCloud cloud(300, 1), elsewhere(300, 5);
  LocalMapper mapper = mapper_for(cloud);
  mapper.process(candidate(cloud, 0, camera_pose(0), true));
  const auto local = mapper.process(candidate(elsewhere, 1, camera_pose(1), true));
  REQUIRE(local);
  CHECK(local->find(local->newest));
  CHECK(mapper.map().keyframe_count() == 2);
  CHECK_FALSE(mapper.map().broken_invariant());
}
