// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// Prints how well the motion between consecutive stereo frames of a recording comes out from their images
// alone, against the recording's truth.
#include <fmt/format.h>

#include <numbers>

#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/slam/frontend.hpp"
#include "sweepkit/slam/relative_pose.hpp"

namespace {

using namespace sweepkit;

double degrees(const SE3d& T) { return T.rotation().log().norm() * 180 / std::numbers::pi; }

int run(const char* folder) {
  const auto recording = open_recording(folder);
  const Trajectory truth = read_trajectory(recording->info().truth);
  const StereoRig rig = recording->rig().stereo();
  const RectifiedCamera camera{rig.focal(), rig.center().x(), rig.center().y(), rig.baseline()};
  const SE3d& T_body_camera = rig.T_body_camera();
  Frontend frontend(rig, {});
  std::optional<StereoFrame> before;
  fmt::print("{:>20} {:>20} {:>8} {:>9} {:>8} {:>8} {:>9} {:>9}\n", "first", "second", "moved m",
             "turned deg", "matches", "inliers", "error m", "error deg");
  while (const auto sample = recording->next()) {
    const StereoImage* image = std::get_if<StereoImage>(&*sample);
    if (!image || image->left.empty() || image->right.empty()) continue;
    StereoFrame frame;
    frame.t = image->t;
    frontend.extract(image->left.view, image->right.view);
    frontend.match(frame);
    const auto T_a = before ? interpolate(truth, before->t) : std::nullopt;
    const auto T_b = interpolate(truth, frame.t);
    if (T_a && T_b) {
      const SE3d T_true = (*T_a * T_body_camera).inverse() * (*T_b * T_body_camera);
      fmt::print("{:>20} {:>20} {:>8.3f} {:>9.2f} ", before->t, frame.t, T_true.translation().norm(),
                 degrees(T_true));
      if (const auto found = relative_pose(camera, *before, frame)) {
        const SE3d error = T_true.inverse() * found->T_a_b;
        fmt::print("{:>8} {:>8} {:>9.4f} {:>9.3f}\n", found->matches, found->inliers,
                   error.translation().norm(), degrees(error));
      } else {
        fmt::print("none\n");
      }
    }
    before = std::move(frame);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    fmt::print(stderr, "usage: relative_pose_accuracy RECORDING\n");
    return 2;
  }
  try {
    return run(argv[1]);
  } catch (const Error& error) {
    fmt::print(stderr, "relative_pose_accuracy: {}\n", error.what());
    return 3;
  }
}
