// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <functional>
#include <numbers>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/core/sample.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/motion/wheel_odometry.hpp"

namespace sweepkit::test {

/// A differential drive in the plane, with a gyro at 200 Hz, wheels at 50 Hz, and true poses every 5 ms. The
/// motion is given; what the sensors say follows from it in exact arcs of 1 ms.
struct DriveSimulation {
  WheelGeometry geometry{1560, 0.035, 0.235};
  WheelParameters wheels{1.01, 0.985, 0.2325};  ///< the true ones
  SE3d T_body_base{SO3d::exp({0.02, -3.1, 0.3}), {0.02, -0.05, 0.04}};
  Vec3<double> gyro_bias{0.004, -0.006, 0.003};
  double gyro_noise = 2e-4;   // [rad/s/sqrt(Hz)]
  double accel_noise = 2e-3;  // [m/s^2/sqrt(Hz)]
  Vec3<double> accel_bias{0.05, -0.04, 0.06};
  double wheel_noise = 0.0;  // [m/sqrt(m)]
  TimeNs wheel_offset = 0;   // added to the stamps of the wheels
  bool whole_ticks = true;
  /// Forward speed [m/s] and rate of turn [rad/s] of the base at a time [s].
  std::function<Eigen::Vector2d(double)> motion;
  /// How much faster than the ground the wheels roll, left and right [m/s].
  std::function<Eigen::Vector2d(double)> slip = [](double) { return Eigen::Vector2d(0, 0); };

  std::vector<ImuSample> imu;
  std::vector<WheelSample> ticks;
  std::vector<SE3d> poses;  ///< T_world_body at each sample of the IMU

  void run(double seconds, std::uint64_t seed = 1) {
    Random random(seed);
    SE3d T_world_base;
    double left = 137, right = 2257;  // [ticks]
    const auto steps = static_cast<int>(std::lround(seconds * 1000));
    for (int k = 0; k <= steps; ++k) {
      const double t = k * 1e-3;
      if (k % 5 == 0) {
        const Eigen::Vector2d u = motion(t), next = motion(t + 1e-3), last = motion(t - 1e-3);
        ImuSample s;
        s.t = from_seconds(t);
        const SO3d R_body_base = T_body_base.rotation();
        const Vec3<double> w(0, 0, u[1]), r = T_body_base.inverse().translation();
        const double slope = (next[0] - last[0]) / 2e-3, turn = (next[1] - last[1]) / 2e-3;
        const Vec3<double> accel =
            Vec3<double>(slope, u[0] * u[1], 9.81) + Vec3<double>(0, 0, turn).cross(r) + w.cross(w.cross(r));
        s.gyro = R_body_base * w + gyro_bias;
        s.accel = R_body_base * accel + accel_bias;
        for (int i = 0; i < 3; ++i) {
          s.gyro[i] += random.normal(0, gyro_noise * std::sqrt(200.0));
          s.accel[i] += random.normal(0, accel_noise * std::sqrt(200.0));
        }
        imu.push_back(s);
        poses.push_back(T_world_base * T_body_base.inverse());
      }
      if (k % 20 == 0) {
        WheelSample s;
        s.t = from_seconds(t) + wheel_offset;
        s.left = whole_ticks ? std::floor(left) : left;
        s.right = whole_ticks ? std::floor(right) : right;
        ticks.push_back(s);
      }
      const Eigen::Vector2d u = motion(t + 0.5e-3), slid = slip(t + 0.5e-3);
      Vec6<double> xi = Vec6<double>::Zero();
      xi[0] = u[0] * 1e-3;
      xi[5] = u[1] * 1e-3;
      T_world_base = T_world_base * ClosedFormIntegrator::motion(xi);
      const double b = wheels.track_width;
      const auto roll = [&](double speed, double scale) {
        const double distance = speed * 1e-3;
        const double noisy = distance + random.normal(0, wheel_noise * std::sqrt(std::abs(distance)));
        return noisy / (scale * geometry.metres_per_tick());
      };
      left += roll(u[0] - 0.5 * b * u[1] + slid[0], wheels.scale_left);
      right += roll(u[0] + 0.5 * b * u[1] + slid[1], wheels.scale_right);
    }
  }

  /// The true motion of the body between two samples of the IMU.
  SE3d relative(std::size_t a, std::size_t b) const { return poses[a].inverse() * poses[b]; }
};

/// Drives, turns on the spot, stands, drives arcs: what a cleaning robot does in half a minute.
inline Eigen::Vector2d cleaning_motion(double t) {
  const auto ramp = [&](double from, double to) {
    const auto edge = [](double x) {
      x = std::min(1.0, std::max(0.0, x));
      return x * x * x * (10 - 15 * x + 6 * x * x);
    };
    return edge((t - from) / 0.5) * (1 - edge((t - to) / 0.5));
  };
  const double v = 0.3 * ramp(2, 8) + 0.25 * ramp(12, 20) - 0.1 * ramp(24, 26);
  const double w = 1.0 * ramp(9, 11) + 0.5 * std::sin(0.9 * t) * ramp(13, 19) - 1.2 * ramp(21, 23);
  return {v, w};
}

}  // namespace sweepkit::test
