// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/sample.hpp"
#include "sweepkit/direction/main_direction.hpp"
#include "sweepkit/motion/mounting.hpp"
#include "sweepkit/motion/standstill.hpp"
#include "sweepkit/motion/wheel_decoder.hpp"

namespace sweepkit {

struct LevelOdometryOptions {
  double gyro_bias_sigma = 1.0;
  double wheel_yaw_sigma = 1.0;
  double bias_walk = 0.005;
  double floor_gain = 2.0;
  double gravity_gain = 0.5;
  double max_tilt = 5.0;
  double max_gap = 0.3;
  StandstillOptions standstill;
  WheelDecoderOptions decoder;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(gyro_bias_sigma, "gyro_bias_sigma", "deg/s", range(0.0, 100.0),
      "bias of the gyro before the first rest");
    v(wheel_yaw_sigma, "wheel_yaw_sigma", "deg/s", range(0.0, 100.0),
      "drift of the yaw by wheels of unequal radius; only without a gyro");
    v(bias_walk, "bias_walk", "deg/s/sqrt(s)", range(0.0, 10.0),
      "how fast the gyro's bias wanders after a rest");
    v(floor_gain, "floor_gain", "1/s", range(0.0, 100.0),
      "pull of the vertical towards the normal of the floor");
    v(gravity_gain, "gravity_gain", "1/s", range(0.0, 100.0),
      "pull towards what the accelerometer says, where no floor is under the wheels");
    v(max_tilt, "max_tilt", "deg", range(0.0, 90.0),
      "the wheels stand on no level floor if the accelerometer, smoothed over half a second, is farther off");
    v(max_gap, "max_gap", "s", range(1e-3, 100.0),
      "over a longer silence of the gyro nothing is added to the yaw");
    v.group(standstill, "standstill", "rests, which tell the gyro's bias");
    v.group(decoder, "decoder", "from wheel samples to distances");
  }
};

/// What a robot knows of its orientation without looking, from IMU and wheels, from the first sample on.
///
/// The yaw is the gyro's as it reads, its bias left in: it drifts at one steady rate, which rests tell, or
/// the directions that are seen (MainDirectionWindow) - whatever wheels that slip or differ in radius say.
/// Without a gyro the wheels turn it. Up is the normal of the floor under the wheels; where the accelerometer
/// contradicts (lifted), or without wheels, what that says: a complementary filter (Mahony, Hamel, Pflimlin
/// 2008). With neither sensor the orientation never changes and up is against the y axis of the camera.
/// Samples come in the order of their stamps; others are left out. Deterministic; not thread-safe.
class LevelOdometry {
 public:
  /// @param T_body_camera of the left camera
  LevelOdometry(const MotionSensors& sensors, const SE3d& T_body_camera,
                const LevelOdometryOptions& options = {});

  void add(const ImuSample& sample);
  void add(const WheelSample& sample);

  /// Orientation of the body at an instant, in a frame whose z axis is up and whose yaw begins anywhere: as
  /// after the last sample, turned on by the last rate for 0.1 s at most.
  SO3d orientation(TimeNs t) const;
  /// By how much the yaw of orientation() drifts, as known now.
  YawDrift drift() const;
  bool standing() const { return standstill_ && standstill_->standing(); }

 private:
  void level(double seconds);
  void rest(const ImuSample& sample);

  MotionSensors sensors_;
  LevelOdometryOptions options_;
  Vec3<double> floor_up_;  // in the body; without wheels as the camera's mounting says
  SO3d R_world_body_;
  std::optional<StandstillDetector> standstill_;
  std::optional<WheelDecoder> decoder_;
  std::optional<ImuSample> last_imu_;
  TimeNs last_wheels_ = 0;
  double wheel_rate_ = 0;                          // of the yaw, by the last step [rad/s]
  Vec3<double> force_ = Vec3<double>::Zero();      // smoothed specific force, in the body
  Vec3<double> tilt_bias_ = Vec3<double>::Zero();  // of the gyro, across the vertical
  Vec3<double> rest_sum_ = Vec3<double>::Zero();   // of the gyro in the rest that goes on
  TimeNs rest_since_ = 0;
  int rest_count_ = 0;
  std::optional<Vec3<double>> bias_;  // by the last rest that was long enough
  TimeNs bias_time_ = 0;
  double bias_sigma_ = 0;
};

}  // namespace sweepkit
