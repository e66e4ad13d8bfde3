// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/direction/manhattan_frame.hpp"

#include <algorithm>
#include <array>
#include <catch2/catch.hpp>

#include "line_scene.hpp"
#include "sweepkit/core/error.hpp"

using namespace sweepkit;
using namespace sweepkit::test;

namespace {

std::vector<SO3d> cube_group() {
  std::vector<SO3d> group;
  int order[3] = {0, 1, 2};
  do {
    for (int signs = 0; signs < 8; ++signs) {
      Mat3<double> M = Mat3<double>::Zero();
      for (int k = 0; k < 3; ++k) M(order[k], k) = signs >> k & 1 ? -1 : 1;
      if (M.determinant() > 0) group.emplace_back(M);
    }
  } while (std::next_permutation(order, order + 3));
  return group;
}

std::vector<InterpretationPlane> planes_of(const Camera& camera, const LineScene& scene) {
  std::vector<InterpretationPlane> planes;
  interpretation_planes(camera, scene.segments, {}, planes);
  return planes;
}

}  // namespace

TEST_CASE("the distance of two frames is the least over the 24 turns of a cube") {
  const auto group = cube_group();
  REQUIRE(group.size() == 24);
  Random random(1);
  for (int k = 0; k < 200; ++k) {
    const SO3d a = random_rotation(random), b = random_rotation(random);
    double least = 10;
    for (const SO3d& g : group) least = std::min(least, (a.inverse() * b * g).angle());
    CHECK(manhattan_distance(a, b) == Approx(least).margin(1e-7));
    CHECK(manhattan_distance(a, a * group[k % 24]) < 1e-6);
  }
}

TEST_CASE("a frame is found among up to 70 % of segments that run anywhere") {
  const Camera camera = bent_camera();
  ManhattanEstimator estimator;
  for (const auto& [counts, outliers, most_wrong] :
       {std::tuple(std::array{20, 20, 20}, 0, 0), std::tuple(std::array{40, 30, 20}, 90, 0),
        std::tuple(std::array{30, 30, 30}, 210, 1)}) {
    int wrong = 0;
    double sum = 0;
    for (int seed = 0; seed < 40; ++seed) {
      Random random(1000 + seed);
      const SO3d R = random_rotation(random);
      const LineScene scene = line_scene(seed, camera, R, counts, outliers);
      const auto frame = estimator.estimate(planes_of(camera, scene));
      REQUIRE(frame);
      const double error = manhattan_distance(frame->R_camera_manhattan, R) / kDegree;
      wrong += error > 2;
      sum += std::min(error, 2.0);
      CHECK(estimator.labels().size() == scene.segments.size());
    }
    INFO(outliers);
    CHECK(wrong <= most_wrong);
    CHECK(sum / 40 < 0.4);
  }
}

TEST_CASE("with a known up direction one edge fixes the frame, and outliers matter less") {
  const Camera camera = plain_camera();
  ManhattanEstimator estimator;
  Random random(3);
  const SO3d R = SO3d::exp(Vec3<double>(0.1, 0.5, -0.05));
  const Vec3<double> up = -R.matrix().col(1);
  LineScene one;
  add_edges(one, random, camera, R.matrix().col(0), 0, 1, 0.0);
  auto frame = estimator.estimate(planes_of(camera, one), up);
  REQUIRE(frame);
  CHECK(manhattan_distance(frame->R_camera_manhattan, R) < 0.1 * kDegree);
  CHECK((frame->R_camera_manhattan.matrix().col(1) + up).norm() < 1e-9);

  int wrong = 0;
  for (int seed = 0; seed < 60; ++seed) {
    const SO3d turned = SO3d::exp(Vec3<double>(0.05, random.uniform(-1.5, 1.5), 0.03));
    const LineScene scene = line_scene(seed, camera, turned, {15, 15, 15}, 105);
    frame = estimator.estimate(planes_of(camera, scene), -turned.matrix().col(1) * 9.81);
    REQUIRE(frame);
    wrong += manhattan_distance(frame->R_camera_manhattan, turned) > 2 * kDegree;
  }
  CHECK(wrong <= 3);
}

