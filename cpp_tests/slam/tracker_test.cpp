// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/tracker.hpp"

#include <Eigen/LU>
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

  TrackResult track(StereoFrame& frame, const MotionPrior* prior = nullptr) {
    const TrackResult result = tracker.track(frame, prior);
    if (result.wants_keyframe) {
      const auto map = mapper.process({frame, tracker.take_counts(), result.starts_map, {}});
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

namespace {

MotionPrior prior_at(const SE3d& T_camera_world, double position_sigma, double angle_sigma) {
  Vec6<double> sigma;
  sigma << Vec3<double>::Constant(position_sigma), Vec3<double>::Constant(angle_sigma);
  return {T_camera_world, Mat6<double>(sigma.cwiseAbs2().asDiagonal())};
}

}  // namespace

TEST_CASE("Tracker with odometry keeps the pose by a few points", "[tracker]") {
  const PointCloud cloud(500, 1), few(16, 1);
  Slam slam(cloud);
  int i = 0;
  for (; i < 5; ++i) {
    const MotionPrior prior = prior_at(camera_pose(i), 0.003, 0.002);
    StereoFrame frame = cloud.see(camera_pose(i), 0.4, 100 + i, 0, (i + 1) * kPeriod);
    REQUIRE(slam.track(frame, &prior).state == TrackingState::tracking);
  }
  // The few are the first of the many: nearly all in view. Odometry is a little wrong.
  const SE3d T_wrong = SE3d::exp(Vec6<double>{0.004, -0.003, 0.005, 0.002, -0.002, 0.001}) * camera_pose(i);
  const MotionPrior prior = prior_at(T_wrong, 0.005, 0.003);
  StereoFrame frame = few.see(camera_pose(i), 0.4, 100 + i, 0, (i + 1) * kPeriod);
  CAPTURE(frame.measurements.size());
  REQUIRE(frame.measurements.size() >= 8);
  REQUIRE(frame.measurements.size() < 20);
  CHECK(slam.track(frame, &prior).state == TrackingState::tracking);
  const Vec6<double> error = error_of(frame, camera_pose(i));
  CHECK(error.head<3>().norm() < 0.009);
  CHECK(error.tail<3>().norm() < 0.004);
  // What is seen and what odometry says together are known better than either.
  for (int k = 0; k < 6; ++k) CHECK(frame.covariance(k, k) <= prior.covariance(k, k) * 1.0001);
  CHECK(error.dot(frame.covariance.inverse() * error) < 25);
}

TEST_CASE("Tracker follows odometry where nothing is to be seen, with keyframes by the beta rule",
          "[tracker]") {
  const PointCloud cloud(500, 1);
  TrackerOptions options;
  Slam slam(cloud, options);
  int i = 0;
  for (; i < 5; ++i) {
    const MotionPrior prior = prior_at(SE3d(), 0.003, 0.002);
    StereoFrame frame = cloud.see(SE3d(), 0.4, 100 + i, 0, (i + 1) * kPeriod);
    slam.track(frame, &prior);
  }
  // In the dark: each pose is the prior's, to the bit, and its covariance too.
  REQUIRE(slam.tracker.refer(SE3d()).first.valid());
  int blind = 0, plain = 0;
  for (; i < 25; ++i) {
    const SE3d T = SE3d::exp(Vec6<double>{0, 0, 0.01 * (i - 4), 0, 0.02 * (i - 4), 0});
    const MotionPrior prior = prior_at(T, 0.01 * i, 0.01);
    StereoFrame nothing;
    nothing.t = (i + 1) * kPeriod;
    const TrackResult result = slam.tracker.track(nothing, &prior);
    REQUIRE(result.state == TrackingState::lost);
    CHECK(nothing.T_camera_world.matrix() == T.matrix());
    CHECK(nothing.covariance == prior.covariance);
    CHECK_FALSE(result.starts_map);
    CHECK(result.blind == result.wants_keyframe);
    const SE3d T_since = slam.tracker.refer(T).second;
    const double beta = options.blind_keyframe.beta(T_since.translation().norm(), T_since.rotation().angle());
    CAPTURE(i, beta);
    CHECK(result.blind == (beta > 1));
    ++(result.blind ? blind : plain);
  }
  CHECK(blind > 0);
  CHECK(plain > 0);

  // The first image that shows enough starts vision where odometry is, at once.
  const PointCloud elsewhere(500, 9);
  const SE3d T = SE3d::exp(Vec6<double>{0.1, 0, 0.3, 0, 0.4, 0});
  const MotionPrior prior = prior_at(T, 0.02, 0.01);
  StereoFrame frame = elsewhere.see(SE3d(), 0.4, 999, 0, (i + 1) * kPeriod);
  const TrackResult result = slam.tracker.track(frame, &prior);
  CHECK(result.starts_map);
  CHECK(result.wants_keyframe);
  CHECK_FALSE(result.blind);
  CHECK(frame.T_camera_world.matrix() == T.matrix());
}

TEST_CASE("Tracker does not believe odometry against a full picture", "[tracker]") {
  const PointCloud cloud(600, 1);
  Slam slam(cloud);
  int i = 0;
  for (; i < 5; ++i) {
    const MotionPrior prior = prior_at(camera_pose(i), 0.003, 0.002);
    StereoFrame frame = cloud.see(camera_pose(i), 0.4, 100 + i, 0, (i + 1) * kPeriod);
    slam.track(frame, &prior);
  }
  // Wheels that slip: 20 cm and 10 degrees off, and sure of it.
  const SE3d T_wrong = SE3d::exp(Vec6<double>{0.05, 0, -0.2, 0, 0.17, 0}) * camera_pose(i);
  const MotionPrior prior = prior_at(T_wrong, 0.003, 0.002);
  StereoFrame frame = cloud.see(camera_pose(i), 0.4, 100 + i, 0, (i + 1) * kPeriod);
  REQUIRE(slam.track(frame, &prior).state == TrackingState::tracking);
  const Vec6<double> error = error_of(frame, camera_pose(i));
  CHECK(error.head<3>().norm() < 0.01);
  CHECK(error.tail<3>().norm() < 0.003);
}
