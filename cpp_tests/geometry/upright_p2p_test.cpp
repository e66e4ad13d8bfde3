// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/upright_p2p.hpp"

#include <array>
#include <catch2/catch.hpp>
#include <limits>

#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

Vec3<double> any_direction(Random& random) {
  return Vec3<double>(random.normal(), random.normal(), random.normal()).normalized();
}

}  // namespace

TEST_CASE("shortest_turn brings one direction onto another", "[upright_p2p]") {
  Random random(1);
  for (int k = 0; k < 100; ++k) {
    const Vec3<double> a = any_direction(random), b = any_direction(random);
    CHECK((shortest_turn(a, b) * a - b).norm() < 1e-12);
    CHECK((shortest_turn(a, -a) * a + a).norm() < 1e-7);
  }
}

TEST_CASE("Two points and down give the pose, whatever it is", "[upright_p2p]") {
  Random random(2);
  int found = 0;
  for (int k = 0; k < 500; ++k) {
    const Vec3<double> down_world = any_direction(random);
    Vec6<double> xi;
    for (auto& x : xi) x = random.normal();
    const SE3d T = SE3d::exp(xi);
    std::array<Vec3<double>, 2> points;
    std::array<Vec2<double>, 2> rays;
    for (std::size_t i = 0; i < 2; ++i) {
      const Vec3<double> p(random.uniform(-2, 2), random.uniform(-1, 1), random.uniform(1, 5));
      rays[i] = p.head<2>() / p.z();
      points[i] = T.inverse() * p;
    }
    std::array<SE3d, 2> poses;
    const int count = solve_upright_p2p(points, rays, down_world, T.rotation() * down_world, poses);
    REQUIRE(count >= 1);
    double least = 1e9;
    for (int j = 0; j < count; ++j) {
      const SE3d& pose = poses[static_cast<std::size_t>(j)];
      least = std::min(least, (pose * T.inverse()).log().norm());
      // Each of them keeps down where it is and shows both points on their rays.
      CHECK((pose.rotation() * down_world - T.rotation() * down_world).norm() < 1e-9);
      for (std::size_t i = 0; i < 2; ++i) {
        const Vec3<double> p = pose * points[i];
        CHECK(p.z() > 0);
        CHECK((p.head<2>() / p.z() - rays[i]).norm() < 1e-6);
      }
    }
    found += least < 1e-6;
  }
  // A pair nearly above each other fixes the turn badly; few are so near that.
  CHECK(found >= 495);
}

TEST_CASE("Two points that fix no pose give none", "[upright_p2p]") {
  const Vec3<double> down(0, 1, 0);
  std::array<SE3d, 2> poses;
  // The same point twice, and points above each other: every turn fits.
  const std::array<Vec3<double>, 2> same{Vec3<double>(1, 0, 3), Vec3<double>(1, 0, 3)};
  const std::array<Vec2<double>, 2> one_ray{Vec2<double>(1.0 / 3, 0), Vec2<double>(1.0 / 3, 0)};
  CHECK(solve_upright_p2p(same, one_ray, down, down, poses) == 0);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const std::array<Vec3<double>, 2> strange{Vec3<double>(nan, 0, 3), Vec3<double>(1, 0, 3)};
  const std::array<Vec2<double>, 2> rays{Vec2<double>(0, 0), Vec2<double>(1.0 / 3, 0)};
  CHECK(solve_upright_p2p(strange, rays, down, down, poses) == 0);
}
