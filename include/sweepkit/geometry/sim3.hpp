// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/LU>

#include "sweepkit/core/error.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

template <class S>
using Vec7 = Eigen::Matrix<S, 7, 1>;
template <class S>
using Mat7 = Eigen::Matrix<S, 7, 7>;

/// Similarities of space: T p = s R p + t with s > 0. T_a_b takes points in b to a.
/// Tangent vectors are (rho, phi, sigma) with s = e^sigma; T * Exp(xi) perturbs on the right.
/// Strasdat, Local accuracy and global consistency for efficient visual SLAM (2012), section 2.5.
template <class S>
class Sim3 {
 public:
  using Scalar = S;
  using Tangent = Vec7<S>;

  Sim3() : t_(Vec3<S>::Zero()), s_(1) {}
  /// Throws Error(argument) unless the scale is positive.
  Sim3(const SO3<S>& R, const Vec3<S>& t, const S& scale) : R_(R), t_(t), s_(scale) {
    require(scale > S(0), "Sim3 scale", "must be positive", scale);
  }
  /// A rigid motion has the scale 1.
  explicit Sim3(const SE3<S>& T) : R_(T.rotation()), t_(T.translation()), s_(1) {}

  /// Exp(rho, phi, sigma) = (Exp(phi), V rho, e^sigma) with V the integral of e^(u sigma) Exp(u phi) over u
  /// from 0 to 1.
  static Sim3 exp(const Tangent& xi) {
    using std::exp;
    const Vec3<S> phi = xi.template segment<3>(3);
    const Coefficients c(phi.squaredNorm(), xi[6]);
    const Mat3<S> W = SO3<S>::hat(phi);
    const Vec3<S> rho = xi.template head<3>();
    const Vec3<S> W_rho = W * rho;
    return {SO3<S>::exp(phi), c.a * rho + c.b * W_rho + c.c * (W * W_rho), exp(xi[6])};
  }
  /// The inverse of exp for angles up to pi.
  Tangent log() const {
    using std::log;
    const Vec3<S> phi = R_.log();
    const S sigma = log(s_);
    const S theta2 = phi.squaredNorm();
    const Coefficients c(theta2, sigma);
    // The inverse of a I + b W + c W^2 is of the same form, since W^3 = -theta^2 W.
    const S d = c.a - theta2 * c.c;
    const S det = d * d + theta2 * c.b * c.b;
    const Vec3<S> W_t = SO3<S>::hat(phi) * t_;
    Tangent xi;
    xi.template head<3>() =
        t_ / c.a - (c.b / det) * W_t + ((c.b * c.b - c.c * d) / (c.a * det)) * (SO3<S>::hat(phi) * W_t);
    xi.template segment<3>(3) = phi;
    xi[6] = sigma;
    return xi;
  }

  Sim3 inverse() const {
    const SO3<S> R_inverse = R_.inverse();
    const S s_inverse = S(1) / s_;
    return {R_inverse, -(s_inverse * (R_inverse * t_)), s_inverse};
  }
  Sim3 operator*(const Sim3& other) const {
    return {R_ * other.R_, s_ * (R_ * other.t_) + t_, s_ * other.s_};
  }
  Vec3<S> operator*(const Vec3<S>& p) const { return s_ * (R_ * p) + t_; }

  const SO3<S>& rotation() const { return R_; }
  const Vec3<S>& translation() const { return t_; }
  const S& scale() const { return s_; }
  /// The 4x4 matrix [s R, t; 0, 1].
  Eigen::Matrix<S, 4, 4> matrix() const {
    Eigen::Matrix<S, 4, 4> T = Eigen::Matrix<S, 4, 4>::Identity();
    T.template topLeftCorner<3, 3>() = s_ * R_.matrix();
    T.template topRightCorner<3, 1>() = t_;
    return T;
  }

  /// Ad with T Exp(xi) = Exp(Ad xi) T.
  Mat7<S> adjoint() const {
    const Mat3<S> R = R_.matrix();
    Mat7<S> Ad = Mat7<S>::Zero();
    Ad.template topLeftCorner<3, 3>() = s_ * R;
    Ad.template block<3, 3>(0, 3) = SO3<S>::hat(t_) * R;
    Ad.template block<3, 1>(0, 6) = -t_;
    Ad.template block<3, 3>(3, 3) = R;
    Ad(6, 6) = S(1);
    return Ad;
  }
  /// ad with Ad(Exp(xi)) = exp(ad(xi)).
  static Mat7<S> small_adjoint(const Tangent& xi) {
    const Mat3<S> W = SO3<S>::hat(xi.template segment<3>(3));
    Mat7<S> ad = Mat7<S>::Zero();
    ad.template topLeftCorner<3, 3>() = W + xi[6] * Mat3<S>::Identity();
    ad.template block<3, 3>(0, 3) = SO3<S>::hat(xi.template head<3>());
    ad.template block<3, 1>(0, 6) = -xi.template head<3>();
    ad.template block<3, 3>(3, 3) = W;
    return ad;
  }

