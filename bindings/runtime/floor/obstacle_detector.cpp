// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/obstacle_detector.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "sweepkit/core/error.hpp"
#include "sweepkit/floor/obstacle_mask.hpp"

namespace sweepkit {
namespace {

/// Milliseconds since the last call.
class Lap {
 public:
  double operator()() {
    const auto now = std::chrono::steady_clock::now();
    const double ms = std::chrono::duration<double, std::milli>(now - last_).count();
    last_ = now;
    return ms;
  }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

}  // namespace

struct ObstacleDetector::State {
  State(const StereoRig& rig, const GroundPlaneSeed& seed, const ObstacleDetectorOptions& options)
      : options(options),
        stereo(rig, options.disparity),
        plane(stereo.camera(), seed, options.plane),
        finder(options.obstacles),
        tracker(options.tracking),
        floor(seed.plane) {
    check_options(options);
  }

  ObstacleDetectorOptions options;
  StereoDisparity stereo;
  GroundPlaneEstimator plane;
  GrayImage mask;
  ObstacleFinder finder;
  ObstacleTracker tracker;
  std::optional<TimeNs> last_t;
  std::optional<SE3d> T_odom_last;
  GroundPlane floor;  // as last estimated
  ObstacleFrame frame;
};

ObstacleDetector::ObstacleDetector(const StereoRig& rig, const GroundPlaneSeed& seed,
                                   const ObstacleDetectorOptions& options)
    : state_(std::make_unique<State>(rig, seed, options)) {}
ObstacleDetector::~ObstacleDetector() = default;
ObstacleDetector::ObstacleDetector(ObstacleDetector&&) noexcept = default;
ObstacleDetector& ObstacleDetector::operator=(ObstacleDetector&&) noexcept = default;

const ObstacleDetectorOptions& ObstacleDetector::options() const { return state_->options; }
const RectifiedCamera& ObstacleDetector::camera() const { return state_->stereo.camera(); }
const ObstacleFrame& ObstacleDetector::last() const { return state_->frame; }

const ObstacleFrame& ObstacleDetector::detect(TimeNs t, GrayView left, GrayView right,
                                              const ObstaclePose& pose) {
  State& s = *state_;
  require(!s.last_t || t > *s.last_t, "ObstacleDetector::detect t", "must be later than the last image's", t);
  Lap lap;
  ObstacleFrame& frame = s.frame;
  frame.t = t;
  // The floor is matched far better when its disparities are expected.
  frame.disparity = s.stereo.match(
      left, right,
      s.options.floor_ramp ? s.plane.mounting().disparity(s.stereo.camera()).ramp(s.stereo.camera().cx)
                           : DisparityRamp{});
  frame.left = s.stereo.rectifier().image(Side::left);
  frame.times.disparity = lap();

  GroundPlaneStep step;
  if (s.last_t) step.seconds = to_seconds(t - *s.last_t);
  if (pose.T_odom_camera && s.T_odom_last)
    step.motion = {pose.T_odom_camera->inverse() * *s.T_odom_last, pose.motion_covariance};
  frame.plane = s.plane.estimate(frame.disparity, step);
  s.floor = frame.plane.plane;
  s.last_t = t;
  s.T_odom_last = pose.T_odom_camera;
  frame.times.plane = lap();

  const RectifiedCamera& camera = s.stereo.camera();
  const bool lifted = frame.plane.reason == GroundPlaneReason::lifted;
  frame.tolerance = FloorTolerance::of(s.options.noise, frame.plane.plane, camera);
  s.mask.resize(frame.disparity.width, frame.disparity.height);
  if (lifted)
    s.mask.fill(static_cast<std::uint8_t>(FloorLabel::unknown));
  else
    obstacle_mask(frame.disparity, frame.plane.plane.disparity(camera), frame.tolerance, s.mask.view());
  frame.mask = std::as_const(s.mask).view();
  frame.times.mask = lap();

  const Mat3<double>& covariance = frame.plane.covariance;
  const FloorDoubt doubt{std::sqrt(std::max(covariance(0, 0), covariance(1, 1))),
                         frame.plane.state == GroundPlaneState::refused};
  frame.obstacles = s.finder.find(frame.disparity, frame.mask, camera, frame.plane.plane, frame.left,
                                  s.stereo.rectifier().image(Side::right), doubt);
  frame.regions = s.finder.regions();
  if (pose.T_odom_camera && !lifted)
    s.tracker.update(t, frame.obstacles, frame.disparity, camera, frame.plane.plane, *pose.T_odom_camera);
  frame.tracked = s.tracker.tracked();
  frame.times.obstacles = lap();
  return frame;
}

}  // namespace sweepkit
