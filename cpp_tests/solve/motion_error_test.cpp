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
