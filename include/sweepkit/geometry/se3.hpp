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
    xi << SO3<S>::left_jacobian_inverse(phi) * t_, phi;
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

  template <class U>
  SE3<U> cast() const {
    return {R_.template cast<U>(), t_.template cast<U>()};
  }

 private:
  SO3<S> R_;
  Vec3<S> t_;
};

using SE3d = SE3<double>;
using SE3f = SE3<float>;

}  // namespace sweepkit
