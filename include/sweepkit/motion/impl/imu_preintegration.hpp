// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "sweepkit/motion/imu_preintegration.hpp"

namespace sweepkit {

namespace impl {

/// [x]x M.
inline Mat3<double> cross_columns(const Vec3<double>& x, const Mat3<double>& M) {
  Mat3<double> result;
  for (int i = 0; i < 3; ++i) result.col(i) = x.cross(M.col(i));
  return result;
}

/// M [x]x: the rows of M crossed with x.
inline Mat3<double> cross_rows(const Mat3<double>& M, const Vec3<double>& x) {
  Mat3<double> result;
  result.col(0) = M.col(1) * x.z() - M.col(2) * x.y();
  result.col(1) = M.col(2) * x.x() - M.col(0) * x.z();
  result.col(2) = M.col(0) * x.y() - M.col(1) * x.x();
  return result;
}

/// Delta, Jacobians and covariance with the errors of the rotation in the frame of the start, Exp(theta) R.
/// There a step moves errors by [I 0 0; -[dv]x I 0; -[dp]x dt I], and noise that is alike in all directions
/// stays so: the block of the rotation is a number times I, those of rotation and velocity or position are
/// skew matrices, that is vectors. Nothing else is kept, and no matrix product is left in the covariance. The
/// derivative of theta with respect to the gyro's bias is also that of v with respect to the accelerometer's.
class ImuAccumulator {
 public:
  /// @param a mean specific force over the step
  /// @param gyro_variance, accel_variance densities squared [rad^2/s, m^2/s^3]
  void append(const ImuStep& step, const Vec3<double>& a, double dt, double gyro_variance,
              double accel_variance) {
    const Vec3<double>& phi = step.phi;
    const double x = phi.squaredNorm();
    double c2, c3, c4, c5, c6, w, half_sinc;
    if (x < 0.01) [[likely]] {
      c6 = 1.0 / 720 - x * (1.0 / 40320 - x / 3628800);
      c5 = 1.0 / 120 - x * (1.0 / 5040 - x / 362880);
      c4 = 1.0 / 24 - x * c6;
      c3 = 1.0 / 6 - x * c5;
      c2 = 1.0 / 2 - x * c4;
      w = 1 - x * (1.0 / 8 - x * (1.0 / 384 - x * (1.0 / 46080 - x / 10321920)));
      half_sinc = 0.5 - x * (1.0 / 48 - x * (1.0 / 3840 - x * (1.0 / 645120 - x / 185794560)));
    } else {
      const Stumpff<double> c(x);
      c2 = c.c2, c3 = c.c3, c4 = c.c4, c5 = c.c5;
      c6 = x < 1 ? 1.0 / 720 - x * (1.0 / 40320 - x * (1.0 / 3628800 - x / 479001600)) : (1.0 / 24 - c4) / x;
      const double theta = std::sqrt(x);
      w = std::cos(0.5 * theta);
      half_sinc = std::sin(0.5 * theta) / theta;
    }

    const Mat3<double> R = R_.toRotationMatrix();
    const Vec3<double> dv = R * step.dv, dp = R * step.dp;

    // Derivatives. With J1 = I + c2 [phi] + c3 [phi]^2, J2 = I/2 + c3 [phi] + c4 [phi]^2 the step is J1 a dt
    // and J2 a dt^2; R J1 and R J2 from R, R [phi] and R phi phi^T.
    const Vec3<double> R_phi = R * phi;
    const Mat3<double> R_hat = cross_rows(R, phi), outer = R_phi * phi.transpose();
    const Mat3<double> R_J1 = (1 - x * c3) * R + c2 * R_hat + c3 * outer;
    const Mat3<double> R_J2 = (0.5 - x * c4) * R + c3 * R_hat + c4 * outer;
    // The derivatives of J1 a and J2 a with respect to phi; those of C_k are (k C_(k+2) - C_(k+1)) / 2.
    const double d2 = c4 - 0.5 * c3, d3 = 0.5 * (3 * c5 - c4), d4 = 0.5 * (4 * c6 - c5);
    const double along = phi.dot(a);
    const Vec3<double> R_a = R * a, R_turned = R_phi.cross(R_a);
    const Mat3<double> R_hat_a = cross_rows(R, a);
    const Mat3<double> common = R_phi * a.transpose() + along * R;
    const Vec3<double> k1 = 2 * (-(c3 + x * d3) * R_a + d2 * R_turned + (d3 * along) * R_phi);
    const Vec3<double> k2 = 2 * (-(c4 + x * d4) * R_a + d3 * R_turned + (d4 * along) * R_phi);
    const double dt2 = dt * dt;
    p_gyro_ += dt * v_gyro_ - cross_columns(dp, theta_gyro_) -
               (dt2 * dt) * (c4 * common - c3 * R_hat_a + k2 * phi.transpose());
    v_gyro_ -= cross_columns(dv, theta_gyro_) + dt2 * (c3 * common - c2 * R_hat_a + k1 * phi.transpose());
    p_accel_ += dt * theta_gyro_ - dt2 * R_J2;
    theta_gyro_ -= dt * R_J1;

    // Covariance, with [x][y] = y x^T - (x y) I. `s` is that of theta halfway, so that noise within the step
    // counts.
    const double s = theta_ + 0.5 * gyro_variance * dt;
    const Vec3<double> y = dt * theta_v_ + theta_p_;
    P_pp_ += dt * (P_vp_ + P_vp_.transpose()) + dt2 * P_vv_;
    add_symmetric(P_pp_, dp, y, s);
    P_vp_ += dt * P_vv_;
    P_vp_ += y * dv.transpose() + dp * theta_v_.transpose() - s * (dp * dv.transpose());
    P_vp_.diagonal().array() -= dv.dot(y) + theta_v_.dot(dp) - s * dv.dot(dp) - 0.5 * accel_variance * dt2;
    add_symmetric(P_vv_, dv, theta_v_, s);
    P_vv_.diagonal().array() += accel_variance * dt;
    P_pp_.diagonal().array() += accel_variance * dt2 * dt / 3;
    theta_p_ = y - s * dp;
    theta_v_ -= s * dv;
    theta_ += gyro_variance * dt;

    p_ += dt * v_ + dp;
    v_ += dv;
    R_ = R_ * Eigen::Quaterniond(w, half_sinc * phi.x(), half_sinc * phi.y(), half_sinc * phi.z());
    R_.coeffs() *= 0.5 * (3 - R_.squaredNorm());
  }

