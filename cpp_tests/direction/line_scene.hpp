// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <numbers>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/direction/interpretation_plane.hpp"

namespace sweepkit::test {

inline constexpr double kDegree = std::numbers::pi / 180;

inline Camera plain_camera() { return Camera({400, 410, 322, 198}, Distortion::none, {}, 640, 400); }

inline Camera bent_camera() {
  return Camera({350, 349, 313, 197}, Distortion::radial_tangential, {-0.1, 0.02, -0.0005, 0.0005}, 640, 400);
}

/// A view of edges that run along the columns of a rotation, and of others that run anywhere.
struct LineScene {
  std::vector<LineSegment> segments;
  std::vector<int> axis;  ///< of each segment: 0, 1, 2, or -1
};

inline Vec3<double> random_direction(Random& random) {
  return Vec3<double>(random.normal(), random.normal(), random.normal()).normalized();
}

inline SO3d random_rotation(Random& random) {
  return SO3d(Eigen::Quaterniond(random.normal(), random.normal(), random.normal(), random.normal()));
}

/// Adds the view of edges of random place and length along a direction (camera frame).
inline void add_edges(LineScene& scene, Random& random, const Camera& camera, const Vec3<double>& direction,
                      int axis, int count, double noise) {
  for (int tries = 0; count > 0 && tries < 100000; ++tries) {
    const Vec3<double> middle(random.uniform(-3, 3), random.uniform(-2, 2), random.uniform(1, 6));
    const Vec3<double> half = 0.5 * random.uniform(0.2, 2) * direction;
    const auto a = camera.project(Vec3<double>(middle - half)),
               b = camera.project(Vec3<double>(middle + half));
    if (!a || !b) continue;
    const auto inside = [&](const Vec2<double>& p) {
      return p.x() >= 0 && p.y() >= 0 && p.x() <= camera.width() - 1 && p.y() <= camera.height() - 1;
    };
    if (!inside(*a) || !inside(*b) || (*a - *b).norm() < 18) continue;
    LineSegment s;
    s.x1 = static_cast<float>(a->x() + random.normal(0, noise));
    s.y1 = static_cast<float>(a->y() + random.normal(0, noise));
    s.x2 = static_cast<float>(b->x() + random.normal(0, noise));
    s.y2 = static_cast<float>(b->y() + random.normal(0, noise));
    scene.segments.push_back(s);
    scene.axis.push_back(axis);
    --count;
  }
}

/// @param counts edges along each column of R_camera_manhattan
/// @param outliers edges along random directions
inline LineScene line_scene(std::uint64_t seed, const Camera& camera, const SO3d& R_camera_manhattan,
                            std::array<int, 3> counts, int outliers, double noise = 0.5) {
  Random random(seed);
  LineScene scene;
  const Mat3<double> D = R_camera_manhattan.matrix();
  for (int k = 0; k < 3; ++k) add_edges(scene, random, camera, D.col(k), k, counts[k], noise);
  for (int i = 0; i < outliers; ++i) add_edges(scene, random, camera, random_direction(random), -1, 1, noise);
  return scene;
}

}  // namespace sweepkit::test
