// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/solve/reprojection.hpp"

#include <ceres/jet.h>

#include <catch2/catch.hpp>

#include "sweepkit/core/random.hpp"

using namespace sweepkit;

TEST_CASE("reprojection errors and their Jacobians agree with automatic differentiation", "[solve]") {
  using Jet = ceres::Jet<double, 9>;  // by xi (0 to 5) and p_world (6 to 8)
  const RectifiedCamera camera{450.0, 320.5, 199.5, 0.11};
  Random random(1);
  for (int k = 0; k < 200; ++k) {
    Vec6<double> at;
    for (int i = 0; i < 6; ++i) at[i] = random.normal(0.0, i < 3 ? 3.0 : 0.8);
    const SE3d T = SE3d::exp(at);
    const double z = random.uniform(0.5, 20.0);
    const Vec3<double> p_camera(random.uniform(-0.8, 0.8) * z, random.uniform(-0.5, 0.5) * z, z);
    const Vec3<double> p_world = T.inverse() * p_camera;
    const double u = random.uniform(0, 640), v = random.uniform(0, 400), disparity = random.uniform(0, 60);

    Vec3<double> errors;
    Eigen::Matrix<double, 3, 6> J_pose;
    Mat3<double> J_point;
    REQUIRE(reprojection_error(camera, T.rotation().matrix(), T.translation(), p_world, u, v, disparity,
                               errors, &J_pose, &J_point));

    Vec6<Jet> xi;
    Vec3<Jet> p;
    for (int i = 0; i < 6; ++i) xi[i] = Jet(0.0, i);
    for (int i = 0; i < 3; ++i) p[i] = Jet(p_world[i], 6 + i);
    const Vec3<Jet> q = SE3<Jet>::exp(xi) * (T.cast<Jet>() * p);
    const Jet expected[3] = {Jet(camera.focal) * q.x() / q.z() + Jet(camera.cx - u),
                             Jet(camera.focal) * q.y() / q.z() + Jet(camera.cy - v),
                             Jet(camera.focal * camera.baseline) / q.z() - Jet(disparity)};
    for (int r = 0; r < 3; ++r) {
      REQUIRE(errors[r] == Approx(expected[r].a).margin(1e-8));
      for (int c = 0; c < 6; ++c)
        REQUIRE(J_pose(r, c) == Approx(expected[r].v[c]).epsilon(1e-9).margin(1e-7));
      for (int c = 0; c < 3; ++c)
        REQUIRE(J_point(r, c) == Approx(expected[r].v[6 + c]).epsilon(1e-9).margin(1e-7));
    }
  }
}

TEST_CASE("a point behind the camera has no reprojection error", "[solve]") {
  Vec3<double> errors(1, 2, 3);
  for (const double z : {0.0, -1.0})
    REQUIRE_FALSE(reprojection_error({450, 320, 200, 0.1}, Mat3<double>::Identity(), Vec3<double>::Zero(),
                                     Vec3<double>(0.1, 0.1, z), 0, 0, 0, errors));
  REQUIRE(errors == Vec3<double>(1, 2, 3));
}
