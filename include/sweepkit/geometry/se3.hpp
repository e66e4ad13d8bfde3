// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "sweepkit/geometry/so3.hpp"

namespace sweepkit {

/// Rigid motions of space: T p = R p + t. T_a_b takes points in b to a.
/// Tangent vectors are (rho, phi), translation first [m, rad]; T * Exp(xi) perturbs on the right, in the
/// body. Barfoot, State Estimation for Robotics (2017), chapter 7.
template <class S>
class SE3 {
 public:
  using Scalar = S;
  using Tangent = Vec6<S>;

  SE3() : t_(Vec3<S>::Zero()) {}
  SE3(const SO3<S>& R, const Vec3<S>& t) : R_(R), t_(t) {}
  /// @param T a 4x4 matrix with the last row 0 0 0 1
  explicit SE3(const Eigen::Matrix<S, 4, 4>& T)
      : R_(Mat3<S>(T.template topLeftCorner<3, 3>())), t_(T.template topRightCorner<3, 1>()) {}

  /// Exp(rho, phi) = (Exp(phi), J_l(phi) rho): the motion of a constant twist; Barfoot eq. 7.31.
  static SE3 exp(const Tangent& xi) {
    const Vec3<S> phi = xi.template tail<3>();
    return {SO3<S>::exp(phi), SO3<S>::left_jacobian(phi) * xi.template head<3>()};
  }
  Tangent log() const {
    const Vec3<S> phi = R_.log();
    Tangent xi;
    xi.template head<3>() = SO3<S>::left_jacobian_inverse(phi) * t_;
    xi.template tail<3>() = phi;
    return xi;
  }

  SE3 inverse() const {
    const SO3<S> R_inverse = R_.inverse();
    return {R_inverse, -(R_inverse * t_)};
  }
  SE3 operator*(const SE3& other) const { return {R_ * other.R_, R_ * other.t_ + t_}; }
  Vec3<S> operator*(const Vec3<S>& p) const { return R_ * p + t_; }

  const SO3<S>& rotation() const { return R_; }
  const Vec3<S>& translation() const { return t_; }
  Eigen::Matrix<S, 4, 4> matrix() const {
    Eigen::Matrix<S, 4, 4> T = Eigen::Matrix<S, 4, 4>::Identity();
    T.template topLeftCorner<3, 3>() = R_.matrix();
    T.template topRightCorner<3, 1>() = t_;
    return T;
  }
  /// Ad with T Exp(xi) = Exp(Ad xi) T; Barfoot eq. 7.45 with translation first.
  Mat6<S> adjoint() const {
    const Mat3<S> R = R_.matrix();
    Mat6<S> Ad = Mat6<S>::Zero();
    Ad.template topLeftCorner<3, 3>() = R;
    Ad.template bottomRightCorner<3, 3>() = R;
    Ad.template topRightCorner<3, 3>() = SO3<S>::hat(t_) * R;
    return Ad;
  }

  /// J_l with Exp(xi + d) = Exp(J_l d) Exp(xi) to first order: [J Q; 0 J], Barfoot eq. 7.85 and 7.86.
  static Mat6<S> left_jacobian(const Tangent& xi) {
    const Mat3<S> J = SO3<S>::left_jacobian(xi.template tail<3>());
    Mat6<S> J_l = Mat6<S>::Zero();
    J_l.template topLeftCorner<3, 3>() = J;
    J_l.template bottomRightCorner<3, 3>() = J;
    J_l.template topRightCorner<3, 3>() = left_jacobian_coupling(xi);
    return J_l;
  }
  /// The inverse of J_l, for angles below 2 pi; Barfoot eq. 7.95.
  static Mat6<S> left_jacobian_inverse(const Tangent& xi) {
    const Mat3<S> J_inverse = SO3<S>::left_jacobian_inverse(xi.template tail<3>());
    Mat6<S> J_l = Mat6<S>::Zero();
    J_l.template topLeftCorner<3, 3>() = J_inverse;
    J_l.template bottomRightCorner<3, 3>() = J_inverse;
    J_l.template topRightCorner<3, 3>() = -(J_inverse * left_jacobian_coupling(xi) * J_inverse);
    return J_l;
  }
  /// J_r with Exp(xi + d) = Exp(xi) Exp(J_r d) to first order.
  static Mat6<S> right_jacobian(const Tangent& xi) { return left_jacobian(-xi); }
  static Mat6<S> right_jacobian_inverse(const Tangent& xi) { return left_jacobian_inverse(-xi); }

  template <class U>
  SE3<U> cast() const {
    return {R_.template cast<U>(), t_.template cast<U>()};
  }

 private:
  /// Q of Barfoot eq. 7.86b.
  static Mat3<S> left_jacobian_coupling(const Tangent& xi) {
    const Mat3<S> P = SO3<S>::hat(xi.template head<3>());
    const Vec3<S> phi = xi.template tail<3>();
    const Mat3<S> W = SO3<S>::hat(phi);
    const impl::Stumpff<S> c(phi.squaredNorm());
    const Mat3<S> WP = W * P, PW = P * W, WPW = WP * W;
    return S(0.5) * P + c.c3 * (WP + PW + WPW) + c.c4 * (W * WP + PW * W - S(3) * WPW) +
           S(0.5) * (c.c4 - S(3) * c.c5) * (WPW * W + W * WPW);
  }

  SO3<S> R_;
  Vec3<S> t_;
};

/// The motion a part s of the way from T_a to T_b along the geodesic, a screw of constant twist; s may lie
/// outside [0, 1].
template <class S>
SE3<S> interpolate(const SE3<S>& T_a, const SE3<S>& T_b, const S& s) {
  return T_a * SE3<S>::exp(s * (T_a.inverse() * T_b).log());
}

using SE3d = SE3<double>;
using SE3f = SE3<float>;

}  // namespace sweepkit
