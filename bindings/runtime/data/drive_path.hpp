// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "sweepkit/geometry/so3.hpp"

namespace sweepkit {

using Points = std::vector<Vec2<double>>;

/// A chain of straight pieces with rounded corners. At a corner the bend of the chain, a ramp in the length,
/// is replaced by the integral of a smooth step: the direction turns with two continuous derivatives.
class RoundedPath {
 public:
  /// @param points at least two, neighbours apart, no turn by 180 degrees
  /// @param corner length over which a corner is rounded at each side; less where the pieces are short
  RoundedPath(const Points& points, double corner);

  double length() const { return length_; }  ///< of the chain [m]

  struct Place {
    Vec2<double> p;    ///< position
    Vec2<double> d;    ///< its derivative by the length of the chain; |d| <= 1
    double curvature;  ///< [rad/m] of true length
  };
  Place at(double s) const;

 private:
  struct Corner {
    double s, half;     // where on the chain, and half the length of the rounding
    Vec2<double> bend;  // change of direction
  };
  Vec2<double> origin_, direction_;
  std::vector<Corner> corners_;
  double length_ = 0.0;
};

/// Length along a path over time: from rest to rest within limits of speed, turn rate and acceleration; the
/// acceleration is continuous.
class PathTiming {
 public:
  PathTiming(const RoundedPath& path, double speed, double turn_rate, double acceleration);

  double duration() const;
  double at(double t) const;

 private:
  static constexpr double kStep = 0.01;
  std::vector<double> s_, v_;
};

/// From 0 to `whole` in the time `duration`, with the smooth start and end that the limits allow.
struct SmoothRun {
  SmoothRun(double whole, double speed, double acceleration);
  double at(double t) const;

  double speed, ramp, duration, sign;
};

}  // namespace sweepkit
