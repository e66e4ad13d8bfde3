// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/sample.hpp"
#include "sweepkit/motion/navigation_filter.hpp"

namespace sweepkit {

struct LevelOdometryOptions {
  double rest_time = 0.4;
  double rest_spread = 0.6;
  double rest_rate = 3.0;
  double rest_acceleration = 0.3;
  NavigationOptions navigation;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(rest_time, "rest_time", "s", range(0.05, 100.0), "a rest is at least this long");
    v(rest_spread, "rest_spread", "deg/s", range(0.0, 100.0),
      "largest standard deviation of each gyro axis at rest, beside its noise");
    v(rest_rate, "rest_rate", "deg/s", range(0.0, 100.0), "largest mean of the gyro at rest: its bias");
    v(rest_acceleration, "rest_acceleration", "m/s^2", range(0.0, 100.0),
      "largest standard deviation of each accelerometer axis at rest; only without wheels");
    v.group(navigation, "navigation", "the filter behind it");
  }
};

/// What a robot knows of its orientation without looking, from IMU and wheels, from the first sample on:
/// which way is up, and how far it has turned. A NavigationFilter that begins with the floor under the wheels
/// as level, unless the accelerometer says otherwise, and that takes rests for what they tell of the gyro's
/// bias. Either sensor may be absent; with neither the orientation never changes and up is against the y axis
/// of the camera that is given. Samples come in the order of their stamps; deterministic; not thread-safe.
class LevelOdometry {
 public:
  /// @param T_body_camera of the left camera
  LevelOdometry(const MotionSensors& sensors, const SE3d& T_body_camera,
                const LevelOdometryOptions& options = {});

  void add(const ImuSample& sample);
  void add(const WheelSample& sample);

  /// Orientation of the body at an instant not before the last sample, in a frame whose z axis is up and
  /// whose yaw begins anywhere.
  SO3d orientation(TimeNs t);

  const NavigationFilter& filter() const { return filter_; }

 private:
  void begin(TimeNs t, const std::optional<Vec3<double>>& specific_force);
  void end_rest();

  LevelOdometryOptions options_;
  SO3d R_level_body_;  // as the mounting says
  NavigationFilter filter_;
  std::optional<ImuSample> last_imu_;
  std::optional<WheelSample> last_wheels_;
  // Of the rest that may be going on.
  TimeNs rest_begin_ = 0;
  int rest_samples_ = 0;
  Vec3<double> gyro_sum_, gyro_squares_, accel_sum_, accel_squares_;
};

}  // namespace sweepkit