  void put_into(ImuDelta& delta) const {
    delta.R = SO3d(R_);
    delta.v = v_;
    delta.p = p_;
    // Exp(theta) R = R Exp(R^T theta).
    const Mat3<double> back = delta.R.matrix().transpose();
    delta.R_gyro = back * theta_gyro_;
    delta.v_gyro = v_gyro_;
    delta.v_accel = theta_gyro_;
    delta.p_gyro = p_gyro_;
    delta.p_accel = p_accel_;
    auto& P = delta.covariance;
    P.block<3, 3>(0, 0).setZero();
    P.block<3, 3>(0, 0).diagonal().setConstant(theta_);
    P.block<3, 3>(3, 0) = cross_columns(theta_v_, back.transpose());
    P.block<3, 3>(6, 0) = cross_columns(theta_p_, back.transpose());
    P.block<3, 3>(0, 3) = P.block<3, 3>(3, 0).transpose();
    P.block<3, 3>(0, 6) = P.block<3, 3>(6, 0).transpose();
    P.block<3, 3>(3, 3) = P_vv_;
    P.block<3, 3>(3, 6) = P_vp_;
    P.block<3, 3>(6, 3) = P_vp_.transpose();
    P.block<3, 3>(6, 6) = P_pp_;
  }

 private:
  /// P += [x][y] + [y][x] - s [x][x].
  static void add_symmetric(Mat3<double>& P, const Vec3<double>& x, const Vec3<double>& y, double s) {
    const Vec3<double> z = y - (0.5 * s) * x;
    P += z * x.transpose() + x * z.transpose();
    P.diagonal().array() -= 2 * x.dot(z);
  }

