// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/ground_plane.hpp"

#include <catch2/catch.hpp>

#include "sweepkit/core/random.hpp"

namespace {

using namespace sweepkit;

GroundPlane random_plane(Random& random) {
  GroundPlane plane;
  plane.down_camera = Vec3<double>(random.uniform(-0.5, 0.5), 1.0, random.uniform(-0.5, 0.5)).normalized();
  plane.height = random.uniform(0.03, 1.5);
  return plane;
}

TEST_CASE("the floor's disparity is that of its points, for any tilt") {
  const RectifiedCamera camera{350.0, 321.5, 198.2, 0.06};
  Random random(1);
  for (int k = 0; k < 200; ++k) {
    const GroundPlane plane = random_plane(random);
    const FloorDisparity disparity = plane.disparity(camera);
    // Points of the plane: from its foot along two directions across its normal.
    const Vec3<double> a = plane.down_camera.unitOrthogonal(), b = plane.down_camera.cross(a);
    for (int i = 0; i < 10; ++i) {
      const Vec3<double> p =
          plane.height * plane.down_camera + random.uniform(-3, 3) * a + random.uniform(-3, 3) * b;
      CHECK(plane.height_of(p) == Approx(0.0).margin(1e-12));
      const auto seen = camera.project_stereo(p);
      if (!seen || p.z() < 0.05) continue;
      CHECK(disparity(seen->x(), seen->y()) == Approx(seen->x() - seen->z()).epsilon(1e-9));
    }
  }
}

TEST_CASE("a plane follows from its disparity") {
  const RectifiedCamera camera{350.0, 321.5, 198.2, 0.06};
  Random random(2);
  for (int k = 0; k < 200; ++k) {
    const GroundPlane plane = random_plane(random);
    const GroundPlane back = GroundPlane::of(plane.disparity(camera), camera);
    CHECK((back.down_camera - plane.down_camera).norm() < 1e-12);
    CHECK(back.height == Approx(plane.height).epsilon(1e-12));
  }
}

TEST_CASE("what is nearer to the camera than the floor has more disparity, what is farther less") {
  const RectifiedCamera camera{350.0, 320.0, 200.0, 0.06};
  const GroundPlane plane{Vec3<double>(0.0, 1.0, 0.05).normalized(), 0.08};
  for (const double height : {-0.02, 0.02}) {
    GroundPlane other = plane;
    other.height -= height;
    CHECK((other.disparity(camera)(100, 350) > plane.disparity(camera)(100, 350)) == (height > 0));
  }
}

}  // namespace
