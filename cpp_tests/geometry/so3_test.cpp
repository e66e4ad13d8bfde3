// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/so3.hpp"

#include <Eigen/LU>
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <vector>

#include "ceres/jet.h"
#include "geometry/jacobian_check.hpp"

using namespace sweepkit;

namespace {

using Jet3 = ceres::Jet<double, 3>;

/// Directions in general and in special position.
template <class S>
std::vector<Vec3<S>> axes() {
  std::vector<Vec3<S>> result = {Vec3<S>::UnitX(),  -Vec3<S>::UnitY(), Vec3<S>::UnitZ(),
                                 Vec3<S>(1, 2, -3), Vec3<S>(-5, 1, 1), Vec3<S>(0, 1, -1)};
  for (auto& axis : result) axis.normalize();
  return result;
}

/// Angles around every change of formula: zero, the thresholds of the series, pi.
std::vector<double> angles() {
  std::vector<double> result = {0, 1e-300, 1e-30, 1e-12, 1e-8, 1e-7, 5e-5, 2e-4, 0.3, 1, 2, 3, 3.14159};
  for (const double threshold : {1e-7, 1e-4, 1e-3, 1.0})
    for (const double factor : {1 - 1e-6, 1 + 1e-6}) result.push_back(threshold * factor);
  return result;
}

/// Exp by summing the matrix series, in long double: the slow reference.
Eigen::Matrix<long double, 3, 3> reference_exp(const Vec3<long double>& phi) {
  using M = Eigen::Matrix<long double, 3, 3>;
  M W;
  W << 0, -phi.z(), phi.y(), phi.z(), 0, -phi.x(), -phi.y(), phi.x(), 0;
  M sum = M::Identity(), term = M::Identity();
  for (int n = 1; n < 80; ++n) {
    term = term * W / static_cast<long double>(n);
    sum += term;
  }
  return sum;
}

/// The left Jacobian by its series sum of W^n / (n + 1)!.
Eigen::Matrix<long double, 3, 3> reference_left_jacobian(const Vec3<long double>& phi) {
  using M = Eigen::Matrix<long double, 3, 3>;
  M W;
  W << 0, -phi.z(), phi.y(), phi.z(), 0, -phi.x(), -phi.y(), phi.x(), 0;
  M sum = M::Identity(), term = M::Identity();
  for (int n = 1; n < 80; ++n) {
    term = term * W / static_cast<long double>(n + 1);
    sum += term;
  }
  return sum;
}

}  // namespace

TEMPLATE_TEST_CASE("SO3 exp equals the matrix series and log undoes it", "[so3]", float, double) {
  using S = TestType;
  const S eps = std::numeric_limits<S>::epsilon();
  for (const Vec3<S>& axis : axes<S>()) {
    for (const double angle : angles()) {
      const Vec3<S> phi = axis * static_cast<S>(angle);
      const SO3<S> R = SO3<S>::exp(phi);
      INFO("angle " << angle << " axis " << axis.transpose());
      CHECK((R.matrix() - reference_exp(phi.template cast<long double>()).template cast<S>())
                .cwiseAbs()
                .maxCoeff() <= 8 * eps);
      CHECK(std::abs(R.quaternion().norm() - 1) <= 4 * eps);
      // Relative to the angle: small rotations keep all their digits.
      CHECK((R.log() - phi).norm() <= 8 * eps * phi.norm());
      CHECK((R.inverse().log() + phi).norm() <= 8 * eps * phi.norm());
    }
  }
}

