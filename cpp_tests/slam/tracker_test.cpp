// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/tracker.hpp"

#include <catch2/catch.hpp>

#include "slam/point_cloud.hpp"

using namespace sweepkit;

namespace {

constexpr TimeNs kPeriod = kNsPerSecond / 10;

// Tracker and mapper in line, as the Sweeper runs them offline.
struct Slam {
  explicit Slam(const PointCloud& cloud, const TrackerOptions& options = {}, const SE3d& T_start = {})
      : tracker(cloud.camera(), cloud.view(), cloud.levels(), options, T_start),
        mapper(cloud.camera(), cloud.view(), cloud.levels(), {}) {}

  TrackResult track(StereoFrame& frame) {
    const TrackResult result = tracker.track(frame);
    if (result.wants_keyframe) {
      const auto map = mapper.process({frame, tracker.take_counts(), result.starts_map});
      CHECK_FALSE(mapper.map().broken_invariant());
      tracker.set_local_map(map);
    }
    return result;
  }

  Tracker tracker;
  LocalMapper mapper;
};

// T_camera_world of a drive forward in a curve.
SE3d camera_pose(int i) { return SE3d::exp(Vec6<double>{0.01 * i, 0, -0.04 * i, 0, 0.01 * i, 0}); }

Vec6<double> error_of(const StereoFrame& frame, const SE3d& T_camera_world) {
  return (frame.T_camera_world * T_camera_world.inverse()).log();
}

}  // namespace

TEST_CASE("Tracker follows a drive through points", "[tracker]") {
  const PointCloud cloud(500, 1);
  Slam slam(cloud);
  for (int i = 0; i < 25; ++i) {
    StereoFrame frame = cloud.see(camera_pose(i), 0.4, 100 + i, 0.05, (i + 1) * kPeriod);
    const TrackResult result = slam.track(frame);
    CAPTURE(i, result.points);
    REQUIRE(result.state == TrackingState::tracking);
    CHECK(result.starts_map == (i == 0));
    const Vec6<double> error = error_of(frame, camera_pose(i));
    CHECK(error.head<3>().norm() < 0.01);
    CHECK(error.tail<3>().norm() < 0.003);
    if (i > 0) {
      CHECK(result.points > 100);
      CHECK(frame.covariance.diagonal().minCoeff() > 0);
      CHECK(frame.covariance.diagonal().maxCoeff() < 1e-4);
      CHECK(frame.reference.valid());
    }
  }
  CHECK(slam.mapper.map().keyframe_count() >= 2);
}

TEST_CASE("Tracker starts at the pose it is given, and only with enough stereo points", "[tracker]") {
  const PointCloud cloud(500, 1), few(20, 1);
  const SE3d T_start = SE3d::exp(Vec6<double>{1, 2, 3, 0.1, 0.2, 0.3});
  Slam slam(cloud, {}, T_start);
  StereoFrame empty;
  empty.t = kPeriod;
  CHECK(slam.track(empty).state == TrackingState::starting);
  CHECK_FALSE(slam.tracker.predict(2 * kPeriod));
  StereoFrame poor = few.see(SE3d(), 0.4, 1, 0, 2 * kPeriod);
  CHECK(slam.track(poor).state == TrackingState::starting);
  StereoFrame first = cloud.see(SE3d(), 0.4, 2, 0, 3 * kPeriod);
  CHECK(slam.track(first).starts_map);
  CHECK(first.T_camera_world.matrix() == T_start.matrix());
  CHECK(slam.tracker.predict(4 * kPeriod));
}

TEST_CASE("Tracker does not hang on the motion prior", "[tracker]") {
  const PointCloud cloud(600, 1);
  Slam slam(cloud);
  for (int i = 0; i < 5; ++i) {
    StereoFrame frame = cloud.see(camera_pose(i), 0.4, 100 + i, 0, (i + 1) * kPeriod);
    slam.track(frame);
  }
  // From one image to the next it turns by 17 degrees and steps aside.
  const SE3d T_sudden = SE3d::exp(Vec6<double>{0.15, 0.05, 0.1, 0.03, 0.3, 0.02}) * camera_pose(4);
  StereoFrame frame = cloud.see(T_sudden, 0.4, 200, 0, 6 * kPeriod);
  REQUIRE(slam.track(frame).state == TrackingState::tracking);
  const Vec6<double> error = error_of(frame, T_sudden);
  CHECK(error.head<3>().norm() < 0.015);
  CHECK(error.tail<3>().norm() < 0.004);
}

TEST_CASE("Tracker is lost without points and finds itself again with them", "[tracker]") {
  const PointCloud cloud(500, 1);
  TrackerOptions options;
  options.restart_after = 5;
  Slam slam(cloud, options);
  int i = 0;
  for (; i < 5; ++i) {
    StereoFrame frame = cloud.see(camera_pose(i), 0.4, 100 + i, 0, (i + 1) * kPeriod);
    slam.track(frame);
  }
  const SE3d T_last = slam.tracker.last_T_camera_world();
  for (; i < 8; ++i) {
    StereoFrame nothing;
    nothing.t = (i + 1) * kPeriod;
    const TrackResult result = slam.track(nothing);
    CHECK(result.state == TrackingState::lost);
    CHECK_FALSE(result.wants_keyframe);
    CHECK((nothing.T_camera_world * T_last.inverse()).log().norm() < 0.2);
  }
  StereoFrame frame = cloud.see(camera_pose(i), 0.4, 100 + i, 0, (i + 1) * kPeriod);
  REQUIRE(slam.track(frame).state == TrackingState::tracking);
  CHECK(error_of(frame, camera_pose(i)).norm() < 0.02);
}

TEST_CASE("Tracker starts again at the last pose where nothing is known", "[tracker]") {
  const PointCloud cloud(500, 1), elsewhere(500, 9);
  TrackerOptions options;
  options.restart_after = 3;
  Slam slam(cloud, options);
  int i = 0;
  for (; i < 5; ++i) {
    StereoFrame frame = cloud.see(camera_pose(i), 0.4, 100 + i, 0, (i + 1) * kPeriod);
    slam.track(frame);
  }
  const SE3d T_last = slam.tracker.last_T_camera_world();
  for (int k = 0; k < 6; ++k, ++i) {
    StereoFrame frame = elsewhere.see(SE3d(), 0.4, 200 + i, 0, (i + 1) * kPeriod);
    const TrackResult result = slam.track(frame);
    CAPTURE(k);
    CHECK(result.starts_map == (k == 2));
    CHECK((result.state == TrackingState::lost) == (k <= 2));
    CHECK((frame.T_camera_world * T_last.inverse()).log().norm() < 0.2);
  }
}

TEST_CASE("Tracker and mapper repeat themselves to the bit", "[tracker]") {
  const PointCloud cloud(500, 1);
  Slam a(cloud), b(cloud);
  for (int i = 0; i < 12; ++i) {
    StereoFrame of_a = cloud.see(camera_pose(i), 0.4, 100 + i, 0.1, (i + 1) * kPeriod);
    StereoFrame of_b = of_a;
    a.track(of_a);
    b.track(of_b);
    CHECK(of_a.T_camera_world.matrix() == of_b.T_camera_world.matrix());
    CHECK(of_a.covariance == of_b.covariance);
    CHECK(of_a.points == of_b.points);
  }
}
