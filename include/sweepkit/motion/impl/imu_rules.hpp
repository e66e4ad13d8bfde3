// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string_view>

#include "sweepkit/geometry/so3.hpp"

namespace sweepkit {

/// Readings at the ends of a piece of time, bias taken off, and in its middle where a rule asks for it.
struct ImuPiece {
  double dt = 0.0;
  Vec3<double> w0, w1, w_middle;  ///< angular rates [rad/s]
  Vec3<double> a0, a1, a_middle;  ///< specific forces [m/s^2]
};

/// The motion over the piece in the frame that it begins in: rotation vector, velocity and position gained
/// (without gravity).
struct ImuStep {
  Vec3<double> phi, dv, dp;
};

/// Mean rate; mean of the accelerations at both ends, each turned by the attitude there.
struct MidpointRule {
  static constexpr std::string_view kName = "midpoint";
  static constexpr bool kNeighbours = false;

  static ImuStep step(const ImuPiece& s) {
    const Vec3<double> phi = (0.5 * s.dt) * (s.w0 + s.w1);
    const Vec3<double> dv = (0.5 * s.dt) * (s.a0 + SO3<double>::exp(phi) * s.a1);
    return {phi, dv, (0.5 * s.dt) * dv};
  }
};

/// Exact for a rate and a specific force that are constant in the body over the piece: their means.
struct ClosedFormRule {
  static constexpr std::string_view kName = "closed_form";
  static constexpr bool kNeighbours = false;

  static ImuStep step(const ImuPiece& s) {
    const Vec3<double> phi = (0.5 * s.dt) * (s.w0 + s.w1), a = 0.5 * (s.a0 + s.a1);
    const double x = phi.squaredNorm();
    double c2, c3, c4;
    if (x < 0.01) [[likely]] {
      c2 = 1.0 / 2 - x * (1.0 / 24 - x * (1.0 / 720 - x / 40320));
      c3 = 1.0 / 6 - x * (1.0 / 120 - x * (1.0 / 5040 - x / 362880));
      c4 = 1.0 / 24 - x * (1.0 / 720 - x * (1.0 / 40320 - x / 3628800));
    } else {
      const impl::Stumpff<double> c(x);
      c2 = c.c2, c3 = c.c3, c4 = c.c4;
    }
    const Vec3<double> b = phi.cross(a), c = phi.cross(b);
    return {phi, s.dt * (a + c2 * b + c3 * c), (s.dt * s.dt) * (0.5 * a + c3 * b + c4 * c)};
  }
};

/// Samples joined by cubics through four of them: Simpson's rule for what they integrate to, with the second
/// term of the Magnus series for the rotation (coning). Fourth order in the interval.
struct CubicRule {
  static constexpr std::string_view kName = "cubic";
  static constexpr bool kNeighbours = true;

  static ImuStep step(const ImuPiece& s) {
    const double h = s.dt;
    // Rotation up to the middle and to the end.
    const Vec3<double> half =
        (h / 24) * (5 * s.w0 + 8 * s.w_middle - s.w1) + (h * h / 48) * s.w0.cross(s.w_middle);
    const Vec3<double> full = (h / 6) * (s.w0 + 4 * s.w_middle + s.w1) + (h * h / 12) * s.w0.cross(s.w1);
    const Vec3<double> f1 = turn(half, s.a_middle), f2 = turn(full, s.a1);
    return {full, (h / 6) * (s.a0 + 4 * f1 + f2), (h * h / 6) * (s.a0 + 2 * f1)};
  }

 private:
  /// Exp(phi) a.
  static Vec3<double> turn(const Vec3<double>& phi, const Vec3<double>& a) {
    const double x = phi.squaredNorm();
    double c1, c2;
    if (x < 0.01) [[likely]] {
      c1 = 1 - x * (1.0 / 6 - x * (1.0 / 120 - x / 5040));
      c2 = 1.0 / 2 - x * (1.0 / 24 - x * (1.0 / 720 - x / 40320));
    } else {
      const impl::Stumpff<double> c(x);
      c1 = c.c1, c2 = c.c2;
    }
    const Vec3<double> b = phi.cross(a);
    return a + c1 * b + c2 * phi.cross(b);
  }
};

}  // namespace sweepkit
