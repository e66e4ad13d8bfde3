// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/solve/motion_error.hpp"

#include <catch2/catch.hpp>

#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

Vec6<double> draw(Random& random, double rho, double phi) {
  Vec6<double> xi;
  for (int i = 0; i < 6; ++i) xi[i] = random.normal(0.0, i < 3 ? rho : phi);
  return xi;
}

// Central differences of a function of a perturbation.
template <class Function>
Mat6<double> differences(const Function& function) {
  Mat6<double> J;
  constexpr double kStep = 1e-6;
  for (int i = 0; i < 6; ++i) {
    const Vec6<double> step = kStep * Vec6<double>::Unit(i);
    J.col(i) = (function(step) - function(-step)) / (2.0 * kStep);
  }
  return J;
}

}  // namespace

TEST_CASE("the inverse left Jacobian of SE(3) is the derivative of the logarithm", "[solve]") {
  Random random(1);
  for (const double size : {0.0, 1e-4, 0.01, 0.03, 0.04, 0.5, 1.2})
    for (int k = 0; k < 20; ++k) {
      const Vec6<double> xi = draw(random, 2.0, size);
      const SE3d T = SE3d::exp(xi);
      const Vec6<double> at = T.log();
      const Mat6<double> expected =
          differences([&](const Vec6<double>& d) { return Vec6<double>((SE3d::exp(d) * T).log()); });
      REQUIRE((motion_left_jacobian_inverse(at) - expected).cwiseAbs().maxCoeff() < 1e-8 * (1.0 + at.norm()));
    }
}

TEST_CASE("the inverse left Jacobian is continuous where the series ends", "[solve]") {
  Random random(2);
  for (int k = 0; k < 50; ++k) {
    Vec6<double> xi = draw(random, 1.0, 1.0);
    xi.tail<3>() *= std::sqrt(1e-3) / xi.tail<3>().norm();
    Vec6<double> below = xi, above = xi;
    below.tail<3>() *= 1.0 - 1e-9;
    above.tail<3>() *= 1.0 + 1e-9;
    REQUIRE((motion_left_jacobian_inverse(below) - motion_left_jacobian_inverse(above)).norm() < 1e-8);
  }
}

TEST_CASE("errors of poses and of motions are zero at the truth and have exact Jacobians", "[solve]") {
  Random random(3);
  for (int k = 0; k < 50; ++k) {
    const SE3d T_a_w = SE3d::exp(draw(random, 5.0, 1.0)), T_b_w = SE3d::exp(draw(random, 5.0, 1.0));
    const SE3d T_a_b = T_a_w * T_b_w.inverse();
    REQUIRE(pose_error(T_a_w, T_a_w).norm() < 1e-12);
    REQUIRE(relative_pose_error(T_a_w, T_b_w, T_a_b).norm() < 1e-12);

    // The error is what was put between truth and measurement.
    const Vec6<double> e = draw(random, 0.3, 0.3);
    REQUIRE((pose_error(SE3d::exp(e) * T_a_w, T_a_w) - e).norm() < 1e-10);
    const SE3d measured = T_a_b * SE3d::exp(-e);
    REQUIRE((relative_pose_error(T_a_w, T_b_w, measured) - e).norm() < 1e-10);

    Mat6<double> J, J_a, J_b;
    const SE3d T = SE3d::exp(e) * T_a_w;
    pose_error(T, T_a_w, &J);
    REQUIRE((J - differences([&](const Vec6<double>& d) { return pose_error(SE3d::exp(d) * T, T_a_w); }))
                .cwiseAbs()
                .maxCoeff() < 1e-7);
    relative_pose_error(T_a_w, T_b_w, measured, &J_a, &J_b);
    REQUIRE((J_a - differences([&](const Vec6<double>& d) {
               return relative_pose_error(SE3d::exp(d) * T_a_w, T_b_w, measured);
             }))
                .cwiseAbs()
                .maxCoeff() < 1e-6);
    REQUIRE((J_b - differences([&](const Vec6<double>& d) {
               return relative_pose_error(T_a_w, SE3d::exp(d) * T_b_w, measured);
             }))
                .cwiseAbs()
                .maxCoeff() < 1e-6);
  }
}
