// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/imu_simulation.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "sweepkit/core/random.hpp"

namespace sweepkit {
namespace {

Vec3<double> normal3(Random& random, double sigma) {
  Vec3<double> v;
  for (int k = 0; k < 3; ++k) v[k] = sigma * random.normal();
  return v;
}

double reading(double value, double limit, double resolution) {
  value = std::clamp(value, -limit, limit);
  return resolution > 0.0 ? std::round(value / resolution) * resolution : value;
}

}  // namespace

ImuSimulationOptions ImuSimulationOptions::ideal() const {
  ImuSimulationOptions o = *this;
  o.gyro_noise_density = o.gyro_random_walk = o.accel_noise_density = o.accel_random_walk = 0.0;
  o.gyro_bias_sigma = o.accel_bias_sigma = o.gyro_resolution = o.accel_resolution = 0.0;
  o.gyro_limit = o.accel_limit = 1e6;
  return o;
}

SE3d ImuSimulationOptions::T_base_imu() const {
  if (position.size() != 3) throw Error(ErrorKind::option, "imu.position", "needs x, y, z");
  if (rotation_deg.size() != 3) throw Error(ErrorKind::option, "imu.rotation_deg", "needs roll, pitch, yaw");
  constexpr double kRad = std::numbers::pi / 180.0;
  const SO3d roll = SO3d::exp({rotation_deg[0] * kRad, 0, 0}),
             pitch = SO3d::exp({0, rotation_deg[1] * kRad, 0}),
             yaw = SO3d::exp({0, 0, rotation_deg[2] * kRad});
  return {yaw * pitch * roll, {position[0], position[1], position[2]}};
}

ImuStream simulate_imu(const PoseSpline& base, TimeNs begin, const ImuSimulationOptions& options,
                       std::uint64_t seed) {
  check_options(options);
  const SE3d T_base_imu = options.T_base_imu();
  const double samples = std::floor(base.duration() * options.rate_hz + 1e-6) + 1.0;
  require(samples < 1e8, "simulate_imu rate_hz", "gives too many samples", samples);
  const auto count = static_cast<std::size_t>(samples);

  // The noise of the rates and the path of the biases do not depend on one another.
  Random gyro_random(4 * seed), accel_random(4 * seed + 1), walk_random(4 * seed + 2);
  const double interval = 1.0 / options.rate_hz;
  const double gyro_sigma = options.gyro_noise_density * std::sqrt(options.rate_hz);
  const double accel_sigma = options.accel_noise_density * std::sqrt(options.rate_hz);
  const double gyro_step = options.gyro_random_walk * std::sqrt(interval);
  const double accel_step = options.accel_random_walk * std::sqrt(interval);
  Vec3<double> gyro_bias = normal3(walk_random, options.gyro_bias_sigma);
  Vec3<double> accel_bias = normal3(walk_random, options.accel_bias_sigma);

  ImuStream stream;
  stream.samples.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    const double t = static_cast<double>(i) * interval;
    const MotionState s = base.at(t).of(T_base_imu);
    const Vec3<double> up(0.0, 0.0, options.gravity);
    const Vec3<double> rate = s.angular_rate + gyro_bias + normal3(gyro_random, gyro_sigma);
    const Vec3<double> force = s.T_world_body.rotation().inverse() * Vec3<double>(s.acceleration + up) +
                               accel_bias + normal3(accel_random, accel_sigma);
    ImuSample sample{begin + from_seconds(t), {}, {}};
    for (int k = 0; k < 3; ++k) {
      sample.gyro[k] = reading(rate[k], options.gyro_limit, options.gyro_resolution);
      sample.accel[k] = reading(force[k], options.accel_limit, options.accel_resolution);
    }
    stream.samples.push_back(sample);
    stream.gyro_bias.push_back(gyro_bias);
    stream.accel_bias.push_back(accel_bias);
    gyro_bias += normal3(walk_random, gyro_step);
    accel_bias += normal3(walk_random, accel_step);
  }
  return stream;
}

}  // namespace sweepkit
