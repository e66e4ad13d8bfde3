// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/direction/vanishing_points.hpp"

#include <algorithm>
#include <catch2/catch.hpp>

#include "line_scene.hpp"

using namespace sweepkit;
using namespace sweepkit::test;

namespace {

double angle_between(const Vec3<double>& a, const Vec3<double>& b) {
  return std::acos(std::min(1.0, std::abs(a.dot(b)))) / kDegree;
}

}  // namespace

TEST_CASE("directions that need not be square to one another are all found") {
  const Camera camera = bent_camera();
  int found = 0;
  for (int seed = 0; seed < 20; ++seed) {
    Random random(100 + seed);
    LineScene scene;
    std::vector<Vec3<double>> truth;
    while (truth.size() < 4) {
      const Vec3<double> d = random_direction(random);
      if (std::all_of(truth.begin(), truth.end(), [&](const auto& t) { return angle_between(t, d) > 20; }))
        truth.push_back(d);
    }
    for (int k = 0; k < 4; ++k) add_edges(scene, random, camera, truth[k], k, 30, 0.5);
    for (int i = 0; i < 40; ++i) add_edges(scene, random, camera, random_direction(random), -1, 1, 0.5);
    std::vector<InterpretationPlane> planes;
    interpretation_planes(camera, scene.segments, {}, planes);
    VanishingPointFinder finder;
    std::vector<VanishingPoint> points;
    finder.find(planes, points);
    REQUIRE(finder.labels().size() == planes.size());
    for (const auto& d : truth) {
      const auto near = std::find_if(points.begin(), points.end(), [&](const VanishingPoint& p) {
        return angle_between(p.direction, d) < 2;
      });
      found += near != points.end();
    }
    for (std::size_t i = 1; i < points.size(); ++i) CHECK(points[i].support <= points[i - 1].support + 1e-9);
    for (const VanishingPoint& p : points) {
      CHECK(p.direction.norm() == Approx(1));
      CHECK(p.direction.z() >= 0);
      CHECK(p.sigma > 0);
    }
  }
  CHECK(found >= 77);  // of 80
}

TEST_CASE("parallel edges have one vanishing point, few or none of them none") {
  const Camera camera = plain_camera();
  Random random(7);
  const Vec3<double> d = random_direction(random);
  LineScene scene;
  add_edges(scene, random, camera, d, 0, 25, 0.3);
  std::vector<InterpretationPlane> planes;
  interpretation_planes(camera, scene.segments, {}, planes);
  VanishingPointFinder finder;
  std::vector<VanishingPoint> points;
  finder.find(planes, points);
  REQUIRE(points.size() == 1);
  CHECK(angle_between(points[0].direction, d) < 1);
  CHECK(points[0].segments >= 24);
  for (const std::size_t count : {std::size_t{0}, std::size_t{1}}) {
    finder.find(std::span(planes).first(count), points);
    CHECK(points.empty());
  }
  // The same line many times fixes no direction.
  const std::vector<InterpretationPlane> same(10, planes[0]);
  finder.find(same, points);
  CHECK(points.empty());
}
