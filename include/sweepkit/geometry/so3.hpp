// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

#include "sweepkit/geometry/impl/stumpff.hpp"

namespace sweepkit {

template <class S>
using Vec2 = Eigen::Matrix<S, 2, 1>;
template <class S>
using Vec3 = Eigen::Matrix<S, 3, 1>;
template <class S>
using Mat3 = Eigen::Matrix<S, 3, 3>;
template <class S>
using Vec6 = Eigen::Matrix<S, 6, 1>;
template <class S>
using Mat6 = Eigen::Matrix<S, 6, 6>;

/// Rotations of space, held as a unit quaternion. `S` is float, double or ceres::Jet.
/// Tangent vectors are rotation vectors phi = angle * axis [rad]; R * Exp(phi) perturbs on the right, in the
/// body. Barfoot, State Estimation for Robotics (2017), chapter 7.
template <class S>
class SO3 {
 public:
  using Scalar = S;
  using Tangent = Vec3<S>;

  SO3() : q_(S(1), S(0), S(0), S(0)) {}
  /// @param q any non-zero quaternion; it is normalised
  explicit SO3(const Eigen::Quaternion<S>& q) : q_(q.normalized()) {}
  /// @param R a rotation matrix; small deviations from orthogonality are removed by the normalisation only
  explicit SO3(const Mat3<S>& R) : q_(Eigen::Quaternion<S>(R).normalized()) {}

  /// Exp: rotation vector [rad] to rotation, Barfoot eq. 7.18; series near zero.
  static SO3 exp(const Tangent& phi) {
    using std::cos;
    using std::sin;
    using std::sqrt;
    const S theta2 = phi.squaredNorm();
    S half_sinc, w;
    if (theta2 < S(1e-8)) {
      half_sinc = S(0.5) - theta2 / S(48);
      w = S(1) - theta2 / S(8);
    } else {
      const S theta = sqrt(theta2);
      half_sinc = sin(S(0.5) * theta) / theta;
      w = cos(S(0.5) * theta);
    }
    SO3 R;
    R.q_ = Eigen::Quaternion<S>(w, half_sinc * phi.x(), half_sinc * phi.y(), half_sinc * phi.z());
    return R;
  }

  /// Log: the rotation vector with angle in [0, pi] [rad].
  Tangent log() const {
    using std::atan2;
    using std::sqrt;
    const Vec3<S> v = q_.vec();
    const S n2 = v.squaredNorm();
    const S w = q_.w();
    if (n2 < S(1e-14)) return v * (S(2) / w - S(2) / S(3) * n2 / (w * w * w));
    const S n = sqrt(n2);
    // The half angle in (-pi/2, pi/2]: both signs of q are the same rotation.
    const S half = w < S(0) ? atan2(-n, -w) : atan2(n, w);
    return v * (S(2) * half / n);
  }

  SO3 inverse() const {
    SO3 R;
    R.q_ = q_.conjugate();
    return R;
  }

  SO3 operator*(const SO3& other) const {
    SO3 R;
    R.q_ = q_ * other.q_;
    // One Newton step towards unit norm: exact to rounding, so that long products do not drift.
    R.q_.coeffs() *= (S(3) - R.q_.squaredNorm()) * S(0.5);
    return R;
  }
  Vec3<S> operator*(const Vec3<S>& p) const { return q_ * p; }

  Mat3<S> matrix() const { return q_.toRotationMatrix(); }
  const Eigen::Quaternion<S>& quaternion() const { return q_; }
  /// Angle of the rotation in [0, pi] [rad].
  S angle() const { return log().norm(); }
  /// Ad with R Exp(phi) = Exp(Ad phi) R.
  Mat3<S> adjoint() const { return matrix(); }

  template <class T>
  SO3<T> cast() const {
    return SO3<T>(q_.template cast<T>());
  }

  /// The skew matrix [v]x with [v]x u = v x u.
  static Mat3<S> hat(const Vec3<S>& v) {
    Mat3<S> m;
    m << S(0), -v.z(), v.y(), v.z(), S(0), -v.x(), -v.y(), v.x(), S(0);
    return m;
  }
  static Vec3<S> vee(const Mat3<S>& m) { return {m(2, 1), m(0, 2), m(1, 0)}; }

  /// J_l with Exp(phi + d) = Exp(J_l d) Exp(phi) to first order; Barfoot eq. 7.77.
  static Mat3<S> left_jacobian(const Tangent& phi) {
    const impl::Stumpff<S> c(phi.squaredNorm());
    const Mat3<S> W = hat(phi);
    return Mat3<S>::Identity() + c.c2 * W + c.c3 * (W * W);
  }
  /// The inverse of J_l, for angles below 2 pi; Barfoot eq. 7.76.
  static Mat3<S> left_jacobian_inverse(const Tangent& phi) {
    const impl::Stumpff<S> c(phi.squaredNorm());
    // (1 - theta/2 cot(theta/2)) / theta^2, in terms that do not cancel near zero.
    const S b = (c.c3 - S(2) * c.c4) / (S(2) * c.c2);
    const Mat3<S> W = hat(phi);
    return Mat3<S>::Identity() - S(0.5) * W + b * (W * W);
  }
  /// J_r with Exp(phi + d) = Exp(phi) Exp(J_r d) to first order.
  static Mat3<S> right_jacobian(const Tangent& phi) { return left_jacobian(-phi); }
  static Mat3<S> right_jacobian_inverse(const Tangent& phi) { return left_jacobian_inverse(-phi); }

 private:
  Eigen::Quaternion<S> q_;
};

/// The rotation a part s of the way from R_a to R_b, along the shortest turn; s may lie outside [0, 1].
template <class S>
SO3<S> interpolate(const SO3<S>& R_a, const SO3<S>& R_b, const S& s) {
  return R_a * SO3<S>::exp(s * (R_a.inverse() * R_b).log());
}

using SO3d = SO3<double>;
using SO3f = SO3<float>;

}  // namespace sweepkit
