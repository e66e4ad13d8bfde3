// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/obstacle_stage.hpp"

#include <condition_variable>
#include <mutex>
#include <thread>
#include <utility>

#include "sweepkit/core/error.hpp"

namespace sweepkit {

class ObstacleStage::Impl {
 public:
  Impl(const StereoRig& rig, const GroundPlaneSeed& seed, const ObstacleDetectorOptions& options,
       bool realtime, StageClock* clock)
      : T_body_camera_(rig.T_body_camera()), detector_(rig, seed, options), clock_(clock) {
    if (realtime) thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
  }

  ~Impl() {
    if (thread_.joinable()) thread_.request_stop();
  }

  void feed(StereoImage image, const SE3d& T_odom_body) {
    if (!thread_.joinable()) {
      look(image, T_odom_body);
      return;
    }
    const std::scoped_lock lock(mutex_);
    if (waiting_) ++counts_.skipped;
    waiting_ = {std::move(image), T_odom_body};
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
      std::pair<StereoImage, SE3d> next;
      {
        std::unique_lock lock(mutex_);
        changed_.wait(lock, stop, [this] { return waiting_ || finishing_; });
        if (stop.stop_requested() || !waiting_) return;
        next = std::move(*waiting_);
        waiting_.reset();
      }
      look(next.first, next.second);
    }
  }

  void look(const StereoImage& image, const SE3d& T_odom_body) {
    try {
      std::optional<StageClock::Scope> time;
      if (clock_) time.emplace(*clock_, Stage::obstacles);
      ObstaclePose pose;
      pose.T_odom_camera = T_odom_body * T_body_camera_;
      const ObstacleFrame& frame = detector_.detect(image.t, image.left.view, image.right.view, pose);
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

  const SE3d T_body_camera_;
  ObstacleDetector detector_;
  StageClock* clock_;

  mutable std::mutex mutex_;
  std::condition_variable_any changed_;
  std::optional<std::pair<StereoImage, SE3d>> waiting_;
  bool finishing_ = false;
  std::shared_ptr<const ObstacleReport> latest_;
  ObstacleStageCounts counts_;
  std::jthread thread_;  // last: it uses the rest
};

ObstacleStage::ObstacleStage(const StereoRig& rig, const GroundPlaneSeed& seed,
                             const ObstacleDetectorOptions& options, bool realtime, StageClock* clock)
    : impl_(std::make_unique<Impl>(rig, seed, options, realtime, clock)) {}
ObstacleStage::~ObstacleStage() = default;

void ObstacleStage::feed(StereoImage image, const SE3d& T_odom_body) noexcept {
  try {
    impl_->feed(std::move(image), T_odom_body);
  } catch (...) {
    impl_->skip();
  }
}
void ObstacleStage::finish() { impl_->finish(); }
std::shared_ptr<const ObstacleReport> ObstacleStage::latest() const { return impl_->latest(); }
ObstacleStageCounts ObstacleStage::counts() const { return impl_->counts(); }

}  // namespace sweepkit
