// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/se3.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <vector>

#include "ceres/jet.h"
#include "geometry/jacobian_check.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

using Jet6 = ceres::Jet<double, 6>;

/// Twists of all kinds: zero, pure translation, pure rotation, around the changes of formula, near pi.
std::vector<Vec6<double>> twists() {
  std::vector<Vec6<double>> result;
  Random random(7);
  for (const double angle :
       {0.0, 1e-200, 1e-9, 1e-7, 1e-4, 1e-3, 0.3, 0.9999999, 1.0000001, 2.0, 3.0, 3.1415}) {
    for (const double size : {0.0, 1e-6, 1.0, 50.0}) {
      Vec3<double> axis, rho;
      for (int i = 0; i < 3; ++i) {
        axis[i] = random.normal();
        rho[i] = random.normal();
      }
      Vec6<double> xi;
      xi << size * rho.normalized(), angle * axis.normalized();
      result.push_back(xi);
    }
  }
  return result;
}

using Mat6l = Eigen::Matrix<long double, 6, 6>;

/// ad of a twist: the left Jacobian is the sum of ad^n / (n + 1)!, Barfoot eq. 7.84.
Mat6l small_adjoint(const Vec6<long double>& xi) {
  Mat6l ad = Mat6l::Zero();
  ad.topLeftCorner<3, 3>() = SO3<long double>::hat(xi.tail<3>());
  ad.bottomRightCorner<3, 3>() = SO3<long double>::hat(xi.tail<3>());
  ad.topRightCorner<3, 3>() = SO3<long double>::hat(xi.head<3>());
  return ad;
}

Mat6l reference_left_jacobian(const Vec6<long double>& xi) {
  const Mat6l ad = small_adjoint(xi);
  Mat6l sum = Mat6l::Identity(), term = Mat6l::Identity();
  for (int n = 1; n < 80; ++n) {
    term = term * ad / static_cast<long double>(n + 1);
    sum += term;
  }
  return sum;
}

/// Exp by the matrix series of the 4x4 generator.
Eigen::Matrix<long double, 4, 4> reference_exp(const Vec6<long double>& xi) {
  using M = Eigen::Matrix<long double, 4, 4>;
  M X = M::Zero();
  X.topLeftCorner<3, 3>() = SO3<long double>::hat(xi.tail<3>());
  X.topRightCorner<3, 1>() = xi.head<3>();
  M sum = M::Identity(), term = M::Identity();
  for (int n = 1; n < 80; ++n) {
    term = term * X / static_cast<long double>(n);
    sum += term;
  }
  return sum;
}

}  // namespace

TEMPLATE_TEST_CASE("SE3 exp equals the matrix series and log undoes it", "[se3]", float, double) {
  using S = TestType;
  const S eps = std::numeric_limits<S>::epsilon();
  for (const Vec6<double>& twist : twists()) {
    const Vec6<S> xi = twist.cast<S>();
    const SE3<S> T = SE3<S>::exp(xi);
    INFO("twist " << xi.transpose());
    const S size = 1 + xi.norm();
    CHECK((T.matrix() - reference_exp(xi.template cast<long double>()).template cast<S>())
              .cwiseAbs()
              .maxCoeff() <= 8 * eps * size);
    const Vec6<S> back = T.log();
    CHECK((back.template tail<3>() - xi.template tail<3>()).norm() <= 8 * eps * xi.template tail<3>().norm());
    CHECK((back.template head<3>() - xi.template head<3>()).norm() <=
          32 * eps * xi.template head<3>().norm());
  }
}

TEMPLATE_TEST_CASE("SE3 is a group that acts on points", "[se3]", float, double) {
  using S = TestType;
  const S tolerance = 40 * std::numeric_limits<S>::epsilon();
  const auto close = [&](const SE3<S>& a, const SE3<S>& b) {
    return (a.matrix() - b.matrix()).cwiseAbs().maxCoeff() <= tolerance * (1 + a.translation().norm());
  };
  const Vec3<S> p(S(0.3), -2, 5);
  Vec6<S> xi_a, xi_b, xi_c, d;
  xi_a << 1, -2, 3, S(0.4), S(-2.5), S(0.7);
  xi_b << -4, S(0.1), 2, S(1.4), S(0.2), S(-0.3);
  xi_c << 2, 2, S(-0.5), S(0.01), S(0.02), S(2.2);
  d << S(0.1), S(-0.2), S(0.3), S(0.05), S(0.02), S(-0.4);
  const SE3<S> a = SE3<S>::exp(xi_a), b = SE3<S>::exp(xi_b), c = SE3<S>::exp(xi_c), identity;
  CHECK(close((a * b) * c, a * (b * c)));
  CHECK(close(identity * a, a));
  CHECK(close(a * identity, a));
  CHECK(close(a * a.inverse(), identity));
  CHECK(close((a * b).inverse(), b.inverse() * a.inverse()));
  CHECK(((a * b) * p - a * (b * p)).norm() <= tolerance * 10);
  CHECK((a.inverse() * (a * p) - p).norm() <= tolerance * 10);
  CHECK(((a.matrix() * p.homogeneous()).template head<3>() - a * p).norm() <= tolerance * 10);
  CHECK(close(SE3<S>(a.matrix()), a));
  CHECK((a.matrix() * a.inverse().matrix() - Eigen::Matrix<S, 4, 4>::Identity()).cwiseAbs().maxCoeff() <=
        tolerance);
  // T Exp(xi) = Exp(Ad xi) T, and Ad is a homomorphism.
  CHECK(close(a * SE3<S>::exp(d), SE3<S>::exp(a.adjoint() * d) * a));
  CHECK(((a * b).adjoint() - a.adjoint() * b.adjoint()).cwiseAbs().maxCoeff() <= tolerance * 10);
  CHECK(close(interpolate(a, b, S(0)), a));
  CHECK(close(interpolate(a, b, S(1)), b));
  const SE3<S> step = a.inverse() * interpolate(a, b, S(0.25));
  CHECK(close(a * step * step * step * step, b));
}

