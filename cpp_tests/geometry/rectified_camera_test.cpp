// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/rectified_camera.hpp"

#include <catch2/catch.hpp>

#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {
const RectifiedCamera kCamera{450.0, 320.5, 199.5, 0.11};
}

TEST_CASE("the rectified camera projects with exact Jacobians", "[geometry]") {
  Random random(1);
  for (int k = 0; k < 100; ++k) {
    const double z = random.uniform(0.3, 20.0);
    const Vec3<double> p(random.normal() * z, random.normal() * z, z);
    Eigen::Matrix<double, 2, 3> J;
    Mat3<double> J_stereo;
    const auto pixel = kCamera.project(p, &J);
    const auto stereo = kCamera.project_stereo(p, &J_stereo);
    REQUIRE(pixel);
    REQUIRE(stereo);
    REQUIRE(stereo->head<2>() == *pixel);
    REQUIRE((*stereo)[0] - (*stereo)[2] == Approx(kCamera.disparity(z)));
    for (int i = 0; i < 3; ++i) {
      const double h = 1e-5 * z;
      const Vec3<double> step = h * Vec3<double>::Unit(i);
      const Vec3<double> expected =
          (*kCamera.project_stereo(p + step) - *kCamera.project_stereo(p - step)) / (2.0 * h);
      REQUIRE((J_stereo.col(i) - expected).norm() < 1e-6 * (1.0 + expected.norm()));
      REQUIRE((J.col(i) - expected.head<2>()).norm() < 1e-6 * (1.0 + expected.norm()));
    }
  }
  REQUIRE_FALSE(kCamera.project({0, 0, 0}));
  REQUIRE_FALSE(kCamera.project_stereo({0, 0, -1}));
}

TEST_CASE("back projection inverts projection and carries the covariance through", "[geometry]") {
  Random random(2);
  const double sigma = 0.8, sigma_disparity = 0.25;
  for (int k = 0; k < 100; ++k) {
    const double z = random.uniform(0.3, 20.0);
    const Vec3<double> p(random.normal() * z, random.normal() * z, z);
    const auto m = kCamera.project_stereo(p);
    const double u = (*m)[0], v = (*m)[1], d = (*m)[0] - (*m)[2];
    const auto point = kCamera.back_project(u, v, d, sigma, sigma_disparity);
    REQUIRE(point);
    REQUIRE((point->p_camera - p).norm() < 1e-9 * p.norm());
    // By the derivative of the inverse map, from central differences.
    Mat3<double> J;
    for (int i = 0; i < 3; ++i) {
      const double h = 1e-5;
      const Vec3<double> s = h * Vec3<double>::Unit(i);
      J.col(i) = (kCamera.back_project(u + s[0], v + s[1], d + s[2], 1, 1)->p_camera -
                  kCamera.back_project(u - s[0], v - s[1], d - s[2], 1, 1)->p_camera) /
                 (2.0 * h);
    }
    const Vec3<double> variances(sigma * sigma, sigma * sigma, sigma_disparity * sigma_disparity);
    const Mat3<double> expected = J * variances.asDiagonal() * J.transpose();
    REQUIRE((point->covariance - expected).norm() < 1e-5 * expected.norm());
  }
  REQUIRE_FALSE(kCamera.back_project(1, 1, 0.0, 1, 1));
  REQUIRE_FALSE(kCamera.back_project(1, 1, -2.0, 1, 1));
}
