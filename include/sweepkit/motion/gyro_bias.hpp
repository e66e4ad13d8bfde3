// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <deque>
#include <optional>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/sample.hpp"
#include "sweepkit/motion/gyro_integration.hpp"

namespace sweepkit {

/// A gyro bias and how uncertain it is.
struct GyroBiasEstimate {
  Vec3<double> bias = Vec3<double>::Zero();        ///< [rad/s]
  Mat3<double> covariance = Mat3<double>::Zero();  ///< [rad^2/s^2]
};

/// The same rotation, from one image to a later one, by vision and by the gyro. All in the body frame: a
/// camera's pose goes through its mounting first, T_world_body = T_world_camera T_body_camera^-1.
struct TurnPair {
  SO3d R_vision;  ///< R_body(begin)_body(end)
  GyroDelta gyro;
};

struct GyroBiasWindowOptions {
  double vision_sigma = 0.15;
  double outlier_sigmas = 3.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(vision_sigma, "vision_sigma", "deg", range(1e-6, 90.0), "error of each attitude from vision");
    v(outlier_sigmas, "outlier_sigmas", "", range(0.5, 1e6), "residuals of that size count half (Cauchy)");
  }
};

/// The bias that makes gyro and vision agree over a window, by least squares:
///
///     argmin over db of  sum over pairs of |Log(R_vision^-1 R_gyro Exp(J db))|^2 / variance
///
/// which is positive definite with the derivative J from the integration. Weights are inverse variances of
/// vision and gyro together; Gauss and Newton, to convergence. The covariance takes into account that
/// neighbouring pairs share an attitude, whose errors then cancel. Nothing without pairs.
inline std::optional<GyroBiasEstimate> solve_gyro_bias(std::span<const TurnPair> pairs,
                                                       const GyroBiasWindowOptions& options = {}) {
  if (pairs.empty()) return std::nullopt;
  constexpr double kDegree = 0.017453292519943295;
  const double pose_variance = std::pow(options.vision_sigma * kDegree, 2);
  Vec3<double> bias = pairs.front().gyro.bias;
  Mat3<double> H;
  // Residual, its derivative and its weight for a pair at the present bias.
  struct Term {
    Vec3<double> r;
    Mat3<double> J;
    double weight;
  };
  const auto term = [&](const TurnPair& pair) {
    const GyroDelta& g = pair.gyro;
    const Vec3<double> turned = g.R_gyro * (bias - g.bias);
    Term result;
    result.r = (pair.R_vision.inverse() * g.R * SO3d::exp(turned)).log();
    result.J = SO3d::right_jacobian_inverse(result.r) * SO3d::right_jacobian(turned) * g.R_gyro;
    const double sigma = std::sqrt(2 * pose_variance + g.variance);
    const double size = result.r.norm() / sigma;
    result.weight = 1.0 / (1.0 + std::pow(size / options.outlier_sigmas, 2)) / (sigma * sigma);
    return result;
  };
  for (int iteration = 0; iteration < 10; ++iteration) {
    H.setZero();
    Vec3<double> b = Vec3<double>::Zero();
    for (const TurnPair& pair : pairs) {
      const Term t = term(pair);
      H += t.weight * (t.J.transpose() * t.J);
      b -= t.weight * (t.J.transpose() * t.r);
    }
    const Vec3<double> step = H.ldlt().solve(b);
    if (!step.allFinite()) return std::nullopt;
    bias += step;
    if (step.norm() < 1e-9) break;
  }
  // What the estimate's error is made of: gyro noise, and the errors of attitudes, which two pairs may share.
  Mat3<double> S = Mat3<double>::Zero(), carried = Mat3<double>::Zero();
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    const Term t = term(pairs[k]);
    const Mat3<double> WJ = t.weight * t.J;
    S += (2 * pose_variance + pairs[k].gyro.variance) * (WJ.transpose() * WJ);
    if (k > 0 && pairs[k - 1].gyro.end == pairs[k].gyro.begin) {
      const Mat3<double> cross = pose_variance * (carried.transpose() * pairs[k].R_vision.matrix() * WJ);
      S -= cross + cross.transpose();
    }
    carried = WJ;
  }
  const Mat3<double> H_inverse = H.inverse();
  GyroBiasEstimate result{bias, H_inverse * S * H_inverse};
  if (!result.covariance.allFinite()) return std::nullopt;
  return result;
}

/// Moves from one bias towards another, by at most that much [rad/s].
inline Vec3<double> limit_change(const Vec3<double>& from, const Vec3<double>& to, double most) {
  const Vec3<double> change = to - from;
  const double size = change.norm();
  return size <= most ? to : Vec3<double>(from + change * (most / size));
}