  Eigen::Quaterniond R_ = Eigen::Quaterniond::Identity();
  Vec3<double> v_ = Vec3<double>::Zero(), p_ = Vec3<double>::Zero();
  Mat3<double> theta_gyro_ = Mat3<double>::Zero(), v_gyro_ = Mat3<double>::Zero();
  Mat3<double> p_gyro_ = Mat3<double>::Zero(), p_accel_ = Mat3<double>::Zero();
  double theta_ = 0.0;                           // covariance of theta, times I
  Vec3<double> theta_v_ = Vec3<double>::Zero();  // of v with theta: [theta_v]x
  Vec3<double> theta_p_ = Vec3<double>::Zero();  // of p with theta
  Mat3<double> P_vv_ = Mat3<double>::Zero(), P_vp_ = Mat3<double>::Zero(), P_pp_ = Mat3<double>::Zero();
};

/// The good samples of a span, one after the other.
class GoodImuSamples {
 public:
  explicit GoodImuSamples(std::span<const ImuSample> samples) : samples_(samples) {}

  static constexpr std::size_t kNone = ~std::size_t{0};

  std::size_t first() const {
    for (std::size_t i = 0; i < samples_.size(); ++i)
      if (good(i)) return i;
    return kNone;
  }
  /// The good one after i.
  std::size_t after(std::size_t i) const {
    for (std::size_t j = i + 1; j < samples_.size(); ++j)
      if (good(j) && samples_[j].t > samples_[i].t) return j;
    return kNone;
  }

 private:
  bool good(std::size_t i) const {
    // A sum is finite only if its terms are; overflow of finite ones does not happen with readings.
    return std::isfinite(samples_[i].gyro.sum() + samples_[i].accel.sum());
  }

  std::span<const ImuSample> samples_;
};

/// The cubic through up to four samples, in time.
class ImuCubic {
 public:
  /// @param points of increasing time
  ImuCubic(const ImuSample* const* points, int count) : points_(points), count_(count) {}

  /// Reading at t, without bias.
  void at(TimeNs t, const ImuBias& bias, Vec3<double>& w, Vec3<double>& a) const {
    w = -bias.gyro;
    a = -bias.accel;
    for (int i = 0; i < count_; ++i) {
      double weight = 1;
      for (int j = 0; j < count_; ++j)
        if (j != i)
          weight *=
              static_cast<double>(t - points_[j]->t) / static_cast<double>(points_[i]->t - points_[j]->t);
      w += weight * points_[i]->gyro;
      a += weight * points_[i]->accel;
    }
  }