TEMPLATE_TEST_CASE("SO3 log at pi and beyond gives the shorter turn", "[so3]", float, double) {
  using S = TestType;
  const S eps = std::numeric_limits<S>::epsilon();
  const S pi = static_cast<S>(M_PI);
  for (const Vec3<S>& axis : axes<S>()) {
    // Exactly a half turn: both vectors of length pi are right.
    for (const S w : {S(0), -S(0)}) {
      const SO3<S> half_turn(Eigen::Quaternion<S>(w, axis.x(), axis.y(), axis.z()));
      const Vec3<S> phi = half_turn.log();
      CHECK(std::abs(phi.norm() - pi) <= 4 * eps);
      CHECK(phi.cross(axis).norm() <= 8 * eps);
      CHECK((SO3<S>::exp(phi).matrix() - half_turn.matrix()).cwiseAbs().maxCoeff() <= 8 * eps);
    }
    for (const S beyond : {S(1e-6), S(1e-3), S(0.5), S(3)}) {
      const Vec3<S> phi = SO3<S>::exp(axis * (pi + beyond)).log();
      CHECK(phi.norm() <= pi * (1 + eps));
      CHECK((phi + axis * (pi - beyond)).norm() <= 20 * eps);
    }
    // A whole turn is none; the sign of the quaternion means nothing.
    CHECK(SO3<S>::exp(axis * (2 * pi)).log().norm() <= 8 * eps);
    const SO3<S> R = SO3<S>::exp(axis);
    Eigen::Quaternion<S> minus = R.quaternion();
    minus.coeffs() *= S(-1);
    CHECK((SO3<S>(minus).log() - R.log()).norm() <= 4 * eps);
    CHECK(std::abs(R.angle() - 1) <= 4 * eps);
  }
}

TEMPLATE_TEST_CASE("SO3 is a group that acts on points", "[so3]", float, double) {
  using S = TestType;
  const S tolerance = 16 * std::numeric_limits<S>::epsilon();
  const auto close = [&](const SO3<S>& a, const SO3<S>& b) {
    return (a.matrix() - b.matrix()).cwiseAbs().maxCoeff() <= tolerance;
  };
  const Vec3<S> p(S(0.3), -2, 5);
  const SO3<S> identity;
  const auto directions = axes<S>();
  for (std::size_t i = 0; i + 2 < directions.size(); ++i) {
    const SO3<S> a = SO3<S>::exp(directions[i] * S(2.9)), b = SO3<S>::exp(directions[i + 1] * S(-0.7)),
                 c = SO3<S>::exp(directions[i + 2] * S(1.3));
    CHECK(close((a * b) * c, a * (b * c)));
    CHECK(close(a * identity, a));
    CHECK(close(a * a.inverse(), identity));
    CHECK(close((a * b).inverse(), b.inverse() * a.inverse()));
    CHECK(((a * b) * p - a * (b * p)).norm() <= tolerance * p.norm());
    CHECK((a.inverse() * (a * p) - p).norm() <= tolerance * p.norm());
    CHECK((a.matrix() * p - a * p).norm() <= tolerance * p.norm());
    CHECK(std::abs(a.matrix().determinant() - 1) <= tolerance);
    CHECK(close(SO3<S>(a.matrix()), a));
    // R Exp(phi) = Exp(Ad phi) R
    const Vec3<S> phi(S(0.2), S(-0.5), S(0.1));
    CHECK(close(a * SO3<S>::exp(phi), SO3<S>::exp(a.adjoint() * phi) * a));
    CHECK(close(interpolate(a, b, S(0)), a));
    CHECK(close(interpolate(a, b, S(1)), b));
    const SO3<S> third = interpolate(a, b, S(1) / 3);
    CHECK(close(third * (a.inverse() * third) * (a.inverse() * third), b));
  }
  CHECK((SO3<S>::vee(SO3<S>::hat(p)) - p).norm() == 0);
  CHECK((SO3<S>::hat(p) * Vec3<S>(1, 2, 3) - p.cross(Vec3<S>(1, 2, 3))).norm() <= tolerance * 20);
}

TEST_CASE("SO3 products do not lose their norm", "[so3]") {
  SO3f R;
  const SO3f step = SO3f::exp(Vec3<float>(0.01f, -0.02f, 0.005f));
  for (int i = 0; i < 100000; ++i) R = R * step;
  CHECK(std::abs(R.quaternion().norm() - 1) < 1e-6f);
}

