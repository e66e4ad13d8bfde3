// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <optional>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/sample.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/motion/impl/imu_rules.hpp"

namespace sweepkit {

/// Constant parts of the readings that are no motion.
struct ImuBias {
  Vec3<double> gyro = Vec3<double>::Zero();   ///< [rad/s]
  Vec3<double> accel = Vec3<double>::Zero();  ///< [m/s^2]
};

/// Attitude, velocity and position of the body in a world.
struct ImuState {
  SO3d R_world_body;
  Vec3<double> velocity = Vec3<double>::Zero();  ///< in the world [m/s]
  Vec3<double> position = Vec3<double>::Zero();  ///< [m]
};

/// What an IMU says about the motion from `begin` to `end`, whatever pose, velocity and gravity it starts
/// with:
///
///     R_end = R_begin dR
///     v_end = v_begin + g dt + R_begin dv
///     p_end = p_begin + v_begin dt + g dt^2 / 2 + R_begin dp
///
/// Errors are (phi, dv, dp): dR Exp(phi), dv + .., dp + .. [rad, m/s, m]. Forster et al., On-manifold
/// preintegration (2017).
struct ImuDelta {
  TimeNs begin = 0;
  TimeNs end = 0;
  SO3d R;
  Vec3<double> v = Vec3<double>::Zero();
  Vec3<double> p = Vec3<double>::Zero();
  ImuBias bias;  ///< what was taken off the samples

  /// Derivatives with respect to the bias; that of R is on the right: R(b + db) = R Exp(R_gyro db).
  Mat3<double> R_gyro = Mat3<double>::Zero();
  Mat3<double> v_gyro = Mat3<double>::Zero(), v_accel = Mat3<double>::Zero();
  Mat3<double> p_gyro = Mat3<double>::Zero(), p_accel = Mat3<double>::Zero();

  Eigen::Matrix<double, 9, 9> covariance = Eigen::Matrix<double, 9, 9>::Zero();  ///< of (phi, dv, dp)

  double uncovered = 0.0;  ///< time in holes between samples or beyond them [s]; the covariance tells
  double saturated = 0.0;  ///< time with a reading at the end of its range [s]; the covariance tells

  double seconds() const { return to_seconds(end - begin); }

  /// For another bias, to first order.
  ImuDelta corrected(const ImuBias& other) const {
    const Vec3<double> dg = other.gyro - bias.gyro, da = other.accel - bias.accel;
    ImuDelta result = *this;
    result.R = R * SO3d::exp(R_gyro * dg);
    result.v += v_gyro * dg + v_accel * da;
    result.p += p_gyro * dg + p_accel * da;
    result.bias = other;
    return result;
  }

  /// Where it leads from a state. `gravity` in the world, (0, 0, -9.81) with z up [m/s^2].
  ImuState predict(const ImuState& from, const Vec3<double>& gravity) const {
    const double dt = seconds();
    return {from.R_world_body * R, from.velocity + gravity * dt + from.R_world_body * v,
            from.position + from.velocity * dt + 0.5 * dt * dt * gravity + from.R_world_body * p};
  }
};

struct ImuPreintegrationOptions {
  double max_gap = 0.05;
  double gap_rate = 1.0;
  double gap_accel = 3.0;
  double gyro_range = 1e3;
  double accel_range = 1e4;
  double max_gyro_change = 0.01;
  double max_accel_change = 0.2;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(max_gap, "max_gap", "s", range(1e-4, 10.0), "samples farther apart than this are a hole");
    v(gap_rate, "gap_rate", "rad/s", range(0.0, 100.0), "error of the rate in a hole");
    v(gap_accel, "gap_accel", "m/s^2", range(0.0, 1000.0), "error of the acceleration in a hole");
    v(gyro_range, "gyro_range", "rad/s", range(1e-3, 1e9), "readings from there on are saturated");
    v(accel_range, "accel_range", "m/s^2", range(1e-3, 1e9), "readings from there on are saturated");
    v(max_gyro_change, "max_gyro_change", "rad/s", range(0.0, 100.0),
      "change of the bias from which on samples are integrated again");
    v(max_accel_change, "max_accel_change", "m/s^2", range(0.0, 100.0),
      "change of the bias from which on samples are integrated again");
  }
};

/// How an interval between two samples is integrated: a policy without state that offers
///
///     static constexpr std::string_view kName;
///     static constexpr bool kNeighbours;   // whether it wants the samples on either side as well
///     static ImuStep step(const ImuPiece& piece);
///
/// impl/imu_rules.hpp has what goes in and out.
template <class Rule>
concept ImuRule = requires(const ImuPiece& piece) {
  { Rule::kName } -> std::convertible_to<std::string_view>;
  { Rule::kNeighbours } -> std::convertible_to<bool>;
  { Rule::step(piece) } -> std::same_as<ImuStep>;
};

static_assert(ImuRule<MidpointRule> && ImuRule<ClosedFormRule> && ImuRule<CubicRule>);

/// Integrates samples from `begin` to `end`, cutting the intervals that these lie in. Samples that are not
/// newer than the one before, or not finite, are left out. In a hole the samples at its sides are joined by
/// straight lines, and the covariance grows by the errors given for holes; the same where a reading is
/// saturated. Beyond the samples the nearest one is held. Nothing without any good sample, or if end <=
/// begin.
/// @param samples in order of time; may reach beyond [begin, end], which helps the cubic rule
template <ImuRule Rule = ClosedFormRule>
std::optional<ImuDelta> preintegrate(std::span<const ImuSample> samples, TimeNs begin, TimeNs end,
                                     const ImuBias& bias, const ImuNoise& noise,
                                     const ImuPreintegrationOptions& options = {});

/// Keeps the samples of an interval, so that its delta can follow the bias: to first order while the bias has
/// changed little, by integrating again beyond a threshold. Not thread-safe.
template <ImuRule Rule = ClosedFormRule>
class BasicImuPreintegration {
 public:
  /// @throws Error(argument) if there is no good sample or end <= begin
  BasicImuPreintegration(std::span<const ImuSample> samples, TimeNs begin, TimeNs end, const ImuBias& bias,
                         const ImuNoise& noise, const ImuPreintegrationOptions& options = {})
      : samples_(samples.begin(), samples.end()), noise_(noise), options_(options) {
    const auto delta = preintegrate<Rule>(samples_, begin, end, bias, noise_, options_);
    require(delta.has_value(), "ImuPreintegration samples", "must have a good one, and end must follow begin",
            samples.size());
    delta_ = *delta;
  }

  /// The delta as last integrated.
  const ImuDelta& delta() const { return delta_; }

  /// The delta for a bias.
  ImuDelta at(const ImuBias& bias) {
    if ((bias.gyro - delta_.bias.gyro).norm() > options_.max_gyro_change ||
        (bias.accel - delta_.bias.accel).norm() > options_.max_accel_change) {
      delta_ = *preintegrate<Rule>(samples_, delta_.begin, delta_.end, bias, noise_, options_);
      ++integrations_;
    }
    return delta_.corrected(bias);
  }

  /// How often the samples were integrated.
  int integrations() const { return integrations_; }

 private:
  std::vector<ImuSample> samples_;
  ImuNoise noise_;
  ImuPreintegrationOptions options_;
  ImuDelta delta_;
  int integrations_ = 1;
};

using ImuPreintegration = BasicImuPreintegration<>;

}  // namespace sweepkit

#include "sweepkit/motion/impl/imu_preintegration.hpp"
