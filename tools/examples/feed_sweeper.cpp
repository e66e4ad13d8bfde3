// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// How a robot uses the Sweeper: three threads feed it as drivers would, a fourth asks where the robot is a
// hundred times a second. The drivers here play a recording at sensor time, or as fast as it goes with
// --fast.
#include <atomic>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstdio>
#include <cstring>
#include <deque>
#include <mutex>
#include <thread>

#include "sweepkit/data/recording.hpp"
#include "sweepkit/system/sweeper.hpp"

namespace {

using namespace sweepkit;
using Clock = std::chrono::steady_clock;

/// What a driver waits on: samples of one kind, in order.
template <class T>
class Channel {
 public:
  void put(T sample) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return samples_.size() < kCapacity; });
    samples_.push_back(std::move(sample));
    changed_.notify_all();
  }
  void close() {
    const std::scoped_lock lock(mutex_);
    closed_ = true;
    changed_.notify_all();
  }
  /// The next sample; nothing at the end.
  std::optional<T> take() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return closed_ || !samples_.empty(); });
    if (samples_.empty()) return std::nullopt;
    std::optional<T> sample = std::move(samples_.front());
    samples_.pop_front();
    changed_.notify_all();
    return sample;
  }

 private:
  // Two seconds of a fast IMU, so that no sensor's thread holds up the reading of the others.
  static constexpr std::size_t kCapacity = 400;

  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<T> samples_;
  bool closed_ = false;
};

/// The clock of the sensors.
class SensorTime {
 public:
  SensorTime(TimeNs begin, bool fast) : begin_(begin), fast_(fast), newest_(begin) {}

  /// Returns when a sample of this stamp comes from its sensor.
  void wait_until(TimeNs t) {
    if (!fast_) std::this_thread::sleep_until(start_ + std::chrono::nanoseconds(t - begin_));
    TimeNs newest = newest_.load();
    while (newest < t && !newest_.compare_exchange_weak(newest, t)) {
    }
  }
  TimeNs now() const { return newest_; }

 private:
  const TimeNs begin_;
  const bool fast_;
  const Clock::time_point start_ = Clock::now();
  std::atomic<TimeNs> newest_;
};

template <class T>
void drive(Channel<T>& channel, SensorTime& time, Sweeper& robot) {
  while (auto sample = channel.take()) {
    time.wait_until(sample->t);
    robot.feed(*std::move(sample));
  }
}

/// As drive; with --fast a new image comes when the one before the last is done, so that none is dropped.
void drive_cameras(Channel<StereoImage>& channel, SensorTime& time, Sweeper& robot, bool fast) {
  std::int64_t fed = 0;
  while (auto image = channel.take()) {
    const auto waiting = [&] {
      const SweeperCounts counts = robot.counts();
      return fed - counts.images - counts.images_dropped - counts.samples_dropped;
    };
    while (fast && waiting() > 1) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    time.wait_until(image->t);
    robot.feed(*std::move(image));
    ++fed;
  }
}

const char* name(PoseBasis basis) {
  switch (basis) {
    case PoseBasis::vision:
      return "vision";
    case PoseBasis::odometry:
      return "odometry";
    case PoseBasis::guess:
      return "guess";
  }
  return "";
}

int run(const char* folder, bool fast) {
  const auto recording = open_recording(folder);
  SweeperOptions options;
  options.realtime = true;
  Sweeper robot(recording->rig().stereo(), options);

  Channel<ImuSample> imu;
  Channel<WheelSample> wheels;
  Channel<StereoImage> cameras;
  const TimeNs begin = recording->info().begin;
  SensorTime time(begin, fast);
  std::thread imu_driver([&] { drive(imu, time, robot); });
  std::thread wheel_driver([&] { drive(wheels, time, robot); });
  std::thread camera_driver([&] { drive_cameras(cameras, time, robot, fast); });

  std::atomic<bool> done = false;
  std::thread control([&] {
    TimeNs next_line = begin;
    for (auto due = Clock::now(); !done; due += std::chrono::milliseconds(10)) {
      const TimeNs now = time.now();
      if (const auto pose = robot.pose_at(now); pose && now >= next_line) {
        const Vec3<double>& p = pose->T_frame_body.translation();
        std::printf("%8.2f s  at %7.3f %7.3f %7.3f m, +- %.1f mm, by %s\n", to_seconds(now - begin), p.x(),
                    p.y(), p.z(), 1e3 * std::sqrt(pose->covariance.topLeftCorner<3, 3>().trace()),
                    name(pose->basis));
        next_line = now + kNsPerSecond;
      }
      std::this_thread::sleep_until(due);
    }
  });

  std::string damage;
  try {
    while (auto sample = recording->next()) {
      if (auto* s = std::get_if<ImuSample>(&*sample)) imu.put(*s);
      if (auto* s = std::get_if<WheelSample>(&*sample)) wheels.put(*s);
      if (auto* s = std::get_if<StereoImage>(&*sample)) cameras.put(std::move(*s));
    }
  } catch (const Error& error) {
    damage = error.what();
  }
  imu.close();
  wheels.close();
  cameras.close();
  imu_driver.join();
  wheel_driver.join();
  camera_driver.join();
  robot.finish();
  done = true;
  control.join();

  const SweeperCounts counts = robot.counts();
  std::printf("%lld images: %lld lost, %lld dropped; %lld of the IMU, %lld of the wheels\n",
              static_cast<long long>(counts.images), static_cast<long long>(counts.images_lost),
              static_cast<long long>(counts.images_dropped), static_cast<long long>(counts.imu_samples),
              static_cast<long long>(counts.wheel_samples));
  if (!damage.empty()) std::fprintf(stderr, "feed_sweeper: %s\n", damage.c_str());
  return damage.empty() ? 0 : 3;
}

}  // namespace

int main(int argc, char** argv) {
  const bool fast = argc == 3 && std::strcmp(argv[2], "--fast") == 0;
  if (argc != 2 && !fast) {
    std::fprintf(stderr, "usage: feed_sweeper RECORDING [--fast]\n");
    return 2;
  }
  try {
    return run(argv[1], fast);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "feed_sweeper: %s\n", error.what());
    return 3;
  }
}
