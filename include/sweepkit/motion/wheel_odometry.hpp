// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/sample.hpp"
#include "sweepkit/motion/integrators.hpp"
#include "sweepkit/motion/wheel_decoder.hpp"

namespace sweepkit {

/// What a differential drive really measures, against its nominal geometry.
struct WheelParameters {
  double scale_left = 1.0;   ///< true over nominal radius of the left wheel
  double scale_right = 1.0;  ///< of the right wheel
  double track_width = 1.0;  ///< effective distance between the wheels [m]

  static WheelParameters nominal(const WheelGeometry& geometry) { return {1.0, 1.0, geometry.track_width}; }
  Vec3<double> vector() const { return {scale_left, scale_right, track_width}; }
};

/// Forward distance [m] and turn [rad, counter-clockwise] of the base, and their derivatives with respect to
/// (scale_left, scale_right, track_width).
struct PlanarStep {
  double forward = 0.0;
  double turn = 0.0;
  Vec3<double> d_forward = Vec3<double>::Zero();
  Vec3<double> d_turn = Vec3<double>::Zero();

  /// The twist of the base (x forward, z up) times the step, (v dt, w dt).
  Vec6<double> twist() const {
    Vec6<double> xi = Vec6<double>::Zero();
    xi[0] = forward;
    xi[5] = turn;
    return xi;
  }
};

/// Wheels to motion in the plane: forward = (r + l) / 2, turn = (r - l) / b.
inline PlanarStep planar_step(const WheelStep& step, const WheelParameters& wheels) {
  const double left = wheels.scale_left * step.left, right = wheels.scale_right * step.right;
  const double b = wheels.track_width;
  return {0.5 * (left + right),
          (right - left) / b,
          {0.5 * step.left, 0.5 * step.right, 0.0},
          {-step.left / b, step.right / b, (left - right) / (b * b)}};
}

struct OdometryOptions {
  WheelDecoderOptions decoder;
  double wheel_noise = 0.002;
  double lateral_noise = 0.002;
  double tilt_noise = 0.02;
  double max_gap = 0.05;
  double hold = 0.1;
  double max_acceleration = 1.0;
  double max_turn_acceleration = 10.0;
  double unknown_speed = 0.5;
  double unknown_rate = 1.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v.group(decoder, "decoder", "from wheel samples to distances");
    v(wheel_noise, "wheel_noise", "m/sqrt(m)", range(0.0, 1.0), "error of a wheel after a metre rolled");
    v(lateral_noise, "lateral_noise", "m/sqrt(m)", range(0.0, 1.0),
      "motion of the base sideways and up after a metre");
    v(tilt_noise, "tilt_noise", "rad/sqrt(m)", range(0.0, 1.0),
      "pitch and roll after a metre that wheels do not see; only without gyro");
    v(max_gap, "max_gap", "s", range(1e-3, 10.0), "gyro samples farther apart than this are a hole");
    v(hold, "hold", "s", range(0.0, 10.0), "how long the last rates are held beyond the newest sample");
    v(max_acceleration, "max_acceleration", "m/s^2", range(0.0, 100.0), "error of a held speed");
    v(max_turn_acceleration, "max_turn_acceleration", "rad/s^2", range(0.0, 1000.0),
      "error of a held rate of turn");
    v(unknown_speed, "unknown_speed", "m/s", range(0.0, 100.0), "standard deviation where nothing tells");
    v(unknown_rate, "unknown_rate", "rad/s", range(0.0, 100.0), "standard deviation where nothing tells");
  }
};

/// The motion of the body between two times by wheels and gyro.
struct OdometryMotion {
  TimeNs begin = 0;
  TimeNs end = 0;
  UncertainMotion<double> motion;  ///< T_body(begin)_body(end); covariance of the noise of both sensors
  /// Derivatives of the perturbation on the right, (rho, phi), with respect to the gyro bias [rad/s] and to
  /// (scale_left, scale_right, track_width): motion(b + db) = motion Exp(d_gyro_bias db).
  Eigen::Matrix<double, 6, 3> d_gyro_bias = Eigen::Matrix<double, 6, 3>::Zero();
  Eigen::Matrix<double, 6, 3> d_wheels = Eigen::Matrix<double, 6, 3>::Zero();
  double without_gyro = 0.0;    ///< of the time, how much the gyro does not cover [s]
  double without_wheels = 0.0;  ///< how much measured and trusted wheels do not cover [s]
  double rolled = 0.0;          ///< distance of the base by the wheels, forth and back both positive [m]
  double turned = 0.0;          ///< angle, whatever the direction [rad]

