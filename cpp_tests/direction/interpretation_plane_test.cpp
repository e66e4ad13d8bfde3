// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/direction/interpretation_plane.hpp"

#include <catch2/catch.hpp>
#include <limits>

#include "line_scene.hpp"

using namespace sweepkit;
using namespace sweepkit::test;

TEST_CASE("a plane holds both ends of its segment and the direction of its edge") {
  Random random(1);
  for (const Camera& camera : {plain_camera(), bent_camera()}) {
    const SO3d R = random_rotation(random);
    const LineScene scene = line_scene(3, camera, R, {20, 20, 20}, 0, 0.0);
    std::vector<InterpretationPlane> planes;
    interpretation_planes(camera, scene.segments, {}, planes);
    REQUIRE(planes.size() == scene.segments.size());
    for (const InterpretationPlane& p : planes) {
      const LineSegment& s = scene.segments[p.segment];
      CHECK(p.normal.norm() == Approx(1));
      CHECK((p.middle.cross(p.along) - p.normal).norm() < 1e-12);
      CHECK(std::abs(p.normal.dot(camera.unproject(Vec2<double>(s.x1, s.y1))->normalized())) < 1e-12);
      CHECK(std::abs(p.normal.dot(camera.unproject(Vec2<double>(s.x2, s.y2))->normalized())) < 1e-12);
      CHECK(std::abs(p.normal.dot(R.matrix().col(scene.axis[p.segment]))) < 1e-4);
    }
  }
}

TEST_CASE("the variance of a plane is that of its end points") {
  const Camera camera = plain_camera();
  SegmentTrustOptions options;
  options.endpoint_sigma = 0.5;
  Random random(5);
  for (const LineSegment& s :
       {LineSegment{250, 150, 330, 190}, LineSegment{20, 30, 60, 300}, LineSegment{500, 350, 530, 350}}) {
    std::vector<InterpretationPlane> planes;
    interpretation_planes(camera, std::span(&s, 1), options, planes);
    const InterpretationPlane exact = planes.at(0);
    for (const Vec3<double>& d :
         {exact.along, exact.middle, Vec3<double>((exact.along + exact.middle).normalized())}) {
      double squares = 0;
      constexpr int kTrials = 4000;
      for (int k = 0; k < kTrials; ++k) {
        LineSegment noisy = s;
        // Across the segment and along it: only the former matters.
        noisy.x1 += static_cast<float>(random.normal(0, 0.5));
        noisy.y1 += static_cast<float>(random.normal(0, 0.5));
        noisy.x2 += static_cast<float>(random.normal(0, 0.5));
        noisy.y2 += static_cast<float>(random.normal(0, 0.5));
        interpretation_planes(camera, std::span(&noisy, 1), options, planes);
        squares += std::pow(planes.at(0).normal.dot(d), 2);
      }
      // To first order, and with one scale of pixel to ray for the whole image.
      CHECK(std::sqrt(exact.variance(d)) == Approx(std::sqrt(squares / kTrials)).epsilon(0.25));
    }
  }
}

TEST_CASE("segments that tell nothing are left out, and of many the longest stay") {
  const Camera camera = plain_camera();
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN(),
                  kInf = std::numeric_limits<float>::infinity();
  const std::vector<LineSegment> segments{{10, 10, 12, 10},  {kNan, 10, 100, 10}, {10, 10, 60, 10},
                                          {10, kInf, 80, 9}, {50, 50, 50, 50},    {10, 20, 10, 120}};
  std::vector<InterpretationPlane> planes;
  interpretation_planes(camera, segments, {}, planes);
  REQUIRE(planes.size() == 2);
  CHECK(planes[0].segment == 2);
  CHECK(planes[1].segment == 5);
  interpretation_planes(camera, {}, {}, planes);
  CHECK(planes.empty());

  SegmentTrustOptions few;
  few.max_segments = 3;
  std::vector<LineSegment> many;
  for (int i = 0; i < 20; ++i) many.push_back({10, 10.0f + 5 * i, 100.0f + i, 10.0f + 5 * i});
  interpretation_planes(camera, many, few, planes);
  REQUIRE(planes.size() == 3);
  CHECK(planes[0].segment == 17);
}
