// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/motion/integrators.hpp"

#include <catch2/catch.hpp>
#include <limits>
#include <numbers>
#include <vector>

#include "ceres/jet.h"
#include "geometry/jacobian_check.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

Vec6<double> twist(double vx, double vy, double vz, double wx, double wy, double wz) {
  Vec6<double> xi;
  xi << vx, vy, vz, wx, wy, wz;
  return xi;
}

Vec6<double> draw(Random& random, double rho, double phi) {
  Vec6<double> xi;
  for (int i = 0; i < 6; ++i) xi[i] = random.normal(0.0, i < 3 ? rho : phi);
  return xi;
}

/// The twist of a robot that drives over a sill: speed, turn and pitch all change.
Vec6<double> sill_twist(double t) {
  const double bump = std::exp(-50 * (t - 1) * (t - 1));
  return twist(0.3 + 0.05 * std::sin(3 * t), 0, 0, 0.1 * bump, -6 * (t - 1) * bump, 0.8 * std::sin(2 * t));
}

/// Where the means over `count` steps of equal length lead in 2 s.
template <class I>
SE3d drive(int count) {
  const double dt = 2.0 / count;
  SE3d pose;
  for (int k = 0; k < count; ++k) {
    // The mean of the twist, by 20 points: what a counter and an integrating gyro give.
    Vec6<double> mean = Vec6<double>::Zero();
    for (int i = 0; i < 20; ++i) mean += sill_twist((k + (i + 0.5) / 20) * dt) / 20;
    pose = pose * I::motion(Vec6<double>(mean * dt));
  }
  return pose;
}

double distance(const SE3d& a, const SE3d& b) { return (a.translation() - b.translation()).norm(); }

}  // namespace

TEMPLATE_TEST_CASE("an integrator's Jacobian is its derivative", "[motion][integrators]", EulerIntegrator,
                   MidpointIntegrator, ClosedFormIntegrator) {
  Random random(1);
  for (const double size : {1e-6, 0.01, 0.5, 1.0}) {
    const Vec6<double> xi = draw(random, size, size);
    const SE3d back = TestType::motion(xi).inverse();
    const auto moved = [&](const Vec6<double>& x) { return (back * TestType::motion(x)).log(); };
    test::check_jacobian(moved, xi, TestType::jacobian(xi));
    // The same by automatic derivatives.
    using Jet = ceres::Jet<double, 6>;
    Vec6<Jet> x;
    for (int i = 0; i < 6; ++i) x[i] = Jet(xi[i], i);
    const Vec6<Jet> log = (back.cast<Jet>() * TestType::motion(x)).log();
    for (int i = 0; i < 6; ++i) CHECK((log[i].v.transpose() - TestType::jacobian(xi).row(i)).norm() < 1e-9);
  }
}

TEMPLATE_TEST_CASE("integrators agree in float and double, and at rest", "[motion][integrators]",
                   EulerIntegrator, MidpointIntegrator, ClosedFormIntegrator) {
  Random random(2);
  for (int i = 0; i < 20; ++i) {
    const Vec6<double> xi = draw(random, 0.1, 0.1);
    const SE3d exact = TestType::motion(xi);
    const SE3f rough = TestType::motion(Vec6<float>(xi.cast<float>()));
    CHECK(distance(exact, rough.cast<double>()) < 1e-6);
    CHECK((exact.inverse() * rough.cast<double>()).rotation().angle() < 1e-6);
  }
  const SE3d rest = TestType::motion(Vec6<double>(Vec6<double>::Zero()));
  CHECK(rest.translation().norm() == 0);
  CHECK(rest.rotation().angle() == 0);
}

TEST_CASE("the closed form is exact for constant twists of any step", "[motion][integrators]") {
  // A circle driven once: back at the start, however few steps.
  const Vec6<double> rate = twist(0.3, 0, 0, 0, 0, 1.0);
  for (const int steps : {3, 7, 100}) {
    SE3d closed, midpoint, euler;
    for (int k = 0; k < steps; ++k) {
      const Vec6<double> xi = rate * (2 * std::numbers::pi / steps);
      closed = closed * ClosedFormIntegrator::motion(xi);
      midpoint = midpoint * MidpointIntegrator::motion(xi);
      euler = euler * EulerIntegrator::motion(xi);
    }
    CHECK(closed.translation().norm() < 1e-14);
    CHECK(euler.translation().norm() < 1e-12);  // a regular polygon closes too
  }
  // A third of it, and a helix: by hand and by many small steps.
  const SE3d arc = ClosedFormIntegrator::motion(Vec6<double>(rate * 2.0));
  CHECK(arc.translation().x() == Approx(0.3 * std::sin(2.0)).epsilon(1e-14));
  CHECK(arc.translation().y() == Approx(0.3 * (1 - std::cos(2.0))).epsilon(1e-14));
  const Vec6<double> helix = twist(0.2, -0.1, 0.05, 0.3, -0.4, 1.2);
  SE3d small;
  for (int k = 0; k < 20000; ++k) small = small * MidpointIntegrator::motion(Vec6<double>(helix / 20000));
  CHECK(distance(small, ClosedFormIntegrator::motion(helix)) < 1e-9);
}

