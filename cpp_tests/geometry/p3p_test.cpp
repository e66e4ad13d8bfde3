// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/p3p.hpp"

#include <algorithm>
#include <array>
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <vector>

#include "sweepkit/core/random.hpp"

namespace {

using sweepkit::Random;
using sweepkit::SE3d;
using sweepkit::SO3d;
using Vec3d = sweepkit::Vec3<double>;

struct Problem {
  SE3d T_camera_world;
  std::array<Vec3d, 3> points;
  std::array<Vec3d, 3> bearings;
};

/// Points anywhere in a view of 90 degrees, at distances from `near` to `far`.
Problem random_problem(Random& random, double near, double far, double half_width = 1.0) {
  Problem problem;
  const Eigen::Quaterniond q(random.normal(), random.normal(), random.normal(), random.normal());
  problem.T_camera_world = SE3d(SO3d(q), Vec3d(random.normal(), random.normal(), random.normal()));
  for (std::size_t i = 0; i < 3; ++i) {
    const Vec3d ray(random.uniform(-half_width, half_width), random.uniform(-half_width, half_width), 1.0);
    const Vec3d p = random.uniform(near, far) * ray;
    problem.points[i] = problem.T_camera_world.inverse() * p;
    problem.bearings[i] = p.normalized();
  }
  return problem;
}

/// Error of the nearest of the poses: angle [rad] plus distance over distance.
double nearest_error(const Problem& problem, std::span<const SE3d> poses) {
  double best = std::numeric_limits<double>::infinity();
  for (const SE3d& T : poses) {
    const SE3d error = problem.T_camera_world * T.inverse();
    best = std::min(best, error.rotation().angle() + error.translation().norm());
  }
  return best;
}

double reprojection(const Problem& problem, const SE3d& T) {
  double worst = 0.0;
  for (std::size_t i = 0; i < 3; ++i)
    worst = std::max(worst, ((T * problem.points[i]).normalized() - problem.bearings[i]).norm());
  return worst;
}

}  // namespace

TEST_CASE("the true pose is among those of 100000 random views", "[p3p]") {
  Random random(1);
  const int runs = 100000;
  int failures = 0, doubles = 0;
  double worst_reprojection = 0.0;
  std::vector<double> errors;
  for (int i = 0; i < runs; ++i) {
    const Problem problem = random_problem(random, 0.1, 10.0);
    std::array<SE3d, 4> poses;
    const int count = sweepkit::solve_p3p(problem.points, problem.bearings, poses);
    const auto found = std::span<const SE3d>(poses).first(static_cast<std::size_t>(count));
    const double error = nearest_error(problem, found);
    failures += !(error < 1e-6);
    errors.push_back(error);
    for (std::size_t a = 0; a < found.size(); ++a) {
      worst_reprojection = std::max(worst_reprojection, reprojection(problem, found[a]));
      for (std::size_t b = 0; b < a; ++b) doubles += (found[a].inverse() * found[b]).log().norm() < 1e-9;
    }
  }
  std::sort(errors.begin(), errors.end());
  INFO("error of the pose: median " << errors[runs / 2] << ", 99.9 % " << errors[runs - runs / 1000]
                                    << ", largest " << errors.back() << "; failures above 1e-6: " << failures
                                    << " of " << runs);
  CHECK(failures == 0);
  CHECK(doubles == 0);
  CHECK(errors[runs / 2] < 1e-13);
  CHECK(worst_reprojection < 1e-7);
}

TEST_CASE("small far triangles keep their digits", "[p3p]") {
  Random random(2);
  int failures = 0;
  for (int i = 0; i < 2000; ++i) {
    const Problem problem = random_problem(random, 9.0, 10.0, 0.02);
    std::array<SE3d, 4> poses;
    const int count = sweepkit::solve_p3p(problem.points, problem.bearings, poses);
    failures +=
        !(nearest_error(problem, std::span<const SE3d>(poses).first(static_cast<std::size_t>(count))) < 1e-4);
  }
  CHECK(failures <= 2);
}

TEST_CASE("symmetric views have all their solutions", "[p3p]") {
  // An equilateral triangle seen from above its centre: the classical case of four solutions.
  Problem problem;
  problem.T_camera_world = SE3d(SO3d(), Vec3d(0, 0, 2.0));
  for (std::size_t i = 0; i < 3; ++i) {
    const double angle = 2.0943951023931953 * static_cast<double>(i);
    problem.points[i] = Vec3d(std::cos(angle), std::sin(angle), 0.0);
    problem.bearings[i] = (problem.T_camera_world * problem.points[i]).normalized();
  }
  std::array<SE3d, 4> poses;
  const int count = sweepkit::solve_p3p(problem.points, problem.bearings, poses);
  CHECK(count == 4);
  CHECK(nearest_error(problem, std::span<const SE3d>(poses).first(static_cast<std::size_t>(count))) < 1e-7);
}

TEST_CASE("degenerate triangles and broken values give no pose and no NaN", "[p3p]") {
  Random random(3);
  std::array<SE3d, 4> poses;
  const Problem good = random_problem(random, 1.0, 5.0);
  const auto count = [&](const Problem& problem) {
    const int found = sweepkit::solve_p3p(problem.points, problem.bearings, poses);
    for (int i = 0; i < found; ++i) CHECK(poses[static_cast<std::size_t>(i)].matrix().allFinite());
    return found;
  };
  Problem problem = good;
  problem.points[2] = 0.3 * problem.points[0] + 0.7 * problem.points[1];
  CHECK(count(problem) == 0);
  problem.points = {good.points[0], good.points[0], good.points[0]};
  CHECK(count(problem) == 0);
  problem.points = {good.points[0], good.points[0], good.points[1]};
  CHECK(count(problem) == 0);
  for (const double value :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    problem = good;
    problem.points[1].x() = value;
    CHECK(count(problem) == 0);
    problem = good;
    problem.bearings[1].x() = value;
    CHECK(count(problem) == 0);
  }
  problem = good;
  problem.bearings = {good.bearings[0], good.bearings[0], good.bearings[0]};
  CHECK(count(problem) == 0);
  problem.bearings = {good.bearings[0], good.bearings[0], good.bearings[1]};
  count(problem);  // a side seen end on: whatever comes is finite
  problem.bearings = {Vec3d::UnitX(), Vec3d::UnitY(), Vec3d(1, 1, 0).normalized()};
  count(problem);                   // the camera in the plane of the points
  for (int i = 0; i < 2000; ++i) {  // bearings that belong to other points
    problem = random_problem(random, 0.1, 10.0);
    problem.points = random_problem(random, 0.1, 10.0).points;
    const int found = count(problem);
    for (int k = 0; k < found; ++k) CHECK(reprojection(problem, poses[static_cast<std::size_t>(k)]) < 1e-6);
  }
}
