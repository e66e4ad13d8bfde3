// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/sample.hpp"
#include "sweepkit/data/pose_spline.hpp"

namespace sweepkit {

/// A differential drive with an encoder on each wheel.
struct WheelSimulationOptions {
  double rate_hz = 50.0;
  double ticks_per_revolution = 1560.0;
  double wheel_radius = 0.035;
  double track_width = 0.235;
  double radius_error_left = 0.012;
  double radius_error_right = -0.008;
  double track_error = -0.011;
  double creep = 0.001;
  bool quantised = true;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(rate_hz, "rate_hz", "Hz", range(1.0, 10000.0), "samples a second");
    v(ticks_per_revolution, "ticks_per_revolution", "", range(1.0, 1e9),
      "counts of an encoder a turn of its wheel");
    v(wheel_radius, "wheel_radius", "m", range(0.001, 1.0), "nominal, as sensor.yaml tells it");
    v(track_width, "track_width", "m", range(0.01, 10.0), "nominal, as sensor.yaml tells it");
    v(radius_error_left, "radius_error_left", "", range(-0.5, 0.5), "true radius over nominal, less 1");
    v(radius_error_right, "radius_error_right", "", range(-0.5, 0.5), "true radius over nominal, less 1");
    v(track_error, "track_error", "", range(-0.5, 0.5), "true track over nominal, less 1");
    v(creep, "creep", "m/sqrt(m)", range(0.0, 0.5),
      "random walk of what a wheel rolls against the ground, over the square root of the way");
    v(quantised, "quantised", "", any_value(),
      "whole ticks, as an encoder counts; otherwise fractions of them");
  }

  /// The same without creep and quantisation; errors of radius and track stay.
  WheelSimulationOptions ideal() const;
  /// What is written into sensor.yaml.
  WheelGeometry nominal() const { return {ticks_per_revolution, wheel_radius, track_width}; }
  double true_radius_left() const { return wheel_radius * (1.0 + radius_error_left); }
  double true_radius_right() const { return wheel_radius * (1.0 + radius_error_right); }
  double true_track() const { return track_width * (1.0 + track_error); }
};

/// A time in which wheels do not roll on the ground as the robot moves: in `slip` they roll farther, in
/// `free` they turn at their own speeds whatever the robot does. It sets in and ends within `ramp`; where
/// several overlap, the later in the list is applied to what the earlier give.
struct WheelEpisode {
  enum class Kind { slip, free };
  Kind kind = Kind::slip;
  double begin = 0.0;        ///< [s] from the motion's beginning
  double end = 0.0;          ///< [s]
  double ramp = 0.1;         ///< [s], at both ends
  double grip_left = 1.0;    ///< slip: moved over rolled, above 0
  double grip_right = 1.0;   ///< slip: moved over rolled, above 0
  double speed_left = 0.0;   ///< free [m/s] at the rim
  double speed_right = 0.0;  ///< free [m/s] at the rim
};

/// Cumulative ticks of both wheels from the beginning of the motion to its end; at an instant each is the
/// integral of the forward speed of its contact point, v -+ w b / 2 in the base's own axes, over its true
/// circumference, from a start value of its own. The integral is that of the spline (Gauss and Legendre,
/// three points a knot).
/// @param seed of start values and creep
/// @throws Error(option) for options out of range, Error(argument) for an episode that ends before it begins
std::vector<WheelSample> simulate_wheels(const PoseSpline& base, TimeNs begin,
                                         const WheelSimulationOptions& options,
                                         std::span<const WheelEpisode> episodes, std::uint64_t seed);

}  // namespace sweepkit