TEMPLATE_TEST_CASE("SE3 Jacobians keep full precision for every twist", "[se3]", float, double) {
  using S = TestType;
  const S eps = std::numeric_limits<S>::epsilon();
  for (const Vec6<double>& twist : twists()) {
    const Vec6<S> xi = twist.cast<S>();
    INFO("twist " << xi.transpose());
    const Mat6<S> reference = reference_left_jacobian(xi.template cast<long double>()).template cast<S>();
    const S size = 1 + xi.norm();
    CHECK((SE3<S>::left_jacobian(xi) - reference).cwiseAbs().maxCoeff() <= 16 * eps * size);
    CHECK((SE3<S>::left_jacobian_inverse(xi) * reference - Mat6<S>::Identity()).cwiseAbs().maxCoeff() <=
          64 * eps * size);
    const Mat6<S> right = SE3<S>::right_jacobian(xi);
    CHECK((SE3<S>::right_jacobian_inverse(xi) * right - Mat6<S>::Identity()).cwiseAbs().maxCoeff() <=
          64 * eps * size);
    // J_l = Ad(Exp(xi)) J_r
    CHECK((reference - SE3<S>::exp(xi).adjoint() * right).cwiseAbs().maxCoeff() <= 64 * eps * size);
  }
}

TEST_CASE("SE3 Jacobians agree with central differences", "[se3]") {
  for (const Vec6<double>& xi : twists()) {
    const SE3d T = SE3d::exp(xi);
    test::check_jacobian(
        [&](const Vec6<double>& x) -> Vec6<double> { return (SE3d::exp(x) * T.inverse()).log(); }, xi,
        SE3d::left_jacobian(xi), 1e-8);
    test::check_jacobian(
        [&](const Vec6<double>& x) -> Vec6<double> { return (T.inverse() * SE3d::exp(x)).log(); }, xi,
        SE3d::right_jacobian(xi), 1e-8);
    if (xi.tail<3>().norm() > 3.1) continue;  // log jumps at pi
    const Vec6<double> zero = Vec6<double>::Zero();
    test::check_jacobian([&](const Vec6<double>& d) -> Vec6<double> { return (T * SE3d::exp(d)).log(); },
                         zero, SE3d::right_jacobian_inverse(xi), 1e-8);
    test::check_jacobian([&](const Vec6<double>& d) -> Vec6<double> { return (SE3d::exp(d) * T).log(); },
                         zero, SE3d::left_jacobian_inverse(xi), 1e-8);
  }
}

TEST_CASE("SE3 derivatives by ceres::Jet are right everywhere, also at the identity", "[se3]") {
  for (const Vec6<double>& xi : twists()) {
    Vec6<Jet6> xi_jet;
    for (int i = 0; i < 6; ++i) xi_jet[i] = Jet6(xi[i], i);
    const SE3<Jet6> T_jet = SE3<Jet6>::exp(xi_jet);
    const SE3d T = SE3d::exp(xi);
    INFO("twist " << xi.transpose());
    const double size = 1 + xi.norm();
    // d (T p) = d rho' + d phi' x T p with (rho', phi') = J_l d
    const Vec3<double> p(1, -2, 0.5);
    const Vec3<Jet6> moved = T_jet * Vec3<Jet6>(p.cast<Jet6>());
    Eigen::Matrix<double, 3, 6> by_twist;
    by_twist << Mat3<double>::Identity(), -SO3d::hat(T * p);
    const Eigen::Matrix<double, 3, 6> expected = by_twist * SE3d::left_jacobian(xi);
    for (int i = 0; i < 3; ++i) CHECK((moved[i].v.transpose() - expected.row(i)).norm() < 1e-12 * size);
    const Vec6<Jet6> back = T_jet.log();
    for (int i = 0; i < 6; ++i) CHECK((back[i].v - Vec6<double>::Unit(i)).norm() < 1e-11 * size);
  }
}