/// A low pass of first order: each update moves it by 1 - exp(-dt / tau) of the way. While it is younger than
/// tau it takes the mean so far, so that the first value does not linger. Before the first it has no value.
class FirstOrderFilter {
 public:
  explicit FirstOrderFilter(double time_constant) : tau_(time_constant) {}

  /// @param dt time since the last update [s]
  const Vec3<double>& update(const Vec3<double>& input, double dt) {
    dt = std::max(dt, 0.0);
    if (!value_) {
      value_ = input;
      return *value_;
    }
    age_ += dt;
    const double settled = tau_ > 0 ? -std::expm1(-dt / tau_) : 1.0;
    *value_ += std::max(settled, age_ > 0 ? dt / age_ : 0.0) * (input - *value_);
    return *value_;
  }
  const std::optional<Vec3<double>>& value() const { return value_; }

 private:
  double tau_;
  double age_ = 0.0;
  std::optional<Vec3<double>> value_;
};

/// Zero-rate update: at standstill the mean of the gyro is its bias. One object for each stand. The error of
/// the mean is the noise density over the root of the time, and what the bias walks meanwhile.
class StandstillBias {
 public:
  explicit StandstillBias(const ImuNoise& noise) : noise_(noise) {}

  /// What is not newer than the last, or not finite, is left out.
  void add(const ImuSample& sample) {
    if (!std::isfinite(sample.gyro.sum()) || (count_ > 0 && sample.t <= last_)) return;
    if (count_ == 0) first_ = sample.t;
    last_ = sample.t;
    ++count_;
    mean_ += (sample.gyro - mean_) / static_cast<double>(count_);
  }
  std::size_t count() const { return count_; }
  /// Time that the samples stand for [s].
  double seconds() const {
    return count_ < 2
               ? 0.0
               : to_seconds(last_ - first_) * static_cast<double>(count_) / static_cast<double>(count_ - 1);
  }
  /// Nothing before two samples.
  std::optional<GyroBiasEstimate> estimate() const {
    if (count_ < 2) return std::nullopt;
    const double T = seconds();
    const double variance = noise_.gyro_noise_density * noise_.gyro_noise_density / T +
                            noise_.gyro_random_walk * noise_.gyro_random_walk * T / 3;
    return GyroBiasEstimate{mean_, variance * Mat3<double>::Identity()};
  }

 private:
  ImuNoise noise_;
  TimeNs first_ = 0, last_ = 0;
  std::size_t count_ = 0;
  Vec3<double> mean_ = Vec3<double>::Zero();
};

/// Two independent estimates of one bias, weighted by their inverse covariances.
inline GyroBiasEstimate blend(const GyroBiasEstimate& a, const GyroBiasEstimate& b) {
  const Mat3<double> K = a.covariance * (a.covariance + b.covariance).inverse();
  const Mat3<double> keep = Mat3<double>::Identity() - K;
  return {a.bias + K * (b.bias - a.bias),
          keep * a.covariance * keep.transpose() + K * b.covariance * K.transpose()};
}

struct GyroBiasOptions {
  GyroBiasWindowOptions window;
  double window_length = 10.0;
  int min_pairs = 3;
  double min_time = 3.0;
  double max_change = 0.2;
  double time_constant = 5.0;
  bool use_vision = true;
  bool use_standstill = true;
  double min_stand = 0.5;
  double longest_pair = 2.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v.group(window, "window", "least squares over the window");
    v(window_length, "window_length", "s", range(0.01, 1e4), "length of the window of attitudes");
    v(min_pairs, "min_pairs", "", range(1, 100000), "fewer pairs tell nothing");
    v(min_time, "min_time", "s", range(0.0, 1e4), "pairs of less time in all tell nothing");
    v(max_change, "max_change", "deg/s", range(0.0, 1e3), "largest change by one update");
    v(time_constant, "time_constant", "s", range(0.0, 1e4), "of the low pass; 0: none");
    v(use_vision, "use_vision", "", any_value(), "estimate against vision");
    v(use_standstill, "use_standstill", "", any_value(), "estimate at standstill");
    v(min_stand, "min_stand", "s", range(0.01, 1e4), "shorter stands tell nothing");
    v(longest_pair, "longest_pair", "s", range(0.01, 1e4), "attitudes farther apart are not paired");
  }
};

/// Follows the bias of a gyro through a drive: window least squares against attitudes from vision, means at
/// standstill, both blended by their inverse covariances, the change limited and smoothed. Attitudes have to
/// come in order of time, each after the samples up to it. Not thread-safe.
class GyroBiasEstimator {
 public:
  explicit GyroBiasEstimator(const ImuNoise& noise, const GyroBiasOptions& options = {},
                             const Vec3<double>& start = Vec3<double>::Zero())
      : noise_(noise), options_(options), filter_(options.time_constant), bias_(start) {
    check_options(options);
  }