 private:
  const ImuSample* const* points_;
  int count_;
};

}  // namespace impl

template <ImuRule Rule>
std::optional<ImuDelta> preintegrate(std::span<const ImuSample> samples, TimeNs begin, TimeNs end,
                                     const ImuBias& bias, const ImuNoise& noise,
                                     const ImuPreintegrationOptions& options) {
  constexpr std::size_t kNone = impl::GoodImuSamples::kNone;
  const impl::GoodImuSamples good(samples);
  std::size_t k = good.first();
  if (k == kNone || end <= begin) return std::nullopt;

  const double gyro_variance = noise.gyro_noise_density * noise.gyro_noise_density;
  const double accel_variance = noise.accel_noise_density * noise.accel_noise_density;
  const TimeNs max_gap = from_seconds(options.max_gap);
  const auto saturated = [&](const ImuSample& s) {
    return s.gyro.cwiseAbs().maxCoeff() >= options.gyro_range ||
           s.accel.cwiseAbs().maxCoeff() >= options.accel_range;
  };

  ImuDelta delta;
  delta.begin = begin;
  delta.end = end;
  delta.bias = bias;
  impl::ImuAccumulator sum;
  double unknown = 0.0;  // how long nothing has been known [s]
  const auto append = [&](const ImuPiece& piece, bool hole, bool full) {
    const ImuStep step = Rule::step(piece);
    double extra_gyro = 0.0, extra_accel = 0.0;
    if (hole || full) [[unlikely]] {
      // An error that lasts: its standard deviation grows with time, so its variance in steps of the square.
      const double grown = 2 * unknown + piece.dt;
      extra_gyro = options.gap_rate * options.gap_rate * grown;
      extra_accel = options.gap_accel * options.gap_accel * grown;
      unknown += piece.dt;
      (hole ? delta.uncovered : delta.saturated) += piece.dt;
    } else {
      unknown = 0.0;
    }
    sum.append(step, 0.5 * (piece.a0 + piece.a1), piece.dt, gyro_variance + extra_gyro,
               accel_variance + extra_accel);
  };
  const auto hold = [&](const ImuSample& s, TimeNs from, TimeNs to) {
    const Vec3<double> w = s.gyro - bias.gyro, a = s.accel - bias.accel;
    append({to_seconds(to - from), w, w, w, a, a, a}, true, false);
  };

  TimeNs t = begin;
  if (samples[k].t > t) {
    const TimeNs to = std::min(end, samples[k].t);
    hold(samples[k], t, to);
    t = to;
  }
  std::size_t before = kNone, next = good.after(k);
  while (next != kNone && samples[next].t <= t) {
    before = k;
    k = next;
    next = good.after(k);
  }
  std::size_t after = next == kNone || !Rule::kNeighbours ? kNone : good.after(next);
  bool full = saturated(samples[k]);
  while (t < end && next != kNone) {
    const ImuSample &s0 = samples[k], &s1 = samples[next];
    const TimeNs to = std::min(end, s1.t), gap = s1.t - s0.t;
    const bool hole = gap > max_gap, full_next = saturated(s1);
    ImuPiece piece;
    piece.dt = to_seconds(to - t);
    piece.w0 = s0.gyro - bias.gyro;
    piece.a0 = s0.accel - bias.accel;
    piece.w1 = s1.gyro - bias.gyro;
    piece.a1 = s1.accel - bias.accel;
    if constexpr (Rule::kNeighbours) {
      // Three samples or two at an end, or where a neighbour lies across a hole.
      const ImuSample* points[4];
      int count = 0;
      if (before != kNone && !hole && s0.t - samples[before].t <= max_gap) points[count++] = &samples[before];
      points[count++] = &s0;
      points[count++] = &s1;
      if (after != kNone && !hole && samples[after].t - s1.t <= max_gap) points[count++] = &samples[after];
      if (count < 4 && !hole && count > 2) {
        // At an end of the samples the fourth point lies inwards, if there is one.
        const std::size_t inner = points[0] == &s0 ? good.after(after) : kNone;
        if (inner != kNone && samples[inner].t - samples[after].t <= max_gap)
          points[count++] = &samples[inner];
      }
      const bool even = count == 4 && points[1] == &s0 && t == s0.t && to == s1.t &&
                        std::abs((s0.t - points[0]->t) - gap) * 1000 <= gap &&
                        std::abs((points[3]->t - s1.t) - gap) * 1000 <= gap;
      if (even) [[likely]] {
        piece.w_middle =
            0.5625 * (s0.gyro + s1.gyro) - 0.0625 * (points[0]->gyro + points[3]->gyro) - bias.gyro;
        piece.a_middle =
            0.5625 * (s0.accel + s1.accel) - 0.0625 * (points[0]->accel + points[3]->accel) - bias.accel;
      } else {
        const impl::ImuCubic cubic(points, count);
        if (t != s0.t) cubic.at(t, bias, piece.w0, piece.a0);
        if (to != s1.t) cubic.at(to, bias, piece.w1, piece.a1);
        cubic.at(t + (to - t) / 2, bias, piece.w_middle, piece.a_middle);
      }
    } else if (t != s0.t || to != s1.t) {
      const Vec3<double> w0 = piece.w0, a0 = piece.a0, dw = piece.w1 - piece.w0, da = piece.a1 - piece.a0;
      const double from = to_seconds(t - s0.t) / to_seconds(gap),
                   until = to_seconds(to - s0.t) / to_seconds(gap);
      piece.w0 = w0 + from * dw;
      piece.a0 = a0 + from * da;
      piece.w1 = w0 + until * dw;
      piece.a1 = a0 + until * da;
    }
    append(piece, hole, full || full_next);
    t = to;
    full = full_next;
    before = k;
    k = next;
    if constexpr (Rule::kNeighbours) {
      next = after;
      after = next == kNone ? kNone : good.after(next);
    } else {
      next = good.after(k);
    }
  }
  if (t < end) hold(samples[k], t, end);
  sum.put_into(delta);
  return delta;
}

}  // namespace sweepkit
