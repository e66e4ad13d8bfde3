// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/core/sample.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/motion/mounting.hpp"

namespace sweepkit::test {

inline constexpr double kGravity = 9.81;

/// From 0 to 1 between two times, at rest at both.
inline double smooth(double t, double from, double to) {
  const double x = std::clamp((t - from) / (to - from), 0.0, 1.0);
  return x * x * x * (10 - x * (15 - 6 * x));
}

inline Vec6<double> difference(const SE3d& a, const SE3d& b) { return (a.inverse() * b).log(); }

/// What wheels and IMU say of a base that moves as told, by differences of its pose.
struct BodySignals {
  std::function<SE3d(double)> T_world_base;
  std::function<Eigen::Vector2d(double)> slide = [](double) { return Eigen::Vector2d(0, 0); };
  std::function<bool(double)> in_air = [](double) { return false; };  // wheels roll by `slide` alone
  SE3d T_body_base{SO3d::exp({0.02, -3.1, 0.3}), {0.02, -0.05, 0.04}};
  WheelGeometry geometry{1560, 0.035, 0.235};
  double noise = 1;  // of the IMU, times what it is said to have
  double imu_rate = 200, wheel_rate = 50;
  TimeNs wheel_shift = 0;

  std::vector<ImuSample> imu;
  std::vector<WheelSample> wheels;

  SE3d T_world_body(double t) const { return T_world_base(t) * T_body_base.inverse(); }

  MotionSensors sensors(bool with_imu = true, bool with_wheels = true) const {
    MotionSensors sensors;
    if (with_imu) sensors.imu = MountedImu{.T_body_imu = {}, .noise = {}, .rate_hz = imu_rate};
    if (with_wheels)
      sensors.wheels = MountedWheels{.T_body_base = T_body_base, .geometry = geometry, .rate_hz = wheel_rate};
    return sensors;
  }

  void make(double seconds, std::uint64_t seed = 1) {
    Random random(seed);
    const ImuNoise said;
    constexpr double h = 1e-3;
    for (int k = 0; k <= std::lround(seconds * imu_rate); ++k) {
      const double t = k / imu_rate;
      const SE3d T = T_world_body(t), before = T_world_body(t - h), after = T_world_body(t + h);
      ImuSample s{from_seconds(t)};
      s.gyro = difference(before, after).tail<3>() / (2 * h);
      const Vec3<double> acceleration =
          (after.translation() - 2 * T.translation() + before.translation()) / (h * h);
      s.accel = T.rotation().inverse() * (acceleration + Vec3<double>(0, 0, kGravity));
      for (int i = 0; i < 3; ++i) {
        s.gyro[i] += noise * random.normal(0, said.gyro_noise_density * std::sqrt(imu_rate));
        s.accel[i] += noise * random.normal(0, said.accel_noise_density * std::sqrt(imu_rate));
      }
      imu.push_back(s);
    }
    double left = 100, right = 300;
    constexpr double step = 2e-3;
    int made = 0;
    for (int k = 0; k <= std::lround(seconds / step); ++k) {
      const double t = k * step;
      if (t > made / wheel_rate - 1e-9) {
        WheelSample s{from_seconds(made / wheel_rate) + wheel_shift};
        s.left = noise > 0 ? std::floor(left) : left;
        s.right = noise > 0 ? std::floor(right) : right;
        wheels.push_back(s);
        ++made;
      }
      const Vec6<double> xi = difference(T_world_base(t), T_world_base(t + step));
      const Eigen::Vector2d slid = step * slide(t + 0.5 * step);
      const double on_floor = in_air(t) ? 0.0 : 1.0, b = geometry.track_width;
      left += (on_floor * (xi[0] - 0.5 * b * xi[5]) + slid[0]) / geometry.metres_per_tick();
      right += (on_floor * (xi[0] + 0.5 * b * xi[5]) + slid[1]) / geometry.metres_per_tick();
    }
  }
};

}  // namespace sweepkit::test