  /// J_l with Exp(xi + d) = Exp(J_l d) Exp(xi) to first order: the mean of Ad(Exp(u xi)) over u from 0 to 1,
  /// as the series of ad for a small part of xi, doubled up by J_l(2 xi) = (I + Ad(Exp(xi))) J_l(xi) / 2.
  static Mat7<S> left_jacobian(const Tangent& xi);
  /// The inverse of J_l, for angles below 2 pi.
  static Mat7<S> left_jacobian_inverse(const Tangent& xi) {
    return left_jacobian(xi).partialPivLu().inverse();
  }
  /// J_r with Exp(xi + d) = Exp(xi) Exp(J_r d) to first order.
  static Mat7<S> right_jacobian(const Tangent& xi) { return left_jacobian(-xi); }
  static Mat7<S> right_jacobian_inverse(const Tangent& xi) { return left_jacobian_inverse(-xi); }

  template <class U>
  Sim3<U> cast() const {
    return {R_.template cast<U>(), t_.template cast<U>(), static_cast<U>(s_)};
  }

 private:
  /// V = a I + b W + c W^2. With z = sigma + i theta and E = (e^z - 1) / z: a is E for theta = 0, b = Im E /
  /// theta, c = (a - Re E) / theta^2.
  struct Coefficients {
    S a, b, c;
    Coefficients(const S& theta2, const S& sigma);
  };

  SO3<S> R_;
  Vec3<S> t_;
  S s_;
};

template <class S>
Sim3<S>::Coefficients::Coefficients(const S& theta2, const S& sigma) {
  using std::cos;
  using std::exp;
  using std::sqrt;
  const S z2 = theta2 + sigma * sigma;
  if (z2 < S(1)) {
    // E = sum of z^n / (n + 1)!; p = Re z^n, q = Im z^n / theta and r = (sigma^n - p) / theta^2 are
    // polynomials in sigma and theta^2. Eighteen terms leave 1 / 20!.
    a = S(1);
    b = c = S(0);
    S power(1), p(1), q(0), r(0);
    double inverse_factorial = 1;
    for (int n = 1; n <= 18; ++n) {
      inverse_factorial /= n + 1;
      const S f(inverse_factorial);
      r = sigma * r + q;
      const S p_next = sigma * p - theta2 * q;
      q = sigma * q + p;
      p = p_next;
      power *= sigma;
      a += f * power;
      b += f * q;
      c += f * r;
    }
    return;
  }
  const impl::Stumpff<S> stumpff(theta2);
  const S scale = exp(sigma);
  if (sigma * sigma < S(1)) {
    S sum(0);
    double factorial = 121645100408832000.0;  // 19!
    for (int n = 18; n >= 0; --n) {
      sum = sum * sigma + S(1 / factorial);
      factorial /= n + 1;
    }
    a = sum;
  } else {
    a = (scale - S(1)) / sigma;
  }
  const S cosine = S(1) - theta2 * stumpff.c2;
  b = (scale * (sigma * stumpff.c1 - cosine) + S(1)) / z2;
  c = (scale * (sigma * stumpff.c2 - stumpff.c1) + a) / z2;
}

template <class S>
Mat7<S> Sim3<S>::left_jacobian(const Tangent& xi) {
  Tangent part = xi;
  int halvings = 0;
  while (part.squaredNorm() > S(0.25) && halvings < 64) {
    part *= S(0.5);
    ++halvings;
  }
  // Horner: I + ad/2 (I + ad/3 (I + ...)); sixteen terms of norm below 1 leave 1 / 17!.
  const Mat7<S> ad = small_adjoint(part);
  Mat7<S> J = Mat7<S>::Identity();
  for (int n = 16; n >= 2; --n) J = (Mat7<S>::Identity() + ad * J / S(n)).eval();
  for (int i = 0; i < halvings; ++i) {
    J = (S(0.5) * (J + exp(part).adjoint() * J)).eval();
    part *= S(2);
  }
  return J;
}

/// The similarity a part s of the way from T_a to T_b along the geodesic; s may lie outside [0, 1].
template <class S>
Sim3<S> interpolate(const Sim3<S>& T_a, const Sim3<S>& T_b, const S& s) {
  return T_a * Sim3<S>::exp(s * (T_a.inverse() * T_b).log());
}

using Sim3d = Sim3<double>;
using Sim3f = Sim3<float>;

}  // namespace sweepkit