TEST_CASE("the frame that is given looks along the camera") {
  const Camera camera = plain_camera();
  ManhattanEstimator estimator;
  Random random(4);
  for (int k = 0; k < 10; ++k) {
    const SO3d R = random_rotation(random);
    const auto frame = estimator.estimate(planes_of(camera, line_scene(k, camera, R, {25, 25, 25}, 10)));
    REQUIRE(frame);
    const Mat3<double> D = frame->R_camera_manhattan.matrix();
    CHECK(D.determinant() == Approx(1));
    CHECK(D(1, 1) >= std::max(std::abs(D(1, 0)), std::abs(D(1, 2))));
    CHECK(D(2, 2) >= std::abs(D(2, 0)));
    const double all = frame->support[0] + frame->support[1] + frame->support[2];
    CHECK(all > 40);
    CHECK(frame->share == Approx(all / frame->segments).epsilon(0.5));
    CHECK(frame->share <= 1);
  }
  // A camera that looks along a wall, level.
  const auto frame = estimator.estimate(planes_of(camera, line_scene(9, camera, SO3d(), {25, 25, 25}, 0)));
  REQUIRE(frame);
  CHECK(frame->R_camera_manhattan.angle() < 0.5 * kDegree);
}

TEST_CASE("segments are labelled with the column that they run along") {
  const Camera camera = plain_camera();
  ManhattanEstimator estimator;
  const LineScene scene =
      line_scene(2, camera, SO3d::exp(Vec3<double>(0.05, 0.3, 0.02)), {30, 30, 30}, 0, 0.3);
  const auto planes = planes_of(camera, scene);
  for (const bool with_up : {false, true}) {
    const auto frame =
        with_up ? estimator.estimate(planes, -SO3d::exp(Vec3<double>(0.05, 0.3, 0.02)).matrix().col(1))
                : estimator.estimate(planes);
    REQUIRE(frame);
    int right = 0;
    for (std::size_t i = 0; i < planes.size(); ++i) right += estimator.labels()[i] == scene.axis[i];
    CHECK(right >= 80);  // of 90: a segment may lie in two planes
  }
}

TEST_CASE("the covariance tells the spread of the error") {
  const Camera camera = plain_camera();
  ManhattanOptions options;
  options.segments.endpoint_sigma = 0.5;
  options.segments.model_sigma = 0.05;
  ManhattanEstimator estimator(options);
  double sum = 0;
  constexpr int kTrials = 100;
  for (int seed = 0; seed < kTrials; ++seed) {
    Random random(seed);
    const SO3d R = random_rotation(random);
    const LineScene scene = line_scene(seed, camera, R, {20, 20, 20}, 0, 0.5);
    const auto frame = estimator.estimate(planes_of(camera, scene));
    REQUIRE(frame);
    SO3d nearest = R;
    for (const SO3d& g : cube_group())
      if ((frame->R_camera_manhattan * (R * g).inverse()).angle() <
          (frame->R_camera_manhattan * nearest.inverse()).angle())
        nearest = R * g;
    const Vec3<double> error = (nearest * frame->R_camera_manhattan.inverse()).log();
    sum += std::min(error.dot(frame->covariance.inverse() * error), 30.0);
  }
  // Three degrees of freedom.
  CHECK(sum / kTrials > 1.2);
  CHECK(sum / kTrials < 6);
}

