// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/triangulation.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <vector>

#include "sweepkit/core/random.hpp"

namespace {

using sweepkit::Random;
using sweepkit::SE3;
using sweepkit::SE3d;
using sweepkit::SO3;
using sweepkit::Vec3;
using Vec3d = Vec3<double>;

Vec3d random_vector(Random& random, double size) {
  return {random.uniform(-size, size), random.uniform(-size, size), random.uniform(-size, size)};
}

/// The direction of v, turned by a random small angle about both axes across it.
Vec3d noisy_direction(const Vec3d& v, double sigma, Random& random) {
  const Vec3d b = v.normalized();
  const Vec3d x = b.unitOrthogonal(), y = b.cross(x);
  return (b + sigma * random.normal() * x + sigma * random.normal() * y).normalized();
}

struct Views {
  std::vector<SE3d> T_camera_world;
  std::vector<Vec3d> bearings;
};

/// Cameras around the origin that see p, with noise.
Views look_at(const Vec3d& p, int count, double sigma, Random& random) {
  Views views;
  for (int i = 0; i < count; ++i) {
    const SE3d T(SO3<double>::exp(random_vector(random, 1.0)), random_vector(random, 1.0));
    views.T_camera_world.push_back(T);
    views.bearings.push_back(noisy_direction(T * p, sigma, random));
  }
  return views;
}

}  // namespace

TEMPLATE_TEST_CASE("rays through a point give the point", "[triangulation]", float, double) {
  using S = TestType;
  const double tolerance = std::is_same_v<S, float> ? 2e-4 : 1e-10;
  Random random(3);
  for (int i = 0; i < 200; ++i) {
    const Vec3d p = random_vector(random, 3.0) + Vec3d(0, 0, 6);
    const auto views = look_at(p, 2 + i % 4, 0.0, random);
    std::vector<SE3<S>> poses;
    std::vector<Vec3<S>> bearings;
    for (std::size_t k = 0; k < views.bearings.size(); ++k) {
      poses.push_back(views.T_camera_world[k].cast<S>());
      bearings.push_back((views.bearings[k] * random.uniform(0.5, 2.0)).cast<S>());  // of any length
    }
    const auto linear = sweepkit::triangulate_linear<S>(poses, bearings);
    REQUIRE(linear);
    if (linear->parallax < S(0.05)) continue;
    CHECK((linear->point.template cast<double>() - p).norm() < tolerance * p.norm() / linear->parallax);
    CHECK(linear->in_front);
    CHECK(linear->max_angle < 10 * tolerance);

    const SE3<S> T_a_b = poses[0] * poses[1].inverse();
    const Vec3d p_a = views.T_camera_world[0] * p;
    for (const auto& two : {sweepkit::triangulate_midpoint<S>(T_a_b, bearings[0], bearings[1]),
                            sweepkit::triangulate_inverse_depth<S>(T_a_b, bearings[0], bearings[1])}) {
      REQUIRE(two);
      if (two->parallax < S(0.05)) continue;
      CHECK((two->point.template cast<double>() - p_a).norm() < tolerance * p.norm() / two->parallax);
      CHECK(two->in_front);
    }
  }
}

TEST_CASE("the midpoint is the middle of the shortest segment between the rays", "[triangulation]") {
  Random random(5);
  for (int i = 0; i < 100; ++i) {
    const Vec3d p(0.3, -0.2, 4.0);
    const auto views = look_at(p, 2, 0.02, random);
    const SE3d T_a_b = views.T_camera_world[0] * views.T_camera_world[1].inverse();
    const auto found = sweepkit::triangulate_midpoint(T_a_b, views.bearings[0], views.bearings[1]);
    REQUIRE(found);
    // Depths along the two rays by the normal equations, written out.
    const Vec3d a = views.bearings[0], b = T_a_b.rotation() * views.bearings[1], t = T_a_b.translation();
    const double c = a.dot(b), n = 1.0 - c * c;
    const double s_a = (a.dot(t) - c * b.dot(t)) / n, s_b = (c * a.dot(t) - b.dot(t)) / n;
    CHECK((found->point - 0.5 * (s_a * a + t + s_b * b)).norm() < 1e-9 * found->point.norm());
    CHECK(found->parallax == Approx(std::acos(c)).epsilon(1e-6));
  }
}

