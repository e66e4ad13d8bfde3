// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <span>

#include "sweepkit/core/sample.hpp"
#include "sweepkit/geometry/so3.hpp"

namespace sweepkit {

/// The rotation from `begin` to `end` by the gyro alone.
struct GyroDelta {
  TimeNs begin = 0;
  TimeNs end = 0;
  SO3d R;                                      ///< R_body(begin)_body(end)
  Vec3<double> bias = Vec3<double>::Zero();    ///< what was taken off the samples [rad/s]
  Mat3<double> R_gyro = Mat3<double>::Zero();  ///< R(b + db) = R Exp(R_gyro db)
  double variance = 0.0;                       ///< of each component of the error, R Exp(e) [rad^2]
  double uncovered = 0.0;                      ///< time in holes or beyond the samples [s]

  double seconds() const { return to_seconds(end - begin); }
};

/// Integrates gyro samples: straight lines between them, the mean rate and its coning term (h^2 / 12 w0 x w1)
/// over each interval. What preintegrate() does for the rotation, at a third of the time. Samples that are
/// not newer than the one before, or not finite, are left out. Nothing without a good sample or if end <=
/// begin.
/// @param samples in order of time; may reach beyond [begin, end]
/// @param max_gap samples farther apart are a hole, in which the rate is off by `gap_rate` [s, rad/s]
inline std::optional<GyroDelta> integrate_gyro(std::span<const ImuSample> samples, TimeNs begin, TimeNs end,
                                               const Vec3<double>& bias, const ImuNoise& noise,
                                               double max_gap = 0.05, double gap_rate = 1.0) {
  if (end <= begin) return std::nullopt;
  GyroDelta delta;
  delta.begin = begin;
  delta.end = end;
  delta.bias = bias;
  Eigen::Quaterniond q = Eigen::Quaterniond::Identity();
  Mat3<double> theta = Mat3<double>::Zero();  // derivative of the error in the frame of the start
  double hole = 0.0;
  const auto turn = [&](const Vec3<double>& phi, double dt) {
    const double x = phi.squaredNorm();
    double c2, c3, w, half_sinc;
    if (x < 0.01) [[likely]] {
      c2 = 1.0 / 2 - x * (1.0 / 24 - x * (1.0 / 720 - x / 40320));
      c3 = 1.0 / 6 - x * (1.0 / 120 - x * (1.0 / 5040 - x / 362880));
      w = 1 - x * (1.0 / 8 - x * (1.0 / 384 - x * (1.0 / 46080 - x / 10321920)));
      half_sinc = 0.5 - x * (1.0 / 48 - x * (1.0 / 3840 - x * (1.0 / 645120 - x / 185794560)));
    } else {
      const impl::Stumpff<double> c(x);
      c2 = c.c2, c3 = c.c3;
      const double angle = std::sqrt(x);
      w = std::cos(0.5 * angle);
      half_sinc = std::sin(0.5 * angle) / angle;
    }
    // R J_l(phi) = R + c2 R [phi] + c3 R [phi]^2, with R [phi] = [R phi] R.
    const Mat3<double> R = q.toRotationMatrix();
    const Vec3<double> p = R * phi;
    for (int i = 0; i < 3; ++i) {
      const Vec3<double> a = p.cross(R.col(i));
      theta.col(i) -= dt * (R.col(i) + c2 * a + c3 * p.cross(a));
    }
    q = q * Eigen::Quaterniond(w, half_sinc * phi.x(), half_sinc * phi.y(), half_sinc * phi.z());
    q.coeffs() *= 0.5 * (3 - q.squaredNorm());
  };
  const auto cover = [&](double dt, bool covered) {
    delta.variance += noise.gyro_noise_density * noise.gyro_noise_density * dt;
    if (!covered) hole += dt;
  };

  const ImuSample* last = nullptr;
  TimeNs t = begin;
  for (const ImuSample& s : samples) {
    if (!std::isfinite(s.gyro.sum()) || (last && s.t <= last->t)) continue;
    if (s.t > t) {
      const TimeNs to = std::min(end, s.t);
      const double dt = to_seconds(to - t);
      if (!last) {
        turn((s.gyro - bias) * dt, dt);
        cover(dt, false);
      } else {
        Vec3<double> w0 = last->gyro - bias, w1 = s.gyro - bias;
        const double gap = to_seconds(s.t - last->t);
        if (last->t != t || s.t != to) {
          const Vec3<double> slope = (w1 - w0) / gap, start = w0;
          w0 = start + slope * to_seconds(t - last->t);
          w1 = start + slope * to_seconds(to - last->t);
        }
        turn((0.5 * dt) * (w0 + w1) + (dt * dt / 12) * w0.cross(w1), dt);
        cover(dt, gap <= max_gap);
      }
      t = to;
    }
    last = &s;
    if (t >= end) break;
  }
  if (!last) return std::nullopt;
  if (t < end) {
    const double dt = to_seconds(end - t);
    turn((last->gyro - bias) * dt, dt);
    cover(dt, false);
  }
  delta.R = SO3d(q);
  delta.R_gyro = delta.R.matrix().transpose() * theta;
  delta.variance += gap_rate * gap_rate * hole * hole;
  delta.uncovered = hole;
  return delta;
}

}  // namespace sweepkit
