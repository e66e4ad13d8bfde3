// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/obstacle_stage.hpp"

#include <cmath>
#include <condition_variable>
#include <mutex>
#include <numbers>
#include <thread>
#include <utility>

#include "sweepkit/core/error.hpp"

namespace sweepkit {

namespace {

constexpr double kDegree = std::numbers::pi / 180;

}  // namespace

GroundPlaneSeed FloorMountingOptions::seed(const Rig& rig) const {
  if (camera_height > 0) {
    const double p = pitch_down * kDegree, r = roll * kDegree;
    return GroundPlaneSeed::from_height({std::sin(r) * std::cos(p), std::cos(r) * std::cos(p), std::sin(p)},
                                        camera_height);
  }
  if (!rig.wheels)
    throw Error(ErrorKind::calibration, "floor.camera_height",
                "must be given: the recording has no wheels, which tell where the floor is");
  return GroundPlaneSeed::from_base(rig.wheels->T_body_base.inverse() * rig.stereo().T_body_camera());
}

class ObstacleStage::Impl {
 public:
  Impl(const StereoRig& rig, const GroundPlaneSeed& seed, const ObstacleDetectorOptions& options,
       bool realtime, StageClock* clock, GridStage* grid)
      : T_body_camera_(rig.T_body_camera()), detector_(rig, seed, options), clock_(clock), grid_(grid) {
    if (realtime) thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
  }

  ~Impl() {
    if (thread_.joinable()) thread_.request_stop();
  }

  struct Waiting {
    StereoImage image;
    SE3d T_odom_body;
    KeyframeId reference;
    SE3d T_camera_reference;
  };

  void feed(Waiting&& next) {
    if (!thread_.joinable()) {
      look(next);
      return;
    }
    const std::scoped_lock lock(mutex_);
    if (waiting_) ++counts_.skipped;
    waiting_ = std::move(next);
    changed_.notify_one();
  }

  void finish() {
    if (!thread_.joinable()) return;
    {
      const std::scoped_lock lock(mutex_);
      finishing_ = true;
      changed_.notify_one();
    }
    thread_.join();
  }

  std::shared_ptr<const ObstacleReport> latest() const {
    const std::scoped_lock lock(mutex_);
    return latest_;
  }
  ObstacleStageCounts counts() const {
    const std::scoped_lock lock(mutex_);
    return counts_;
  }
  void skip() {
    const std::scoped_lock lock(mutex_);
    ++counts_.skipped;
  }

 private:
  void run(const std::stop_token& stop) {
    for (;;) {
      Waiting next;
      {
        std::unique_lock lock(mutex_);
        changed_.wait(lock, stop, [this] { return waiting_ || finishing_; });
        if (stop.stop_requested() || !waiting_) return;
        next = std::move(*waiting_);
        waiting_.reset();
      }
      look(next);
    }
  }

  void look(const Waiting& next) {
    const StereoImage& image = next.image;
    try {
      std::optional<StageClock::Scope> time;
      if (clock_) time.emplace(*clock_, Stage::obstacles);
      ObstaclePose pose;
      pose.T_odom_camera = next.T_odom_body * T_body_camera_;
      const ObstacleFrame& frame = detector_.detect(image.t, image.left.view, image.right.view, pose);
      add_to_grid(frame, next, *pose.T_odom_camera);
      auto report = std::make_shared<ObstacleReport>();
      report->t = frame.t;
      report->T_odom_floor = *pose.T_odom_camera * floor_frame(frame.plane.plane).inverse();
      report->plane = frame.plane;
      report->obstacles.assign(frame.obstacles.begin(), frame.obstacles.end());
      report->tracked.assign(frame.tracked.begin(), frame.tracked.end());
      const std::scoped_lock lock(mutex_);
      latest_ = std::move(report);
      ++counts_.images;
    } catch (const Error&) {
      skip();
    }
  }

  // Only where the robot stands on what it sees.
  void add_to_grid(const ObstacleFrame& frame, const Waiting& next, const SE3d& T_odom_camera) {
    const GroundPlaneResult& plane = frame.plane;
    if (!grid_ || plane.state == GroundPlaneState::refused || plane.reason == GroundPlaneReason::lifted)
      return;
    std::optional<StageClock::Scope> time;
    if (clock_) time.emplace(*clock_, Stage::grid);
    grid_->add(frame.disparity, plane.plane, {next.reference, next.T_camera_reference, T_odom_camera});
  }

  const SE3d T_body_camera_;
  ObstacleDetector detector_;
  StageClock* clock_;
  GridStage* grid_;

  mutable std::mutex mutex_;
  std::condition_variable_any changed_;
  std::optional<Waiting> waiting_;
  bool finishing_ = false;
  std::shared_ptr<const ObstacleReport> latest_;
  ObstacleStageCounts counts_;
  std::jthread thread_;  // last: it uses the rest
};

ObstacleStage::ObstacleStage(const StereoRig& rig, const GroundPlaneSeed& seed,
                             const ObstacleDetectorOptions& options, bool realtime, StageClock* clock,
                             GridStage* grid)
    : impl_(std::make_unique<Impl>(rig, seed, options, realtime, clock, grid)) {}
ObstacleStage::~ObstacleStage() = default;

void ObstacleStage::feed(StereoImage image, const SE3d& T_odom_body, KeyframeId reference,
                         const SE3d& T_camera_reference) noexcept {
  try {
    impl_->feed({std::move(image), T_odom_body, reference, T_camera_reference});
  } catch (...) {
    impl_->skip();
  }
}
void ObstacleStage::finish() { impl_->finish(); }
std::shared_ptr<const ObstacleReport> ObstacleStage::latest() const { return impl_->latest(); }
ObstacleStageCounts ObstacleStage::counts() const { return impl_->counts(); }

}  // namespace sweepkit
