// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <optional>

#include "sweepkit/core/options.hpp"
#include "sweepkit/motion/mounting.hpp"
#include "sweepkit/motion/wheel_decoder.hpp"

namespace sweepkit {

/// What the navigation filter may be told. Noise densities of the IMU and nominal measures of the wheels come
/// with the sensors.
struct NavigationOptions {
  double gravity = 9.81;
  double imu_noise_factor = 1.5;
  double gyro_bias_sigma = 3;
  double accel_bias_sigma = 0.15;
  double start_speed_sigma = 0.2;
  double start_accel_sigma = 0.1;
  double up_walk = 0.04;
  double wheel_noise = 0.008;
  double wheel_noise_share = 0.03;
  double lateral_noise = 0.015;
  double vertical_noise = 0.02;
  double radius_sigma = 0.02;
  double track_sigma = 0.03;
  double radius_walk = 0.0002;
  double wheel_gate = 16;
  double max_gap = 0.3;
  double stop_noise = 0.003;
  WheelDecoderOptions decoder;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(gravity, "gravity", "m/s^2", range(1, 30), "strength of gravity");
    v(imu_noise_factor, "imu_noise_factor", "", range(0.1, 1000),
      "multiplies the IMU's noise densities: data sheets do not know vibration");
    v(gyro_bias_sigma, "gyro_bias_sigma", "deg/s", range(0, 100),
      "how far the gyro's bias may lie from zero");
    v(accel_bias_sigma, "accel_bias_sigma", "m/s^2", range(0, 10),
      "how far the accelerometer's bias may lie from zero");
    v(start_speed_sigma, "start_speed_sigma", "m/s", range(0, 100),
      "how fast the robot may move at the start");
    v(start_accel_sigma, "start_accel_sigma", "m/s^2", range(0, 100),
      "how much it may accelerate at the start");
    v(up_walk, "up_walk", "deg/sqrt(s)", range(0, 10),
      "how fast the vertical may wander in a map that bends as it grows");
    v(wheel_noise, "wheel_noise", "m/s", range(1e-6, 10),
      "noise of a wheel's speed, beside its quantisation");
    v(wheel_noise_share, "wheel_noise_share", "", range(0, 1), "and its share of the speed");
    v(lateral_noise, "lateral_noise", "m/s", range(1e-6, 10),
      "how fast the base may move sideways on the floor");
    v(vertical_noise, "vertical_noise", "m/s", range(1e-6, 10),
      "how fast it may move along its own vertical");
    v(radius_sigma, "radius_sigma", "", range(0, 1),
      "how far each wheel's radius may lie from its nominal one, as a share of it");
    v(track_sigma, "track_sigma", "", range(0, 1), "the same of the track width");
    v(radius_walk, "radius_walk", "1/sqrt(s)", range(0, 1),
      "how fast these shares may wander: carpets, wear");
    v(wheel_gate, "wheel_gate", "", range(1, 1e6),
      "wheels are not believed where chi-square of both speeds, of the sideways or of the vertical speed is "
      "larger");
    v(max_gap, "max_gap", "s", range(0.001, 100),
      "silence of a sensor after which nothing is concluded about the time between");
    v(stop_noise, "stop_noise", "m/s", range(1e-6, 1), "speed that may remain at a standstill");
    v.group(decoder, "decoder", "from wheel samples to distances");
  }
};

/// What the filter knows at an instant. World is the map's frame.
struct NavigationState {
  static constexpr int kSize = 20;
  /// Places in the error: T_world_body * Exp(rho, phi); velocity + R_world_body nu; biases and wheel scales
  /// added; up turned by two angles in the plane across it.
  static constexpr int kRho = 0, kPhi = 3, kNu = 6, kGyroBias = 9, kAccelBias = 12, kUp = 15, kWheels = 17;
  using Covariance = Eigen::Matrix<double, kSize, kSize>;

  TimeNs t = 0;
  SE3d T_world_body;
  Vec3<double> velocity = Vec3<double>::Zero();    ///< of the body's origin, in world axes [m/s]
  Vec3<double> gyro_bias = Vec3<double>::Zero();   ///< [rad/s]
  Vec3<double> accel_bias = Vec3<double>::Zero();  ///< [m/s^2]
  Vec3<double> up = Vec3<double>::UnitZ();         ///< against gravity, unit, in world axes
  /// Logarithms of left radius, right radius and track width over their nominal values.
  Vec3<double> wheel_scales = Vec3<double>::Zero();
  Covariance covariance = Covariance::Zero();

  Mat6<double> pose_covariance() const { return covariance.topLeftCorner<6, 6>(); }
};