  /// With an error of bias and wheels that lasts all the time put into the covariance.
  Mat6<double> covariance_with(const Mat3<double>& gyro_bias, const Mat3<double>& wheels) const {
    return motion.covariance + d_gyro_bias * gyro_bias * d_gyro_bias.transpose() +
           d_wheels * wheels * d_wheels.transpose();
  }
};

/// Relative motion from a gyro, which gives the rotation in space, and wheels, which give the translation of
/// their base frame along its x axis, sideways and up nothing; without a gyro, or where it is silent, the
/// wheels turn the base in its plane. Both at their own rate. The wheels' clock may be off by an offset.
/// Samples come in order for each sensor; what is not newer than the last, or not finite, is refused. Beyond
/// the newest sample the last rates are held for `hold`, then nothing is known: the pose stays, its
/// covariance grows. Not thread-safe.
template <TwistIntegrator I = ClosedFormIntegrator>
class BasicOdometryIntegrator {
 public:
  /// @param T_body_base of the wheels' base: x forward, y left, z up, between the wheels on the floor
  /// @param wheel_offset time of the wheels + offset = time of the gyro [ns]
  BasicOdometryIntegrator(const WheelGeometry& geometry, const SE3d& T_body_base, const ImuNoise& noise = {},
                          const OdometryOptions& options = {}, TimeNs wheel_offset = 0);

  /// False if the sample is refused.
  bool add(const ImuSample& sample);
  bool add(const WheelSample& sample);

  void set_gyro_bias(const Vec3<double>& bias) { gyro_bias_ = bias; }
  const Vec3<double>& gyro_bias() const { return gyro_bias_; }
  /// @throws Error(argument) unless all are positive and finite
  void set_wheels(const WheelParameters& wheels);
  const WheelParameters& wheels() const { return wheels_; }
  const SE3d& T_body_base() const { return T_body_base_; }
  /// What the wheels say from `from` to `to` is not believed. Wheels that slip turn faster than the robot
  /// moves; those of a robot in the air say nothing, even at rest.
  void distrust_wheels(TimeNs from, TimeNs to, bool in_the_air = false) {
    distrusted_.push_back({from, to, in_the_air});
  }

  /// The motion from one time to a later one (or the same). Before the oldest sample nothing is known.
  /// @throws Error(argument) if to < from
  OdometryMotion between(TimeNs from, TimeNs to) const;

  /// Steps of the wheels that are kept, in order of time.
  const std::vector<WheelStep>& wheel_steps() const { return steps_; }
  /// Samples of the gyro that are kept, in order of time.
  const std::vector<ImuSample>& gyro_samples() const { return gyro_; }
  const WheelDecoder& decoder() const { return decoder_; }
  /// Newest time that both (or the only) sensors cover; nothing without samples.
  std::optional<TimeNs> covered_until() const;
  /// Forgets what is not needed from a time on.
  void forget_before(TimeNs t);

 private:
  struct Span {
    TimeNs from, to;
    bool in_the_air;
  };
  enum class Trust { full, slipping, in_the_air };
  struct Accumulated;
  /// What holds from a time on, until `end`.
  struct GyroRate {
    Vec3<double> rate = Vec3<double>::Zero();  // in the middle of the piece, bias taken off
    bool known = false;
    double held = 0.0;  // age of a held rate at the end of the piece [s]
  };

  TimeNs next_break(TimeNs t, TimeNs to, std::size_t gyro, std::size_t step) const;
  GyroRate gyro_rate(std::size_t k, TimeNs a, TimeNs b) const;
  void add_piece(Accumulated& sum, TimeNs a, TimeNs b, const GyroRate& gyro, std::size_t step) const;
  Trust trust(TimeNs a, TimeNs b) const;

  WheelGeometry geometry_;
  SE3d T_body_base_;
  ImuNoise noise_;
  OdometryOptions options_;
  TimeNs wheel_offset_;
  WheelDecoder decoder_;
  WheelParameters wheels_;
  Vec3<double> gyro_bias_ = Vec3<double>::Zero();
  std::vector<ImuSample> gyro_;
  std::vector<WheelStep> steps_;
  std::vector<Span> distrusted_;
};

using OdometryIntegrator = BasicOdometryIntegrator<>;

}  // namespace sweepkit

#include "sweepkit/motion/impl/wheel_odometry.hpp"