  /// False for a sample that is not newer than the last or not finite.
  bool add(const ImuSample& sample) {
    if (!std::isfinite(sample.gyro.sum()) || (!samples_.empty() && sample.t <= samples_.back().t))
      return false;
    samples_.push_back(sample);
    if (standing_) standing_->add(sample);
    return true;
  }
  /// Tells whether the body stands still from now on (the newest sample).
  void set_standing(bool standing) {
    if (standing && !standing_) standing_.emplace(noise_);
    if (!standing && standing_) {
      end_stand();
      standing_.reset();
    }
  }
  /// An attitude from vision, R_world_body at t: a keyframe. Updates the bias.
  void add_attitude(TimeNs t, const SO3d& R_world_body);
  /// Vision is lost or its map moved: the next attitude pairs with none before it.
  void break_attitudes() { has_attitude_ = false; }

  const Vec3<double>& bias() const { return bias_; }
  /// What the last update went towards, before limit and low pass; nothing before the first.
  const std::optional<GyroBiasEstimate>& target() const { return target_; }
  /// Whether there has been an estimate.
  bool known() const { return target_.has_value(); }

 private:
  void end_stand() {
    if (!options_.use_standstill || standing_->seconds() < options_.min_stand) return;
    stand_ = standing_->estimate();
    stand_time_ = samples_.back().t;
    update(stand_time_);
  }
  void update(TimeNs t);

  ImuNoise noise_;
  GyroBiasOptions options_;
  FirstOrderFilter filter_;
  Vec3<double> bias_;
  std::vector<ImuSample> samples_;  // since the last attitude
  std::vector<TurnPair> pairs_;
  std::optional<StandstillBias> standing_;
  std::optional<GyroBiasEstimate> stand_, target_;
  TimeNs stand_time_ = 0, attitude_time_ = 0, updated_ = 0;
  SO3d attitude_;
  bool has_attitude_ = false;
};

inline void GyroBiasEstimator::add_attitude(TimeNs t, const SO3d& R_world_body) {
  if (!R_world_body.quaternion().coeffs().allFinite() || (has_attitude_ && t <= attitude_time_)) return;
  if (has_attitude_ && t - attitude_time_ <= from_seconds(options_.longest_pair)) {
    const auto gyro = integrate_gyro(samples_, attitude_time_, t, bias_, noise_);
    if (gyro && gyro->uncovered <= 0.1 * gyro->seconds())
      pairs_.push_back({attitude_.inverse() * R_world_body, *gyro});
  }
  const TimeNs oldest = t - from_seconds(options_.window_length);
  std::erase_if(pairs_, [&](const TurnPair& pair) { return pair.gyro.begin < oldest; });
  attitude_ = R_world_body;
  attitude_time_ = t;
  has_attitude_ = true;
  // The sample before t is where the next integration starts.
  const auto next = std::upper_bound(samples_.begin(), samples_.end(), t,
                                     [](TimeNs time, const ImuSample& s) { return time < s.t; });
  if (next - samples_.begin() > 1) samples_.erase(samples_.begin(), next - 1);
  if (standing_ && options_.use_standstill && standing_->seconds() >= options_.min_stand) {
    stand_ = standing_->estimate();
    stand_time_ = t;
  }
  update(t);
}

inline void GyroBiasEstimator::update(TimeNs t) {
  constexpr double kDegree = 0.017453292519943295;
  std::optional<GyroBiasEstimate> target;
  double time = 0.0;
  for (const TurnPair& pair : pairs_) time += pair.gyro.seconds();
  if (options_.use_vision && static_cast<int>(pairs_.size()) >= options_.min_pairs &&
      time >= options_.min_time)
    target = solve_gyro_bias(pairs_, options_.window);
  if (stand_) {
    GyroBiasEstimate aged = *stand_;
    aged.covariance.diagonal().array() +=
        noise_.gyro_random_walk * noise_.gyro_random_walk * to_seconds(t - stand_time_);
    target = target ? blend(aged, *target) : aged;
  }
  if (!target) return;
  const double most = options_.max_change * kDegree;
  // The first estimate is taken as it is; there is nothing better to go on.
  const bool first = !target_;
  const Vec3<double> goal = first ? target->bias : limit_change(bias_, target->bias, most);
  bias_ = filter_.update(goal, first ? 0.0 : to_seconds(t - updated_));
  target_ = target;
  updated_ = t;
}

}  // namespace sweepkit
