// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/ground_plane_estimator.hpp"

#include <catch2/catch.hpp>
#include <string>

#include "floor/synthetic_floor.hpp"
#include "sweepkit/core/error.hpp"

namespace {

using namespace sweepkit;
using namespace sweepkit::test;

const GroundPlane kFloor = plane_of(3.0, 0.3, 0.081);

GroundPlaneSeed seed_of(const GroundPlane& plane) {
  return GroundPlaneSeed::from_height(plane.down_camera, plane.height);
}
double pitch_error(const GroundPlaneResult& r, const GroundPlane& truth) {
  return (pitch_down(r.plane) - pitch_down(truth)) / kDegree;
}
double roll_error(const GroundPlaneResult& r, const GroundPlane& truth) {
  return (roll(r.plane) - roll(truth)) / kDegree;
}
double height_error(const GroundPlaneResult& r, const GroundPlane& truth) {
  return 1e3 * (r.plane.height - truth.height);
}
void check_plane(const GroundPlaneResult& r, const GroundPlane& truth, double degrees, double millimetres) {
  CHECK(std::abs(pitch_error(r, truth)) < degrees);
  CHECK(std::abs(roll_error(r, truth)) < degrees);
  CHECK(std::abs(height_error(r, truth)) < millimetres);
}
FloorImage bare_floor() {
  FloorImage image;
  image.add_plane(kFloor);
  return image;
}
GroundPlaneEstimator settled() {
  GroundPlaneEstimator estimator(kFloorCamera, seed_of(kFloor));
  const FloorImage image = bare_floor();
  for (int i = 0; i < 20; ++i) REQUIRE(estimator.estimate(image.view()).measured());
  return estimator;
}
template <class Call>
std::string error_of(const Call& call) {
  try {
    call();
  } catch (const Error& error) {
    return error.what();
  }
  return "no error";
}

TEST_CASE("angles of a plane are those it was made of") {
  for (const double p : {-10.0, 0.0, 5.0})
    for (const double r : {-4.0, 0.0, 7.0}) {
      const GroundPlane plane = plane_of(p, r, 0.08);
      CHECK(pitch_down(plane) == Approx(p * kDegree).margin(1e-12));
      CHECK(roll(plane) == Approx(r * kDegree).margin(1e-12));
    }
}

TEST_CASE("a seed follows from the mounting on the base") {
  // x forward, y left, z up; the camera 12 cm ahead of the wheels looks 3 degrees down.
  Mat3<double> R_base_camera;
  R_base_camera << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  const SE3d T_base_camera(SO3d(R_base_camera) * SO3d::exp({-3.0 * kDegree, 0, 0}), {0.12, 0.01, 0.081});
  const GroundPlaneSeed seed = GroundPlaneSeed::from_base(T_base_camera);
  CHECK(pitch_down(seed.plane) == Approx(3.0 * kDegree));
  CHECK(seed.plane.height == Approx(0.081));
  CHECK(seed.plane.height_of(seed.wheels_camera) == Approx(0.0).margin(1e-12));
  CHECK((T_base_camera * seed.wheels_camera).norm() < 1e-12);
  CHECK_THROWS_AS(GroundPlaneSeed::from_base(SE3d(SO3d(), {0, 0, -0.1})), Error);
  CHECK_THROWS_AS(GroundPlaneSeed::from_height(Vec3<double>::Zero(), 0.1), Error);
  CHECK_THROWS_AS(GroundPlaneSeed::from_height(Vec3<double>::UnitY(), 0.0), Error);
}

TEST_CASE("a plane without noise is found wherever the seed permits it") {
  for (const double pitch : {-0.7, 0.0, 0.7})
    for (const double height : {-0.0015, 0.0015}) {
      const GroundPlane truth = plane_of(3.0 + pitch, 0.3 - pitch, 0.081 + height);
      FloorImage image;
      image.add_plane(truth);
      GroundPlaneEstimator estimator(kFloorCamera, seed_of(kFloor));
      GroundPlaneResult result;
      for (int i = 0; i < 20; ++i) result = estimator.estimate(image.view());
      CHECK(result.measured());
      CHECK(result.inliers > 2000);
      // A little of the difference is put down to a floor in view that is not the one under the wheels.
      check_plane(result, truth, 0.05, 0.5);
    }
}

TEST_CASE("with noise and outliers the error stays within its standard deviation") {
  for (const double outliers : {0.0, 0.2, 0.4}) {
    double squares = 0.0;
    constexpr int kRuns = 12;
    for (int run = 0; run < kRuns; ++run) {
      Random random(static_cast<std::uint64_t>(run + 1));
      const GroundPlane truth = plane_of(3.0 + random.normal(0.0, 0.4), 0.3 + random.normal(0.0, 0.4),
                                         0.081 + random.normal(0.0, 0.0008));
      FloorImage image;
      image.add_plane(truth);
      image.add_noise(random, 0.4, outliers);
      GroundPlaneEstimator estimator(kFloorCamera, seed_of(kFloor));
      const GroundPlaneResult result = estimator.estimate(image.view());
      REQUIRE(result.measured());
      const Vec3<double> error(pitch_error(result, truth) * kDegree, roll_error(result, truth) * kDegree,
                               height_error(result, truth) * 1e-3);
      CHECK(result.covariance.ldlt().isPositive());
      squares += error.dot(result.covariance.ldlt().solve(error)) / (3 * kRuns);
    }
    CHECK(squares < 1.5);
  }
}

TEST_CASE("the type and the stride of the disparities do not matter") {
  Random random(5);
  FloorImage image = bare_floor();
  image.add_noise(random, 0.4, 0.1);
  const std::vector<std::int16_t> fixed = image.fixed_point();
  constexpr int kStride = 700;
  std::vector<std::int16_t> padded(kStride * FloorImage::kHeight, 999);
  for (std::size_t i = 0; i < fixed.size(); ++i) {
    padded[i / 640 * kStride + i % 640] = fixed[i];
    image.disparity[i] = static_cast<float>(fixed[i]) / 16.0f;
  }
  GroundPlaneEstimator a(kFloorCamera, seed_of(kFloor)), b(kFloorCamera, seed_of(kFloor)),
      c(kFloorCamera, seed_of(kFloor));
  const auto ra = a.estimate(View2d<const std::int16_t>(fixed.data(), 640, 400));
  const auto rb = b.estimate(View2d<const std::int16_t>(padded.data(), 640, 400, kStride));
  const auto rc = c.estimate(image.view());
  REQUIRE(ra.measured());
  for (const auto& r : {rb, rc}) {
    CHECK(r.plane.down_camera == ra.plane.down_camera);
    CHECK(r.plane.height == ra.plane.height);
    CHECK(r.inliers == ra.inliers);
    CHECK(r.covariance == ra.covariance);
  }
}

TEST_CASE("a carpet ahead is not followed, however much of the view it fills") {
  for (const double near : {0.5, 0.3, 0.22, 0.0}) {
    GroundPlaneEstimator estimator = settled();
    GroundPlane carpet = kFloor;
    carpet.height -= 0.01;
    FloorImage image = bare_floor();
    image.add_plane(carpet, near);
    Random random(3);
    image.add_noise(random, 0.4, 0.0);
    GroundPlaneResult result;
    for (int i = 0; i < 5; ++i) result = estimator.estimate(image.view());
    INFO("carpet from " << near << " m on");
    check_plane(result, kFloor, 0.15, 1.0);
    if (near == 0.0) CHECK(result.state == GroundPlaneState::refused);
  }
}

TEST_CASE("on a carpet its top is the floor, not the lower floor beyond its edge") {
  GroundPlane lower = kFloor;
  lower.height += 0.01;
  for (const double far : {0.5, 0.3}) {
    GroundPlaneEstimator estimator = settled();
    FloorImage image;
    image.add_plane(kFloor, 0.0, far);
    image.add_plane(lower, far);
    Random random(3);
    image.add_noise(random, 0.4, 0.0);
    GroundPlaneResult result;
    for (int i = 0; i < 5; ++i) result = estimator.estimate(image.view());
    check_plane(result, kFloor, 0.15, 1.0);
  }
}

TEST_CASE("where no floor is seen the plane stays, and says so") {
  struct Case {
    std::string name;
    FloorImage image;
  };
  std::vector<Case> cases(6);
  cases[0].name = "nothing";
  cases[1].name = "a wall";
  cases[1].image.add_wall(0.3);
  cases[2].name = "a wall so near that all is beyond the range";
  for (float& d : cases[2].image.disparity) d = -1.0f;
  cases[3].name = "not a number";
  for (float& d : cases[3].image.disparity) d = std::numeric_limits<float>::quiet_NaN();
  cases[4].name = "infinite";
  for (float& d : cases[4].image.disparity) d = std::numeric_limits<float>::infinity();
  cases[5].name = "a wall behind noise";
  Random random(7);
  cases[5].image.add_wall(0.5);
  cases[5].image.add_noise(random, 0.5, 0.3);
  for (const Case& c : cases) {
    INFO(c.name);
    GroundPlaneEstimator estimator(kFloorCamera, seed_of(kFloor));
    const GroundPlaneResult result = estimator.estimate(c.image.view());
    CHECK(result.state == GroundPlaneState::predicted);
    CHECK(result.reason != GroundPlaneReason::none);
    check_plane(result, kFloor, 1e-9, 1e-9);
    GroundPlaneEstimator knowing = settled();
    CHECK(knowing.estimate(c.image.view()).state == GroundPlaneState::predicted);
    check_plane(knowing.estimate(c.image.view()), kFloor, 0.05, 0.1);
  }
  GroundPlaneEstimator estimator(kFloorCamera, seed_of(kFloor));
  CHECK(estimator.estimate(View2d<const float>()).reason == GroundPlaneReason::no_disparity);
}

TEST_CASE("random disparities are no floor") {
  Random random(11);
  FloorImage image;
  image.add_noise(random, 0.0, 1.0);
  GroundPlaneEstimator estimator(kFloorCamera, seed_of(kFloor));
  CHECK_FALSE(estimator.estimate(image.view()).measured());
}

TEST_CASE("holes in the disparities cost pixels, not accuracy") {
  Random random(13);
  FloorImage image = bare_floor();
  for (float& d : image.disparity)
    if (random.uniform() < 0.8) d = -1.0f;
  GroundPlaneEstimator estimator(kFloorCamera, seed_of(kFloor));
  const GroundPlaneResult result = estimator.estimate(image.view());
  CHECK(result.measured());
  CHECK(result.pixels < 1000);
  check_plane(result, kFloor, 0.02, 0.1);
}

TEST_CASE("a tilt that motion tells is followed, another is refused") {
  // The nose rises by 3 degrees about the wheels.
  const SO3d R_now_before = SO3d::exp({3.0 * kDegree, 0, 0});
  const GroundPlaneSeed seed = seed_of(kFloor);
  GroundPlane tilted;
  tilted.down_camera = R_now_before * kFloor.down_camera;
  tilted.height = kFloor.height + (tilted.down_camera - kFloor.down_camera).dot(seed.wheels_camera);
  FloorImage image;
  image.add_plane(tilted);

  GroundPlaneEstimator blind = settled();
  const GroundPlaneResult refused = blind.estimate(image.view());
  CHECK(refused.state == GroundPlaneState::refused);
  check_plane(refused, kFloor, 0.05, 0.1);

  GroundPlaneStep step;
  step.motion.emplace();
  step.motion->T_now_before = SE3d(R_now_before, Vec3<double>::Zero());
  step.motion->covariance.bottomRightCorner<3, 3>() *= 1e-6;
  GroundPlaneEstimator told = settled();
  GroundPlaneResult result = told.estimate(image.view(), step);
  CHECK(result.measured());
  check_plane(result, tilted, 0.05, 0.3);
  // In the dark, too, and back on one surface.
  GroundPlaneEstimator dark = settled();
  check_plane(dark.estimate(View2d<const float>(), step), tilted, 0.1, 0.3);
  step.motion->T_now_before = step.motion->T_now_before.inverse();
  check_plane(dark.estimate(View2d<const float>(), step), kFloor, 0.1, 0.3);
}

TEST_CASE("turning on the spot does not move the plane") {
  GroundPlaneEstimator estimator = settled();
  GroundPlaneStep step;
  step.motion.emplace();
  step.motion->T_now_before = SE3d(SO3d::exp(0.2 * kFloor.down_camera), {0.02, 0.0, -0.01});
  step.motion->covariance.bottomRightCorner<3, 3>() *= 1e-8;
  for (int i = 0; i < 30; ++i)
    check_plane(estimator.estimate(View2d<const float>(), step), kFloor, 0.05, 0.1);
}

TEST_CASE("the vertical tells pitch and roll where nothing is seen") {
  GroundPlaneOptions options;
  options.floor_slope = 0.01;
  GroundPlaneEstimator estimator(kFloorCamera, seed_of(kFloor), options);
  const GroundPlane truth = plane_of(3.4, 0.0, 0.081);
  GroundPlaneStep step;
  step.vertical = {truth.down_camera, 1e-4};
  const GroundPlaneResult result = estimator.estimate(View2d<const float>(), step);
  CHECK(std::abs(pitch_error(result, truth)) < 0.02);
  CHECK(std::abs(roll_error(result, truth)) < 0.02);
  CHECK(std::sqrt(result.covariance(0, 0)) < 0.02 * kDegree);
}

TEST_CASE("a robot that is lifted has no floor") {
  GroundPlaneEstimator estimator = settled();
  GroundPlaneStep step;
  step.motion.emplace();
  step.motion->T_now_before = SE3d(SO3d(), 0.02 * kFloor.down_camera);  // points sink as the camera rises
  step.motion->covariance *= 1e-8;
  GroundPlaneResult result;
  for (int i = 1; i <= 5; ++i) {
    GroundPlane below = kFloor;
    below.height += 0.02 * i;
    FloorImage image;
    image.add_plane(below);
    result = estimator.estimate(image.view(), step);
    CHECK_FALSE(result.measured());
  }
  CHECK(result.reason == GroundPlaneReason::lifted);
  check_plane(result, kFloor, 0.1, 1.0);
  // Put down again, the floor is seen where it was.
  CHECK(estimator.estimate(bare_floor().view()).measured());
}

TEST_CASE("a mounting learned wrongly gives way to the floor seen for longer") {
  // From a low carpet only the lower floor beyond it is in view, then the floor itself.
  GroundPlane lower = kFloor;
  lower.height += 0.004;
  FloorImage first, then = bare_floor();
  first.add_plane(lower);
  GroundPlaneOptions options;
  options.mounting_height = 0.002;
  GroundPlaneEstimator estimator(kFloorCamera, seed_of(kFloor), options);
  for (int i = 0; i < 20; ++i) estimator.estimate(first.view());
  GroundPlaneResult result;
  for (int i = 0; i < 60; ++i) result = estimator.estimate(then.view());
  CHECK(result.measured());
  check_plane(result, kFloor, 0.1, 1.5);
  CHECK(std::abs(estimator.mounting().height - kFloor.height) < 0.0015);
  estimator.reset();
  CHECK(estimator.mounting().height == Approx(kFloor.height));
}

TEST_CASE("put down with a tilt that motion told wrongly, the robot finds the floor again") {
  GroundPlaneEstimator estimator = settled();
  GroundPlaneStep step;
  step.motion.emplace();
  step.motion->covariance = 1e-8 * Mat6<double>::Identity();
  step.motion->covariance.topLeftCorner<3, 3>() = Mat3<double>::Identity();  // a gyro alone
  step.motion->T_now_before = SE3d(SO3d::exp({-8.0 * kDegree, 0, 0}), Vec3<double>::Zero());
  CHECK_FALSE(estimator.estimate(View2d<const float>(), step).measured());
  step.motion->T_now_before = SE3d();
  const FloorImage floor = bare_floor();
  GroundPlaneResult result;
  for (int i = 0; i < 12; ++i) {
    result = estimator.estimate(floor.view(), step);
    // Nothing is believed at once: the robot may tilt and see a wall.
    if (i < 5) CHECK_FALSE(result.measured());
  }
  CHECK(result.measured());
  check_plane(result, kFloor, 0.1, 0.5);
}

TEST_CASE("of two floors the one that calibration expects is believed sooner") {
  const auto floor_at = [](double height) {
    GroundPlane plane = kFloor;
    plane.height += height;
    FloorImage image;
    image.add_plane(plane);
    return image;
  };
  SECTION("seen second, it needs less time than the first had") {
    GroundPlane expected = kFloor;
    expected.height += 0.0015;
    GroundPlaneEstimator estimator(kFloorCamera, seed_of(expected));
    const FloorImage lower = floor_at(0.0055), floor = bare_floor();
    for (int i = 0; i < 40; ++i) estimator.estimate(lower.view());
    CHECK(estimator.mounting().height > kFloor.height + 0.003);
    for (int i = 0; i < 15; ++i) estimator.estimate(floor.view());
    const GroundPlaneResult result = estimator.estimate(floor.view());
    CHECK(result.measured());
    check_plane(result, kFloor, 0.1, 1.0);
  }
  SECTION("seen first, it outlasts a carpet that fills the view for longer") {
    GroundPlaneEstimator estimator = settled();
    const FloorImage carpet = floor_at(-0.004);
    GroundPlaneResult result;
    for (int i = 0; i < 60; ++i) result = estimator.estimate(carpet.view());
    CHECK(result.state == GroundPlaneState::refused);
    check_plane(result, kFloor, 0.1, 0.5);
  }
}

TEST_CASE("wrong use is named") {
  const GroundPlaneSeed seed = seed_of(kFloor);
  GroundPlaneOptions options;
  options.step_u = 0;
  CHECK_THAT(error_of([&] { GroundPlaneEstimator(kFloorCamera, seed, options); }), Catch::Contains("step_u"));
  CHECK_THAT(error_of([&] { GroundPlaneEstimator(RectifiedCamera{}, seed); }), Catch::Contains("camera"));
  CHECK_THAT(error_of([&] { GroundPlaneEstimator(kFloorCamera, GroundPlaneSeed{}); }),
             Catch::Contains("seed"));
  GroundPlaneEstimator estimator(kFloorCamera, seed);
  GroundPlaneStep step;
  step.seconds = 0.0;
  CHECK_THAT(error_of([&] { estimator.estimate(View2d<const float>(), step); }),
             Catch::Contains("step.seconds"));
  step.seconds = 0.1;
  step.motion.emplace();
  step.motion->covariance(0, 0) = std::numeric_limits<double>::quiet_NaN();
  CHECK_THAT(error_of([&] { estimator.estimate(View2d<const float>(), step); }),
             Catch::Contains("step.motion"));
  step.motion.reset();
  step.vertical = {Vec3<double>::Zero(), 0.1};
  CHECK_THAT(error_of([&] { estimator.estimate(View2d<const float>(), step); }),
             Catch::Contains("step.vertical"));
}

}  // namespace
