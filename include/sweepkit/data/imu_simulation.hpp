// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/sample.hpp"
#include "sweepkit/data/pose_spline.hpp"

namespace sweepkit {

/// A MEMS inertial unit. Noise and random walks are continuous-time densities, as data sheets and
/// `sensor.yaml` give them.
struct ImuSimulationOptions {
  double rate_hz = 200.0;
  double gyro_noise_density = 2.2e-4;
  double gyro_random_walk = 1.4e-5;
  double accel_noise_density = 2.2e-3;
  double accel_random_walk = 3e-4;
  double gyro_bias_sigma = 0.004;
  double accel_bias_sigma = 0.06;
  double gyro_limit = 17.45;
  double accel_limit = 39.24;
  double gyro_resolution = 0.0;
  double accel_resolution = 0.0;
  double gravity = 9.81;
  std::vector<double> position = {-0.02, 0.005, 0.05};
  std::vector<double> rotation_deg = {0.6, -0.4, 0.5};

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(rate_hz, "rate_hz", "Hz", range(1.0, 10000.0), "samples a second");
    v(gyro_noise_density, "gyro_noise_density", "rad/s/sqrt(Hz)", range(0.0, 1.0),
      "white noise of the gyroscope");
    v(gyro_random_walk, "gyro_random_walk", "rad/s^2/sqrt(Hz)", range(0.0, 1.0), "drift of its bias");
    v(accel_noise_density, "accel_noise_density", "m/s^2/sqrt(Hz)", range(0.0, 10.0),
      "white noise of the accelerometer");
    v(accel_random_walk, "accel_random_walk", "m/s^3/sqrt(Hz)", range(0.0, 10.0), "drift of its bias");
    v(gyro_bias_sigma, "gyro_bias_sigma", "rad/s", range(0.0, 1.0),
      "spread of the first gyroscope bias, each axis");
    v(accel_bias_sigma, "accel_bias_sigma", "m/s^2", range(0.0, 10.0),
      "spread of the first accelerometer bias, each axis");
    v(gyro_limit, "gyro_limit", "rad/s", range(0.01, 1e6), "larger rates read as this");
    v(accel_limit, "accel_limit", "m/s^2", range(1.0, 1e6), "larger specific forces read as this");
    v(gyro_resolution, "gyro_resolution", "rad/s", range(0.0, 1.0), "smallest step of a reading; 0: none");
    v(accel_resolution, "accel_resolution", "m/s^2", range(0.0, 10.0), "smallest step of a reading; 0: none");
    v(gravity, "gravity", "m/s^2", range(0.0, 100.0), "points down in the world");
    v(position, "position", "m", range(-10.0, 10.0), "x, y, z in the robot's base");
    v(rotation_deg, "rotation_deg", "deg", range(-360.0, 360.0),
      "roll, pitch, yaw of its axes in the robot's base; R = Rz(yaw) Ry(pitch) Rx(roll)");
  }

  /// The same without noise, bias, limits and resolution.
  ImuSimulationOptions ideal() const;
  /// Where it sits on the base. @throws Error(option) unless position and rotation have three numbers each
  SE3d T_base_imu() const;
  ImuNoise noise() const {
    return {gyro_noise_density, gyro_random_walk, accel_noise_density, accel_random_walk};
  }
};

/// Readings and the biases in them.
struct ImuStream {
  std::vector<ImuSample> samples;
  std::vector<Vec3<double>> gyro_bias;   ///< at each sample [rad/s]
  std::vector<Vec3<double>> accel_bias;  ///< at each sample [m/s^2]
};

/// The motion of the base as an inertial unit on it feels it, from the beginning of the motion to its end. A
/// sample is the angular rate and the specific force at its stamp, not their mean over an interval, in the
/// unit's axes, then bias, white noise of standard deviation density * sqrt(rate), limit and resolution.
/// Biases are random walks from a normal first value. As the motion is four times differentiable, the method
/// of Runge and Kutta over pairs of intervals brings ideal samples at 2 kHz back to the truth within 0.1 mm
/// and 0.001 degrees after 60 s.
/// @param begin stamp of the motion's beginning [ns]
/// @param seed of all noise; two streams of one seed are alike
/// @throws Error(option) for options out of range
ImuStream simulate_imu(const PoseSpline& base, TimeNs begin, const ImuSimulationOptions& options,
                       std::uint64_t seed);

}  // namespace sweepkit
