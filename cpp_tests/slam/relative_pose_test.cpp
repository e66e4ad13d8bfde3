// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/relative_pose.hpp"

#include <catch2/catch.hpp>
#include <cstdlib>
#include <numbers>

#include "slam/point_cloud.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/slam/frontend.hpp"

using namespace sweepkit;

namespace {

double degrees(const SE3d& T) { return T.rotation().log().norm() * 180 / std::numbers::pi; }

}  // namespace

TEST_CASE("relative_pose finds large motions among wrong matches", "[relative_pose]") {
  const PointCloud cloud(400, 1);
  for (const Vec6<double>& xi :
       {Vec6<double>{0, 0, 0, 0, 0, 0}, Vec6<double>{0.3, -0.1, 0.4, 0.05, 0.3, -0.1},
        Vec6<double>{-0.2, 0.2, -0.5, 0, -0.2, 0.6}}) {
    const SE3d T_a_b = SE3d::exp(xi);
    const StereoFrame a = cloud.see(SE3d(), 0.5, 2);
    const StereoFrame b = cloud.see(T_a_b.inverse(), 0.5, 3, 0.3);
    const auto found = relative_pose(cloud.camera(), a, b);
    REQUIRE(found);
    const Vec6<double> error = (T_a_b.inverse() * found->T_a_b).log();
    CAPTURE(xi.transpose(), error.transpose(), found->matches, found->inliers);
    CHECK(found->inliers > 60);
    CHECK(error.head<3>().norm() < 0.02);
    CHECK(error.tail<3>().norm() < 0.004);
    // chi-square with six degrees of freedom: 0.999999 lies below 40.
    CHECK(error.dot(found->covariance.ldlt().solve(error)) < 40);
  }
}

TEST_CASE("relative_pose gives no answer where there is none", "[relative_pose]") {
  const PointCloud cloud(400, 1), other(400, 2);
  CHECK_FALSE(relative_pose(cloud.camera(), cloud.see(SE3d(), 0.5, 1), other.see(SE3d(), 0.5, 2)));
  CHECK_FALSE(relative_pose(cloud.camera(), cloud.see(SE3d(), 0.5, 1), StereoFrame{}));
  CHECK_FALSE(relative_pose(cloud.camera(), StereoFrame{}, cloud.see(SE3d(), 0.5, 1)));
  RelativePoseOptions options;
  options.search_radius = 0;
  CHECK_THROWS_AS(relative_pose(cloud.camera(), StereoFrame{}, StereoFrame{}, options), Error);
}

TEST_CASE("relative_pose of pairs of EuRoC V1_01 that see the same place", "[relative_pose][recording]") {
  const char* data = std::getenv("SWEEPKIT_DATA");
  if (!data) {
    WARN("skipped: SWEEPKIT_DATA is not set");
    return;
  }
  const std::filesystem::path folder = std::filesystem::path(data) / "euroc_loop_pairs";
  const auto recording = open_recording(folder);
  const Trajectory truth = read_trajectory(recording->info().truth);
  const StereoRig rig = recording->rig().stereo();
  Frontend frontend(rig, {});
  std::vector<StereoFrame> frames;
  while (const auto sample = recording->next()) {
    const StereoImage* image = std::get_if<StereoImage>(&*sample);
    if (!image) continue;
    StereoFrame& frame = frames.emplace_back();
    frame.t = image->t;
    frontend.extract(image->left.view, image->right.view);
    frontend.match(frame);
  }
  REQUIRE(frames.size() == 4);
  const RectifiedCamera camera{rig.focal(), rig.center().x(), rig.center().y(), rig.baseline()};
  // The first two are 98 s apart, the others half a second.
  for (const auto& [i, j] : {std::pair(0, 1), {1, 0}, {2, 3}, {3, 2}}) {
    const auto T_world_i = interpolate(truth, frames[i].t), T_world_j = interpolate(truth, frames[j].t);
    REQUIRE((T_world_i && T_world_j));
    const SE3d& T_body_camera = rig.T_body_camera();
    const SE3d T_true = (*T_world_i * T_body_camera).inverse() * (*T_world_j * T_body_camera);
    const auto found = relative_pose(camera, frames[i], frames[j]);
    CAPTURE(i, j);
    REQUIRE(found);
    const SE3d error = T_true.inverse() * found->T_a_b;
    CAPTURE(found->matches, found->inliers, T_true.translation().norm(), degrees(T_true));
    CHECK(error.translation().norm() < 0.05);
    CHECK(degrees(error) < 1.0);
    UNSCOPED_INFO("translation " << error.translation().norm() << " m, rotation " << degrees(error)
                                 << " deg");
  }
}