TEST_CASE("the covariance of a triangulated point is that of its errors", "[triangulation]") {
  const double sigma = 2e-3;
  const int runs = 1000;
  Random random(7);
  double nees[4] = {0, 0, 0, 0};
  for (int i = 0; i < runs; ++i) {
    // Distances of the cameras that differ by a factor of three, so that weights matter.
    const Vec3d p(0.4, 0.2, 3.0);
    const std::vector<SE3d> poses{SE3d(), SE3d(SO3<double>::exp({0.1, 0.2, 0.3}), Vec3d(-0.8, 0.1, -2.0)),
                                  SE3d(SO3<double>::exp({-0.1, 0.2, 0.1}), Vec3d(0.7, 0.3, 1.0))};
    std::vector<Vec3d> bearings;
    for (const auto& T : poses) bearings.push_back(noisy_direction(T * p, sigma, random));
    const auto add = [&](double& sum, const auto& found) {
      REQUIRE(found);
      const Vec3d e = found->point - p;
      sum += e.dot(found->covariance.inverse() * e) / runs;
    };
    add(nees[0], sweepkit::triangulate_linear<double>(poses, bearings, sigma));
    add(nees[1], sweepkit::triangulate_linear<double>(poses, bearings, sigma, 0));
    const SE3d T_a_b = poses[1].inverse();
    add(nees[2], sweepkit::triangulate_midpoint(T_a_b, bearings[0], bearings[1], sigma));
    add(nees[3], sweepkit::triangulate_inverse_depth(T_a_b, bearings[0], bearings[1], sigma));
  }
  // The mean of 1000 chi squares with three degrees of freedom: 3 +- 0.077.
  for (const double value : nees) CHECK(value == Approx(3.0).margin(0.3));
}

TEST_CASE("reweighting makes the linear estimate the more accurate one", "[triangulation]") {
  Random random(8);
  const Vec3d p(0.1, 0.2, 6.0);
  const std::vector<SE3d> poses{SE3d(), SE3d(SO3<double>(), Vec3d(-0.5, 0.0, 0.0)),
                                SE3d(SO3<double>(), Vec3d(-0.1, -0.2, -5.0))};
  double plain = 0.0, weighted = 0.0;
  for (int i = 0; i < 500; ++i) {
    std::vector<Vec3d> bearings;
    for (const auto& T : poses) bearings.push_back(noisy_direction(T * p, 2e-3, random));
    const auto error = [&](int rounds) -> Eigen::Vector2d {
      // Across the view: along it the far cameras' baseline decides, whatever the weights.
      return (sweepkit::triangulate_linear<double>(poses, bearings, 2e-3, rounds)->point - p).head<2>();
    };
    plain += error(0).squaredNorm();
    weighted += error(1).squaredNorm();
  }
  CHECK(weighted < 0.5 * plain);
}

TEST_CASE("points behind a camera are said to be", "[triangulation]") {
  const SE3d T_a_b(SO3<double>(), Vec3d(1, 0, 0));
  const Vec3d p(0.3, 0.1, -4.0);
  const Vec3d a = -p, b = -(T_a_b.inverse() * p);  // both rays point away from p
  for (const auto& found :
       {sweepkit::triangulate_midpoint(T_a_b, a, b), sweepkit::triangulate_inverse_depth(T_a_b, a, b)}) {
    REQUIRE(found);
    CHECK_FALSE(found->in_front);
  }
  const auto midpoint = sweepkit::triangulate_midpoint(T_a_b, a, b);
  CHECK((midpoint->point - p).norm() < 1e-9);
}

TEST_CASE("rays that fix no point give nothing", "[triangulation]") {
  const Vec3d b(0.1, 0.2, 1.0), zero = Vec3d::Zero();
  const Vec3d nan = Vec3d::Constant(std::numeric_limits<double>::quiet_NaN());
  const SE3d T_a_b(SO3<double>(), Vec3d(1, 0, 0));
  const auto nothing = [](const SE3d& T, const Vec3d& a, const Vec3d& b) {
    const std::vector<SE3d> poses{SE3d(), T.inverse()};
    const std::vector<Vec3d> bearings{a, b};
    return !sweepkit::triangulate_midpoint(T, a, b) && !sweepkit::triangulate_inverse_depth(T, a, b) &&
           !sweepkit::triangulate_linear<double>(poses, bearings);
  };
  CHECK(nothing(T_a_b, b, b));                      // parallel
  CHECK(nothing(T_a_b, b, zero));                   // no direction
  CHECK(nothing(T_a_b, nan, b));                    // not a number
  CHECK(nothing(SE3d(), b, Vec3d(0.2, 0.2, 1.0)));  // one centre: the point is the camera
  CHECK_FALSE(sweepkit::triangulate_linear<double>({}, {}));
  const std::vector<SE3d> one(1);
  const std::vector<Vec3d> bearings{b}, two{b, b};
  CHECK_FALSE(sweepkit::triangulate_linear<double>(one, bearings));
  CHECK_THROWS_AS(sweepkit::triangulate_linear<double>(one, two), sweepkit::Error);
}
