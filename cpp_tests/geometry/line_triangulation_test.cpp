// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/line_triangulation.hpp"

#include <Eigen/Eigenvalues>
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>

#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

struct Setup {
  SE3d T_a_b;
  Vec3<double> p1, p2, q1, q2;  // what a and b see of one line, in a
};

Setup random_setup(Random& random) {
  const auto vector = [&](double s) {
    return Vec3<double>(random.uniform(-s, s), random.uniform(-s, s), random.uniform(-s, s));
  };
  Setup s;
  s.T_a_b = SE3d(SO3d::exp(vector(0.2)), Vec3<double>(0.3, 0, 0) + vector(0.1));
  s.p1 = Vec3<double>(0, 0, 3) + vector(0.8);
  // Upright enough to be seen by a baseline along x.
  s.p2 = s.p1 + Vec3<double>(0.3, 1, 0.2) + vector(0.25);
  const Vec3<double> d = s.p2 - s.p1;
  s.q1 = s.p1 + random.uniform(-0.2, 0.3) * d;
  s.q2 = s.p1 + random.uniform(0.7, 1.2) * d;
  return s;
}

}  // namespace

TEST_CASE("A segment seen twice is found where it is, whatever ends the second view sees") {
  Random random(1);
  for (int i = 0; i < 100; ++i) {
    const Setup s = random_setup(random);
    const SE3d T_b_a = s.T_a_b.inverse();
    const SegmentView a{2.5 * s.p1, s.p2}, b{T_b_a * s.q1, 0.3 * (T_b_a * s.q2)};
    const auto found = triangulate_segment(s.T_a_b, a, b);
    REQUIRE(found);
    CHECK((found->p1 - s.p1).norm() < 1e-9);
    CHECK((found->p2 - s.p2).norm() < 1e-9);
    CHECK(found->covariance1.isApprox(found->covariance1.transpose()));
    CHECK(found->covariance1.eigenvalues().real().minCoeff() > -1e-12);
    // In another frame it is the same.
    const SE3d T(SO3d::exp(Vec3<double>(1, 2, -0.5)), {4, 5, 6});
    const Segment3d moved = transformed(T, *found);
    CHECK(moved.length() == Approx(found->length()));
    CHECK((moved.p1 - T * s.p1).norm() < 1e-9);
    CHECK(moved.covariance1.trace() == Approx(found->covariance1.trace()));
  }
}

TEST_CASE("The covariances are those of many noisy views") {
  Random random(5);
  for (int k = 0; k < 5; ++k) {
    const Setup s = random_setup(random);
    const SE3d T_b_a = s.T_a_b.inverse();
    const double sigma = 4e-4, along = 9e-4;
    SegmentView a{s.p1.normalized(), s.p2.normalized(), sigma, 1.5 * sigma, along};
    SegmentView b{(T_b_a * s.q1).normalized(), (T_b_a * s.q2).normalized(), 0.7 * sigma, sigma, along};
    const auto noisy = [&](const SegmentView& v) {
      const Vec3<double> normal = v.ray1.cross(v.ray2).normalized();
      SegmentView w = v;
      w.ray1 += random.normal() * v.sigma1 * normal + random.normal() * v.sigma_along * normal.cross(v.ray1);
      w.ray2 += random.normal() * v.sigma2 * normal + random.normal() * v.sigma_along * normal.cross(v.ray2);
      return w;
    };
    const auto expected = triangulate_segment(s.T_a_b, a, b);
    REQUIRE(expected);
    Mat3<double> sum1 = Mat3<double>::Zero(), sum2 = sum1;
    const int count = 4000;
    for (int i = 0; i < count; ++i) {
      const auto found = triangulate_segment(s.T_a_b, noisy(a), noisy(b));
      REQUIRE(found);
      sum1 += (found->p1 - s.p1) * (found->p1 - s.p1).transpose();
      sum2 += (found->p2 - s.p2) * (found->p2 - s.p2).transpose();
    }
    CHECK((sum1 / count - expected->covariance1).norm() < 0.15 * expected->covariance1.norm());
    CHECK((sum2 / count - expected->covariance2).norm() < 0.15 * expected->covariance2.norm());
  }
}

TEST_CASE("What two views do not tell is nothing") {
  const SE3d T_a_b(SO3d(), {0.2, 0, 0});
  const auto see = [&](const Vec3<double>& p, const Vec3<double>& q) {
    const SE3d T_b_a = T_a_b.inverse();
    return triangulate_segment(T_a_b, SegmentView{p, q}, SegmentView{T_b_a * p, T_b_a * q});
  };
  CHECK(see({0, -1, 3}, {0, 1, 3}));
  CHECK_FALSE(see({-1, 0.5, 3}, {1, 0.5, 3}));  // along the baseline: in one plane with both centres
  CHECK_FALSE(see({0, 1, 3}, {0, 1, 3}));       // a point
  const double nan = std::numeric_limits<double>::quiet_NaN();
  CHECK_FALSE(see({nan, 1, 3}, {0, -1, 3}));
  CHECK_FALSE(see({0, 0, 0}, {0, -1, 3}));
  // Rays that part: the line would lie behind.
  CHECK_FALSE(
      triangulate_segment(T_a_b, SegmentView{{0, -1, 3}, {0, 1, 3}}, SegmentView{{0.5, -1, 3}, {0.5, 1, 3}}));
  // The same centre.
  CHECK_FALSE(
      triangulate_segment(SE3d(), SegmentView{{0, -1, 3}, {0, 1, 3}}, SegmentView{{0, -1, 3}, {0, 1, 3}}));
}