/// How a wheel sample agreed with what was known before it.
struct WheelCheck {
  bool usable = false;          ///< there was a time before it to compare, without gap, reset or wrap
  bool used = false;            ///< its speeds entered the estimate
  double chi2_speed = 0.0;      ///< of both wheels, two degrees of freedom; 0 without an IMU
  double chi2_sideways = 0.0;   ///< that the base does not move sideways, one degree of freedom
  double chi2_vertical = 0.0;   ///< that it does not rise or sink, one degree of freedom
  double left_speed = 0.0;      ///< at the rim, as estimated [m/s]
  double right_speed = 0.0;     ///< [m/s]
  double forward_speed = 0.0;   ///< of the base, as known without this sample [m/s]
  double vertical_speed = 0.0;  ///< of the base along its own vertical, likewise [m/s]
};

/// Error-state Kalman filter over pose, velocity, both biases of the IMU, the vertical, and the wheels' radii
/// and track width. The IMU carries the state on (closed form over each interval, mean of its two samples);
/// wheels, standstill and vision correct it. Without an IMU, or while it is silent, the wheels carry the pose
/// on. All errors live in
/// the body's axes, as on SE_2(3): Sola, Quaternion kinematics for the error-state Kalman filter, 2017;
/// Barrau and Bonnabel, The invariant extended Kalman filter as a stable observer, 2017.
///
/// Vision enters as the pose that matching found with this filter's own prediction as prior: its posterior
/// replaces the marginal of the pose and the rest follows by its correlations, so nothing is counted twice.
///
/// Samples come in the order of their stamps; deterministic; not thread-safe; copies are cheap (4 kB).
class NavigationFilter {
 public:
  explicit NavigationFilter(const MotionSensors& sensors, const NavigationOptions& options = {});

  /// Begins at a pose that defines the world, so that it counts as exact.
  /// @param specific_force mean of the accelerometer just before, in body axes; nothing: up is world z, known
  ///   badly
  void start(TimeNs t, const SE3d& T_world_body, const std::optional<Vec3<double>>& specific_force);
  bool started() const { return started_; }

  /// Carries the state on to the sample. False after a silence longer than max_gap, over which the motion
  /// counts as unknown.
  bool add(const ImuSample& sample);
  /// @param believe_speeds the wheels' speeds may be used where they pass the gate
  /// @param on_floor the base may be taken to move neither sideways nor along its vertical, likewise
  WheelCheck add(const WheelSample& sample, bool believe_speeds = true, bool on_floor = true);
  /// The robot stood still for the last `seconds`, over which the gyro read this on average.
  void stand_still(const Vec3<double>& mean_gyro, double seconds);
  /// Carries the state on to an instant not before the last sample, as the last samples say; 0.1 s after them
  /// nothing is concluded: the pose stays and its covariance grows.
  void advance(TimeNs t);
  /// The pose after looking, found with state() as prior. @param covariance of a right perturbation
  void correct(const SE3d& T_world_body, const Mat6<double>& covariance);
  /// The map was moved under the robot.
  void move_world(const SE3d& T_new_old);
  /// Forgets how fast it moves, and where to within this [m, rad]: it was carried in a way nobody saw.
  void loosen(double position_sigma, double angle_sigma, double speed_sigma);

  const NavigationState& state() const { return state_; }
  const MotionSensors& sensors() const { return sensors_; }
  const NavigationOptions& options() const { return options_; }
  /// Angular rate and velocity of the body in its own axes now, of the last samples: (velocity, rate).
  Vec6<double> body_twist() const;
  /// Radius of the left and right wheel and track width as estimated [m].
  Vec3<double> wheel_measures() const;

 private:
  void step_inertial(const Vec3<double>& gyro, const Vec3<double>& accel, double dt);
  void step_twist(const Vec6<double>& twist, const Mat6<double>& noise, double dt,
                  const Eigen::Matrix<double, 6, 3>& J_wheels);
  template <int Rows>
  void update(const Eigen::Matrix<double, Rows, NavigationState::kSize>& H,
              const Eigen::Matrix<double, Rows, 1>& residual, const Eigen::Matrix<double, Rows, 1>& variance);
  void inject(const Eigen::Matrix<double, NavigationState::kSize, 1>& error);
  void set_up(const Vec3<double>& up, const Mat3<double>& R_new_old);
  bool imu_holds(TimeNs t) const;

  MotionSensors sensors_;
  NavigationOptions options_;
  bool started_ = false;
  NavigationState state_;
  std::optional<ImuSample> imu_;  // the last one
  std::optional<WheelDecoder> decoder_;
  std::optional<TimeNs> rolled_;               // end of the last step of the wheels
  Vec6<double> twist_ = Vec6<double>::Zero();  // of the wheels, without an IMU
  double held_ = 0.0;                          // how long twist_ carried the pose since then [s]
  // Since the last wheel sample: integrals of body velocity minus its value now, and of the angular rate.
  Vec3<double> velocity_lag_ = Vec3<double>::Zero();
  Vec3<double> turned_ = Vec3<double>::Zero();
  double since_wheels_ = 0.0;
};

}  // namespace sweepkit
