// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/sim3.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <vector>

#include "ceres/jet.h"
#include "geometry/jacobian_check.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

using Jet7 = ceres::Jet<double, 7>;

/// Tangent vectors around the changes of formula in angle and scale, each small and large.
std::vector<Vec7<double>> tangents() {
  std::vector<Vec7<double>> result;
  Random random(11);
  for (const double angle : {0.0, 1e-9, 1e-4, 0.5, 0.99, 1.01, 3.0}) {
    for (const double sigma : {0.0, 1e-300, 1e-9, -1e-4, 0.1, -0.999, 1.001, 2.0, -3.0}) {
      Vec3<double> axis, rho;
      for (int i = 0; i < 3; ++i) {
        axis[i] = random.normal();
        rho[i] = random.normal();
      }
      Vec7<double> xi;
      xi << 2 * rho, angle * axis.normalized(), sigma;
      result.push_back(xi);
    }
  }
  return result;
}

/// Exp by the matrix series of the 4x4 generator.
Eigen::Matrix<long double, 4, 4> reference_exp(const Vec7<long double>& xi) {
  using M = Eigen::Matrix<long double, 4, 4>;
  M X = M::Zero();
  X.topLeftCorner<3, 3>() = SO3<long double>::hat(xi.segment<3>(3)) + xi[6] * Mat3<long double>::Identity();
  X.topRightCorner<3, 1>() = xi.head<3>();
  M sum = M::Identity(), term = M::Identity();
  for (int n = 1; n < 100; ++n) {
    term = term * X / static_cast<long double>(n);
    sum += term;
  }
  return sum;
}

Mat7<long double> reference_left_jacobian(const Vec7<long double>& xi) {
  using M = Mat7<long double>;
  const M ad = Sim3<long double>::small_adjoint(xi);
  M sum = M::Identity(), term = M::Identity();
  for (int n = 1; n < 100; ++n) {
    term = term * ad / static_cast<long double>(n + 1);
    sum += term;
  }
  return sum;
}

}  // namespace

TEMPLATE_TEST_CASE("Sim3 exp equals the matrix series and log undoes it", "[sim3]", float, double) {
  using S = TestType;
  const S eps = std::numeric_limits<S>::epsilon();
  for (const Vec7<double>& tangent : tangents()) {
    const Vec7<S> xi = tangent.cast<S>();
    const Sim3<S> T = Sim3<S>::exp(xi);
    INFO("tangent " << xi.transpose());
    const S size = (1 + xi.norm()) * std::max(S(1), T.scale());
    CHECK((T.matrix() - reference_exp(xi.template cast<long double>()).template cast<S>())
              .cwiseAbs()
              .maxCoeff() <= 16 * eps * size);
    CHECK((T.log() - xi).norm() <= 64 * eps * (1 + xi.norm()));
  }
}

TEMPLATE_TEST_CASE("Sim3 is a group that acts on points", "[sim3]", float, double) {
  using S = TestType;
  const S tolerance = 200 * std::numeric_limits<S>::epsilon();
  const auto close = [&](const Sim3<S>& a, const Sim3<S>& b) {
    return (a.matrix() - b.matrix()).cwiseAbs().maxCoeff() <= tolerance * (1 + a.matrix().norm());
  };
  const Vec3<S> p(S(0.3), -2, 5);
  Vec7<S> xi_a, xi_b, xi_c, d;
  xi_a << 1, -2, 3, S(0.4), S(-2.5), S(0.7), S(0.6);
  xi_b << -4, S(0.1), 2, S(1.4), S(0.2), S(-0.3), S(-1.2);
  xi_c << 2, 2, S(-0.5), S(0.01), S(0.02), S(2.2), S(0.01);
  d << S(0.1), S(-0.2), S(0.3), S(0.05), S(0.02), S(-0.4), S(0.2);
  const Sim3<S> a = Sim3<S>::exp(xi_a), b = Sim3<S>::exp(xi_b), c = Sim3<S>::exp(xi_c), identity;
  CHECK(close((a * b) * c, a * (b * c)));
  CHECK(close(identity * a, a));
  CHECK(close(a * identity, a));
  CHECK(close(a * a.inverse(), identity));
  CHECK(close((a * b).inverse(), b.inverse() * a.inverse()));
  CHECK(((a * b) * p - a * (b * p)).norm() <= tolerance * 10);
  CHECK((a.inverse() * (a * p) - p).norm() <= tolerance * 10);
  CHECK(((a.matrix() * p.homogeneous()).template head<3>() - a * p).norm() <= tolerance * 10);
  CHECK(close(a * Sim3<S>::exp(d), Sim3<S>::exp(a.adjoint() * d) * a));
  CHECK(((a * b).adjoint() - a.adjoint() * b.adjoint()).cwiseAbs().maxCoeff() <= tolerance * 10);
  CHECK(close(interpolate(a, b, S(0)), a));
  CHECK(close(interpolate(a, b, S(1)), b));
  const Sim3<S> step = a.inverse() * interpolate(a, b, S(0.25));
  CHECK(close(a * step * step * step * step, b));
  // With the scale 1 it is SE(3).
  const SE3<S> T = SE3<S>::exp(xi_a.template head<6>());
  Vec7<S> rigid = xi_a;
  rigid[6] = 0;
  CHECK(close(Sim3<S>::exp(rigid), Sim3<S>(T)));
  CHECK((Sim3<S>(T).log().template head<6>() - T.log()).norm() <= tolerance);
}