TEST_CASE("on arcs the closed form is strictly the best", "[motion][integrators]") {
  Random random(3);
  for (int path = 0; path < 50; ++path) {
    // Arcs of constant twist, one for each step.
    SE3d truth, euler, midpoint, closed;
    const int steps = 20;
    for (int k = 0; k < steps; ++k) {
      const Vec6<double> xi =
          twist(random.uniform(0.02, 0.1), 0, 0, 0, random.normal(0, 0.02), random.uniform(0.1, 0.5));
      for (int i = 0; i < 1000; ++i) truth = truth * MidpointIntegrator::motion(Vec6<double>(xi / 1000));
      euler = euler * EulerIntegrator::motion(xi);
      midpoint = midpoint * MidpointIntegrator::motion(xi);
      closed = closed * ClosedFormIntegrator::motion(xi);
    }
    CHECK(distance(closed, truth) < distance(midpoint, truth));
    CHECK(distance(midpoint, truth) < distance(euler, truth));
  }
}

TEST_CASE("error against step size over a sill", "[motion][integrators]") {
  const SE3d truth = drive<ClosedFormIntegrator>(20000);
  const auto order = [&](auto integrator) {
    using I = decltype(integrator);
    return std::log2(distance(drive<I>(100), truth) / distance(drive<I>(200), truth));
  };
  CHECK(order(EulerIntegrator()) == Approx(1.0).margin(0.1));
  CHECK(order(MidpointIntegrator()) == Approx(2.0).margin(0.1));
  CHECK(order(ClosedFormIntegrator()) == Approx(2.0).margin(0.1));
  for (const int steps : {20, 50, 100, 200}) {
    CHECK(distance(drive<MidpointIntegrator>(steps), truth) < distance(drive<EulerIntegrator>(steps), truth));
    CHECK(distance(drive<ClosedFormIntegrator>(steps), truth) <
          distance(drive<EulerIntegrator>(steps), truth));
  }
}

TEMPLATE_TEST_CASE("the covariance is that of many noisy paths", "[motion][integrators]", EulerIntegrator,
                   MidpointIntegrator, ClosedFormIntegrator) {
  const Vec6<double> xi = twist(0.05, 0, 0, 0, 0.01, 0.1);
  Vec6<double> sigma = twist(2e-3, 1e-3, 1e-3, 2e-3, 2e-3, 5e-3);
  const Mat6<double> noise = Vec6<double>(sigma.cwiseAbs2()).asDiagonal();
  UncertainMotion<double> path;
  for (int k = 0; k < 30; ++k) path = path * integrate_step<TestType>(xi, noise);
  Random random(4);
  Mat6<double> spread = Mat6<double>::Zero();
  constexpr int kPaths = 4000;
  const SE3d back = path.T.inverse();
  for (int n = 0; n < kPaths; ++n) {
    SE3d T;
    for (int k = 0; k < 30; ++k) {
      Vec6<double> noisy = xi;
      for (int i = 0; i < 6; ++i) noisy[i] += random.normal(0, sigma[i]);
      T = T * TestType::motion(noisy);
    }
    const Vec6<double> d = (back * T).log();
    spread += d * d.transpose() / kPaths;
  }
  // Whitened, the spread is the identity; its entries deviate by about sqrt(2 / 4000) = 0.022.
  const Mat6<double> L = path.covariance.llt().matrixL().solve(Mat6<double>::Identity());
  CHECK((L * spread * L.transpose() - Mat6<double>::Identity()).cwiseAbs().maxCoeff() < 0.12);
}

TEST_CASE("motions in bulk", "[motion][integrators]") {
  const std::vector<double> times = {0, 0.5, 0.5, 2.0};
  const std::vector<Vec6<double>> rates(3, twist(0.3, 0, 0, 0, 0, 1.0));
  std::vector<SE3d> poses(4);
  const SE3d start = SE3d::exp(twist(1, 2, 3, 0.1, 0.2, 0.3));
  integrate_path<ClosedFormIntegrator, double>(times, rates, start, poses);
  CHECK(distance(poses[0], start) == 0);
  CHECK(distance(poses[2], poses[1]) < 1e-15);
  CHECK(distance(poses[3], start * ClosedFormIntegrator::motion(Vec6<double>(rates[0] * 2))) < 1e-14);

  const auto integrate = [&](std::vector<double> t) {
    integrate_path<EulerIntegrator, double>(t, rates, start, poses);
  };
  CHECK_THROWS_AS(integrate({0, 1, 0.9, 2}), Error);
  CHECK_THROWS_AS(integrate({0, 1, 2}), Error);
  CHECK_THROWS_AS(integrate({0, 1, std::numeric_limits<double>::quiet_NaN(), 2}), Error);
}