TEMPLATE_TEST_CASE("SO3 Jacobians keep full precision at every angle", "[so3]", float, double) {
  using S = TestType;
  const S eps = std::numeric_limits<S>::epsilon();
  for (const Vec3<S>& axis : axes<S>()) {
    for (const double angle : angles()) {
      const Vec3<S> phi = axis * static_cast<S>(angle);
      INFO("angle " << angle << " axis " << axis.transpose());
      const Mat3<S> reference = reference_left_jacobian(phi.template cast<long double>()).template cast<S>();
      CHECK((SO3<S>::left_jacobian(phi) - reference).cwiseAbs().maxCoeff() <= 8 * eps);
      CHECK((SO3<S>::right_jacobian(phi) - reference.transpose()).cwiseAbs().maxCoeff() <= 8 * eps);
      CHECK((SO3<S>::left_jacobian_inverse(phi) * reference - Mat3<S>::Identity()).cwiseAbs().maxCoeff() <=
            16 * eps);
      CHECK((SO3<S>::right_jacobian_inverse(phi) * reference.transpose() - Mat3<S>::Identity())
                .cwiseAbs()
                .maxCoeff() <= 16 * eps);
      // J_l = R J_r
      CHECK((SO3<S>::left_jacobian(phi) - SO3<S>::exp(phi).matrix() * SO3<S>::right_jacobian(phi))
                .cwiseAbs()
                .maxCoeff() <= 16 * eps);
    }
  }
}

TEST_CASE("SO3 Jacobians agree with central differences", "[so3]") {
  for (const Vec3<double>& axis : axes<double>()) {
    for (const double angle : {0.0, 1e-4, 0.5, 1.0, 2.5, 3.1}) {
      const Vec3<double> phi = axis * angle;
      const SO3d R = SO3d::exp(phi);
      test::check_jacobian(
          [&](const Vec3<double>& x) -> Vec3<double> { return (SO3d::exp(x) * R.inverse()).log(); }, phi,
          SO3d::left_jacobian(phi));
      test::check_jacobian(
          [&](const Vec3<double>& x) -> Vec3<double> { return (R.inverse() * SO3d::exp(x)).log(); }, phi,
          SO3d::right_jacobian(phi));
      if (angle > 3) continue;  // log jumps at pi
      const Vec3<double> zero = Vec3<double>::Zero();
      test::check_jacobian([&](const Vec3<double>& d) -> Vec3<double> { return (SO3d::exp(d) * R).log(); },
                           zero, SO3d::left_jacobian_inverse(phi), 1e-8);
      test::check_jacobian([&](const Vec3<double>& d) -> Vec3<double> { return (R * SO3d::exp(d)).log(); },
                           zero, SO3d::right_jacobian_inverse(phi), 1e-8);
    }
  }
}

TEST_CASE("SO3 derivatives by ceres::Jet are right everywhere, also at zero and at pi", "[so3]") {
  for (const Vec3<double>& axis : axes<double>()) {
    for (const double angle : {0.0, 1e-200, 1e-9, 0.99e-4, 1.01e-4, 0.1, 1.0, 3.0, M_PI, 3.5}) {
      const Vec3<double> phi = axis * angle;
      Vec3<Jet3> phi_jet;
      for (int i = 0; i < 3; ++i) phi_jet[i] = Jet3(phi[i], i);
      const SO3<Jet3> R_jet = SO3<Jet3>::exp(phi_jet);
      INFO("angle " << angle << " axis " << axis.transpose());

      // d (R p) / d phi = -[R p]x J_l
      const Vec3<double> p(1, -2, 0.5);
      const Vec3<Jet3> moved = R_jet * Vec3<Jet3>(p.cast<Jet3>());
      const Vec3<double> Rp = SO3d::exp(phi) * p;
      const Mat3<double> expected = -SO3d::hat(Rp) * SO3d::left_jacobian(phi);
      for (int i = 0; i < 3; ++i) {
        CHECK(std::abs(moved[i].a - Rp[i]) < 1e-14);
        CHECK((moved[i].v.transpose() - expected.row(i)).norm() < 1e-12);
      }
      // log(Exp(phi)) = phi has the derivative I, up to pi; beyond it the other turn's.
      const Vec3<Jet3> back = R_jet.log();
      for (int i = 0; i < 3; ++i) {
        CHECK(back[i].v.allFinite());
        if (angle < M_PI) CHECK((back[i].v - Vec3<double>::Unit(i)).norm() < 1e-12);
      }
      // The Jacobians carry derivatives too.
      const Mat3<Jet3> J = SO3<Jet3>::left_jacobian(phi_jet) * SO3<Jet3>::left_jacobian_inverse(phi_jet);
      for (int i = 0; i < 9; ++i) {
        CHECK(std::abs(J(i / 3, i % 3).a - (i % 4 == 0)) < 1e-13);
        CHECK(J(i / 3, i % 3).v.norm() < 1e-12);
      }
    }
  }
}