TEST_CASE("Sim3 refuses a scale that is not positive", "[sim3]") {
  CHECK_THROWS_AS(Sim3d(SO3d(), Vec3<double>::Zero(), 0.0), Error);
  CHECK_THROWS_AS(Sim3d(SO3d(), Vec3<double>::Zero(), -1.0), Error);
  CHECK_THROWS_AS(Sim3d(SO3d(), Vec3<double>::Zero(), std::nan("")), Error);
}

TEST_CASE("Sim3 Jacobians equal their series and agree with central differences", "[sim3]") {
  const double eps = std::numeric_limits<double>::epsilon();
  for (const Vec7<double>& xi : tangents()) {
    INFO("tangent " << xi.transpose());
    const Mat7<double> J = Sim3d::left_jacobian(xi);
    const double size = J.cwiseAbs().maxCoeff();
    const Mat7<double> reference = reference_left_jacobian(xi.cast<long double>()).cast<double>();
    CHECK((J - reference).cwiseAbs().maxCoeff() <= 64 * eps * size);
    const Mat7<double> right = Sim3d::right_jacobian(xi);
    CHECK((J - Sim3d::exp(xi).adjoint() * right).cwiseAbs().maxCoeff() <= 64 * eps * size * right.norm());
    const Sim3d T = Sim3d::exp(xi), T_inverse = T.inverse();
    test::check_jacobian(
        [&](const Vec7<double>& x) -> Vec7<double> { return (Sim3d::exp(x) * T_inverse).log(); }, xi, J,
        1e-8);
    test::check_jacobian(
        [&](const Vec7<double>& x) -> Vec7<double> { return (T_inverse * Sim3d::exp(x)).log(); }, xi, right,
        1e-8);
    const Vec7<double> zero = Vec7<double>::Zero();
    test::check_jacobian([&](const Vec7<double>& d) -> Vec7<double> { return (T * Sim3d::exp(d)).log(); },
                         zero, Sim3d::right_jacobian_inverse(xi), 1e-8);
    test::check_jacobian([&](const Vec7<double>& d) -> Vec7<double> { return (Sim3d::exp(d) * T).log(); },
                         zero, Sim3d::left_jacobian_inverse(xi), 1e-8);
  }
}

TEST_CASE("Sim3 derivatives by ceres::Jet are right everywhere, also at the identity", "[sim3]") {
  for (const Vec7<double>& xi : tangents()) {
    Vec7<Jet7> xi_jet;
    for (int i = 0; i < 7; ++i) xi_jet[i] = Jet7(xi[i], i);
    const Sim3<Jet7> T_jet = Sim3<Jet7>::exp(xi_jet);
    const Sim3d T = Sim3d::exp(xi);
    INFO("tangent " << xi.transpose());
    const double size = T.matrix().norm() * (1 + xi.norm());
    const Vec3<double> p(1, -2, 0.5);
    const Vec3<Jet7> moved = T_jet * Vec3<Jet7>(p.cast<Jet7>());
    Eigen::Matrix<double, 3, 7> by_tangent;
    by_tangent << Mat3<double>::Identity(), -SO3d::hat(T * p), T * p;
    const Eigen::Matrix<double, 3, 7> expected = by_tangent * Sim3d::left_jacobian(xi);
    for (int i = 0; i < 3; ++i) CHECK((moved[i].v.transpose() - expected.row(i)).norm() < 1e-12 * size);
    const Vec7<Jet7> back = T_jet.log();
    for (int i = 0; i < 7; ++i) CHECK((back[i].v - Vec7<double>::Unit(i)).norm() < 1e-11 * (1 + size));
  }
}