TEST_CASE("the same planes give the same frame, and the seed changes it little") {
  const Camera camera = plain_camera();
  const LineScene scene = line_scene(5, camera, SO3d::exp(Vec3<double>(0.2, 0.3, 0.1)), {30, 20, 20}, 60);
  const auto planes = planes_of(camera, scene);
  ManhattanEstimator first, second;
  first.estimate(planes_of(camera, line_scene(6, camera, SO3d(), {10, 10, 10}, 5)));
  const auto a = first.estimate(planes), b = second.estimate(planes);
  REQUIRE((a && b));
  CHECK(a->R_camera_manhattan.matrix() == b->R_camera_manhattan.matrix());
  CHECK(a->confidence == b->confidence);
  ManhattanOptions options;
  options.seed = 77;
  ManhattanEstimator third(options);
  const auto c = third.estimate(planes);
  REQUIRE(c);
  CHECK(manhattan_distance(a->R_camera_manhattan, c->R_camera_manhattan) < 0.05 * kDegree);
}

TEST_CASE("of frames given with a confidence about that share is right") {
  const Camera camera = bent_camera();
  ManhattanEstimator estimator;
  const double tolerance = estimator.options().tolerance * kDegree;
  for (const bool with_up : {false, true}) {
    std::array<int, 4> count{}, right{};
    std::array<double, 4> claimed{};
    Random random(99);
    for (int k = 0; k < 1500; ++k) {
      const SO3d R = SO3d::exp(Vec3<double>(random.uniform(-0.3, 0.3), random.uniform(-2, 2), 0.1));
      std::array<int, 3> counts{};
      for (std::uint64_t i = random.index(40); i > 0; --i) ++counts[random.index(3)];
      const auto planes =
          planes_of(camera, line_scene(random(), camera, R, counts, static_cast<int>(random.index(80)), 0.6));
      const auto frame =
          with_up ? estimator.estimate(planes, -R.matrix().col(1)) : estimator.estimate(planes);
      if (!frame) continue;
      CHECK(frame->confidence >= 0);
      CHECK(frame->confidence <= 1);
      const int bin = frame->confidence < 0.3    ? 0
                      : frame->confidence < 0.7  ? 1
                      : frame->confidence < 0.95 ? 2
                                                 : 3;
      ++count[bin];
      claimed[bin] += frame->confidence;
      right[bin] += manhattan_distance(frame->R_camera_manhattan, R) < tolerance;
    }
    for (int bin = 0; bin < 4; ++bin) {
      INFO("bin " << bin << " up " << with_up << ": " << right[bin] << " of " << count[bin] << ", claimed "
                  << claimed[bin]);
      REQUIRE(count[bin] > 20);
      CHECK(std::abs(right[bin] - claimed[bin]) < 0.2 * count[bin]);
    }
    CHECK(right[3] > 0.95 * count[3]);
  }
}

TEST_CASE("too few or parallel segments give no frame or one without confidence") {
  const Camera camera = plain_camera();
  ManhattanEstimator estimator;
  Random random(8);
  CHECK_FALSE(estimator.estimate({}));
  CHECK_FALSE(estimator.estimate({}, Vec3<double>::UnitX()));
  LineScene parallel;
  add_edges(parallel, random, camera, Vec3<double>(1, 0.2, 0.3).normalized(), 0, 30, 0.3);
  const auto planes = planes_of(camera, parallel);
  CHECK_FALSE(estimator.estimate(std::span(planes).first(1)));
  CHECK_FALSE(estimator.estimate(std::span(planes).first(2)));
  if (const auto frame = estimator.estimate(planes)) CHECK(frame->confidence < 0.5);
  // Verticals alone tell nothing of the angle about the vertical.
  LineScene vertical;
  add_edges(vertical, random, camera, Vec3<double>::UnitY(), 1, 30, 0.3);
  CHECK_FALSE(estimator.estimate(planes_of(camera, vertical), -Vec3<double>::UnitY()));
  CHECK_THROWS_AS(estimator.estimate(planes, Vec3<double>::Zero()), Error);
  CHECK_THROWS_AS(estimator.estimate(planes, Vec3<double>::Constant(std::nan(""))), Error);
  ManhattanOptions wrong;
  wrong.hypotheses = 0;
  CHECK_THROWS_AS(ManhattanEstimator(wrong), Error);
}
