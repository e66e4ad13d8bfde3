// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <deque>
#include <optional>
#include <utility>
#include <vector>

#include "sweepkit/core/event.hpp"
#include "sweepkit/core/options.hpp"
#include "sweepkit/motion/navigation_filter.hpp"
#include "sweepkit/motion/slip.hpp"
#include "sweepkit/motion/standstill.hpp"
#include "sweepkit/motion/wheel_odometry.hpp"

namespace sweepkit {

/// What the odometry bridge may be told.
struct OdometryBridgeOptions {
  NavigationOptions navigation;
  StandstillOptions standstill;
  SlipOptions slip;
  OdometryOptions edges;
  int disagreements = 3;
  double agreement = 0.2;
  double lift_height = 0.03;
  double lift_tilt = 25;
  double put_down_after = 0.4;
  double gyro_range = 2000;
  double accel_range = 150;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v.group(navigation, "navigation", "the filter that carries the pose between images");
    v.group(standstill, "standstill", "when the robot stands still");
    v.group(slip, "slip", "when wheels slip, told by vision where there is no IMU");
    v.group(edges, "edges", "motion between keyframes, from wheels and gyro alone");
    v(disagreements, "disagreements", "samples", range(1, 1000),
      "so many wheel samples in a row that IMU and vision contradict are slip");
    v(agreement, "agreement", "s", range(0, 100), "and wheels that agree for so long are believed again");
    v(lift_height, "lift_height", "m", range(0.001, 10), "the robot rises by so much: it is lifted");
    v(lift_tilt, "lift_tilt", "deg", range(1, 180), "or tilts by so much");
    v(put_down_after, "put_down_after", "s", range(0.05, 100),
      "lifted and then still, or rolling as the wheels say, for so long: it is put down");
    v(gyro_range, "gyro_range", "deg/s", range(1, 1e6), "rates beyond are cut off and count as unknown");
    v(accel_range, "accel_range", "m/s^2", range(10, 1e6), "forces beyond are cut off and count as unknown");
  }
};

/// Between the samples of wheels and IMU and the images: carries the estimate to each image's time, hands
/// vision a prior and takes its pose back, judges standstill, slip and lifting, and measures the motion
/// between keyframes. Samples come in the order of their stamps (of one stamp in any order); one thread at a
/// time; deterministic.
class OdometryBridge {
 public:
  OdometryBridge(const MotionSensors& sensors, const OdometryBridgeOptions& options);

  /// There is a sensor to go by.
  bool usable() const { return sensors_.imu || sensors_.wheels; }

  void add(const ImuSample& sample);
  void add(const WheelSample& sample);

  /// Begins at an instant with what was added so far: the body at the origin, yaw zero (the body's x axis, or
  /// its y axis if x is nearly upright, points along the world's), z up as far as the accelerometer tells,
  /// the body's own axes without one.
  SE3d start(TimeNs t);
  bool started() const { return filter_.started(); }

  /// Carries the estimate on to an image, not before the last sample.
  void advance(TimeNs t);
  /// Where the body is now, for vision to start from: T_world_body and the covariance of a right
  /// perturbation.
  UncertainMotion<double> pose() const {
    return {filter_.state().T_world_body, filter_.state().pose_covariance()};
  }
  /// The pose after looking, at the instant of advance. @param covariance of a right perturbation of
  /// T_world_body
  void correct(const SE3d& T_world_body, const Mat6<double>& covariance);
  /// The map around the robot was adjusted. What local adjustment moves, it moves because it knows better
  /// where the robot came along: velocity and wheels learn from it. Larger moves tell nothing of that and
  /// take the robot along.
  void follow_map(const SE3d& T_new_old);
  /// The map was moved under the robot as a whole, by a loop or a join.
  void move_map(const SE3d& T_new_old);

  /// How the body moved by wheels and gyro alone since the last call, or the start, until the last advance.
  UncertainMotion<double> take_motion();

  const NavigationFilter& filter() const { return filter_; }
  bool standing() const { return standing_; }
  bool slipping() const { return slip_since_.has_value(); }
  bool lifted() const { return lifted_; }

  /// What happened since the last call: standstill, slip, free_spin, lifted, put_down, sensor_gap.
  std::vector<Event> take_events();

 private:
  void judge_wheels(TimeNs t, const WheelCheck& check);
  void judge_lift(TimeNs t, double dt, const WheelCheck& check);
  void judge_standstill(TimeNs t);
  void tell_slip(TimeNs t, const WheelCheck& check, bool free);
  double tilt() const;
  void fold_motion(TimeNs t);

  MotionSensors sensors_;
  OdometryBridgeOptions options_;
  NavigationFilter filter_;
  std::optional<StandstillDetector> standstill_;
  std::optional<SlipDetector> slip_by_vision_;  // without an IMU
  std::optional<OdometryIntegrator> edges_;
  std::vector<Event> events_;

  // Before the start.
  std::deque<ImuSample> early_;

  std::optional<TimeNs> last_imu_, last_wheels_;
  // Standstill.
  bool standing_ = false;
  TimeNs stopped_at_ = 0;  // stand_still was told until here
  Vec3<double> gyro_sum_ = Vec3<double>::Zero();
  int gyro_count_ = 0;
  // Slip.
  int disagreements_ = 0;
  TimeNs agreed_since_ = 0;
  std::optional<TimeNs> slip_since_;
  // The pose before, as vision had it.
  std::optional<std::pair<TimeNs, SE3d>> seen_;
  // Lifting.
  bool lifted_ = false;
  double risen_ = 0;
  TimeNs calm_since_ = 0;
  // Motion by wheels and gyro alone since it was taken, summed up until then.
  UncertainMotion<double> motion_;
  TimeNs moved_until_ = 0;
};

}  // namespace sweepkit
