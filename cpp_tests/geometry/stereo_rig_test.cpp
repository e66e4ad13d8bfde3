// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/stereo_rig.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <string>
#include <vector>

#include "geometry/jacobian_check.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

struct Position {
  float x, y;
};

Vec3<double> random_vector(Random& random, double size) {
  return {random.uniform(-size, size), random.uniform(-size, size), random.uniform(-size, size)};
}

Camera kitti_camera() {
  return Camera({707.0912, 707.0912, 601.8873, 183.1104}, Distortion::none, {}, 1226, 370);
}

StereoRig kitti() {
  return StereoRig(kitti_camera(), kitti_camera(), SE3d(), SE3d(SO3d(), Vec3<double>(0.53715, 0, 0)));
}

/// The VI-Sensor of EuRoC: both cameras on their side, the baseline along the body's y axis.
StereoRig euroc() {
  Eigen::Matrix4d T_body_left, T_body_right;
  T_body_left << 0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975,  //
      0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768,                 //
      -0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949,             //
      0.0, 0.0, 0.0, 1.0;
  T_body_right << 0.0125552670891, -0.999755099723, 0.0182237714554, -0.0198435579556,  //
      0.999598781151, 0.0130119051815, 0.0251588363115, 0.0453689425024,                //
      -0.0253898008918, 0.0179005838253, 0.999517347078, 0.00786212447038,              //
      0.0, 0.0, 0.0, 1.0;
  return StereoRig(Camera({458.654, 457.296, 367.215, 248.375}, Distortion::radial_tangential,
                          {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05}, 752, 480),
                   Camera({457.587, 456.134, 379.999, 255.238}, Distortion::radial_tangential,
                          {-0.28368365, 0.07451284, -0.00010473, -3.55590700e-05}, 752, 480),
                   T_body_left, T_body_right);
}

/// Two wide fisheyes, toed in, of different size.
StereoRig fisheyes() {
  const SE3d T_body_left(SO3d::exp({0.02, 0.05, -0.01}), {0.1, 0.06, 0.2});
  const SE3d T_left_right(SO3d::exp({-0.03, -0.06, 0.02}), {0.12, 0.002, -0.004});
  return StereoRig(
      Camera({240, 241, 321.5, 243.2}, Distortion::equidistant, {-0.013, 0.021, -0.017, 0.004}, 640, 480),
      Camera({260, 259, 325.1, 258.8}, Distortion::equidistant, {0.01, -0.02, 0.005, 0}, 656, 520),
      T_body_left, T_body_left * T_left_right);
}

/// Pinholes, nearly but not quite rectified.
StereoRig nearly_rectified() {
  return StereoRig(kitti_camera(), kitti_camera(), SE3d(),
                   SE3d(SO3d::exp({1e-3, 0, -2e-3}), Vec3<double>(0.53715, 0.002, 0)));
}

struct NamedRig {
  std::string name;
  StereoRig rig;
};

const std::vector<NamedRig>& rigs() {
  static const std::vector<NamedRig> result = {{"KITTI", kitti()},
                                               {"EuRoC", euroc()},
                                               {"fisheyes", fisheyes()},
                                               {"nearly rectified", nearly_rectified()}};
  return result;
}

const Side kSides[] = {Side::left, Side::right};

std::string refusal(const Camera& left, const Camera& right, const SE3d& T_body_left,
                    const SE3d& T_body_right) {
  try {
    StereoRig(left, right, T_body_left, T_body_right);
  } catch (const Error& error) {
    CHECK(error.kind() == ErrorKind::calibration);
    return error.what();
  }
  return "accepted";
}

}  // namespace

TEST_CASE("corresponding points share a rectified row and their disparity gives the depth", "[stereo_rig]") {
  for (const auto& [name, rig] : rigs()) {
    INFO(name);
    Random random(1);
    int seen = 0;
    for (int i = 0; i < 2000; ++i) {
      const double z = random.uniform(0.3, 30);
      const Vec3<double> p_camera(random.uniform(-1, 1) * z, random.uniform(-0.7, 0.7) * z, z);
      const Vec3<double> p_body = rig.T_body_camera() * p_camera;
      Vec2<double> rectified[2];
      bool visible = true;
      for (const Side side : kSides) {
        const auto pixel = rig.camera(side).project(rig.T_body_raw(side).inverse() * p_body);
        visible = visible && pixel && rig.camera(side).contains(*pixel);
        if (!visible) break;
        const auto r = rig.rectify(side, *pixel);
        REQUIRE(r);
        rectified[static_cast<int>(side)] = *r;
      }
      if (!visible) continue;
      ++seen;
      const Vec2<double>&left = rectified[0], &right = rectified[1];
      REQUIRE(std::abs(left.y() - right.y()) < 1e-9);
      const double disparity = left.x() - right.x();
      REQUIRE(disparity == Approx(rig.focal() * rig.baseline() / z).epsilon(1e-9));
      REQUIRE(rig.depth_from_disparity(disparity) == Approx(z).epsilon(1e-8));
      const auto uvd = rig.project_stereo(p_camera);
      REQUIRE(uvd);
      REQUIRE((*uvd - Vec3<double>(left.x(), left.y(), disparity)).norm() < 1e-8);
      const auto point = rig.point_from_disparity(*uvd);
      REQUIRE(point);
      REQUIRE((*point - p_camera).norm() < 1e-9 * z);
    }
    CHECK(seen > 300);
  }
}

TEST_CASE("rectify and unrectify are inverses over both images", "[stereo_rig]") {
  for (const auto& [name, rig] : rigs()) {
    for (const Side side : kSides) {
      INFO(name << " side " << static_cast<int>(side));
      double worst = 0;
      int lost = 0, count = 0;
      for (double v = -0.5; v <= rig.camera(side).height(); v += 7.3) {
        for (double u = -0.5; u <= rig.camera(side).width(); u += 6.1) {
          ++count;
          const auto rectified = rig.rectify(side, {u, v});
          if (!rectified) {
            ++lost;
            continue;
          }
          const auto back = rig.unrectify(side, *rectified);
          REQUIRE(back);
          worst = std::max(worst, (*back - Vec2<double>(u, v)).norm());
        }
      }
      CHECK(worst < 1e-9);
      // Only the rim of the fisheyes sees more than 85 degrees off.
      CHECK(lost <= (name == "fisheyes" ? count / 5 : 0));
    }
  }
}

TEST_CASE("the fast ways agree with the exact ones everywhere in the image", "[stereo_rig]") {
  for (const auto& [name, rig] : rigs()) {
    for (const Side side : kSides) {
      INFO(name << " side " << static_cast<int>(side));
      std::vector<Position> pixels;
      const Camera& camera = rig.camera(side);
      for (float v = -0.5f; v <= camera.height() - 0.5f; v += 2.93f)
        for (float u = -0.5f; u <= camera.width() - 0.5f; u += 3.07f) pixels.push_back({u, v});
      pixels.push_back({-5, 3});  // outside the image, inside the model
      pixels.push_back({camera.width() + 3.f, camera.height() + 2.f});
      std::vector<Vec2<float>> rectified(pixels.size());
      std::vector<std::uint8_t> valid(pixels.size());
      const std::size_t good = rig.rectify(side, pixels, rectified, valid);
      double worst = 0, worst_relative = 0, worst_J = 0, worst_back = 0;
      std::size_t expected = 0;
      for (std::size_t i = 0; i < pixels.size(); ++i) {
        const Vec2<double> pixel(pixels[i].x, pixels[i].y);
        Eigen::Matrix2d J;
        const auto exact = rig.rectify(side, pixel, &J);
        REQUIRE(exact.has_value() == (valid[i] != 0));
        if (!exact) {
          REQUIRE(rectified[i] == Vec2<float>::Zero());
          continue;
        }
        ++expected;
        // Far out, where a fisheye's rectified coordinates run to thousands, a float ends at 1e-7 of them.
        const double error = (rectified[i].cast<double>() - *exact).norm();
        worst = std::max(worst, error);
        Eigen::Matrix2f J_fast;
        const auto one = rig.rectify_fast(side, pixel.cast<float>(), J_fast);
        REQUIRE(one);
        REQUIRE((*one - rectified[i]).norm() == 0);
        REQUIRE(*rig.rectify_fast(side, pixel.cast<float>()) == *one);
        worst_J = std::max(worst_J, (J_fast.cast<double>() - J).norm() / J.norm());
        if (exact->norm() > 2000) continue;
        Eigen::Matrix2f J_back;
        const auto back = rig.unrectify_fast(side, exact->cast<float>(), &J_back);
        REQUIRE(back);
        worst_back = std::max(worst_back, (back->cast<double>() - pixel).norm());
        worst_relative =
            std::max<double>(worst_relative, (J_back * J_fast - Eigen::Matrix2f::Identity()).norm());
      }
      CHECK(good == expected);
      CHECK(worst < 1e-3);
      CHECK(worst_J < 2e-3);
      CHECK(worst_back < 1e-3);
      CHECK(worst_relative < 5e-3);
      // Every rectified pixel of the image lies within the bounds, to the step in which these are walked.
      for (std::size_t i = 0; i + 2 < pixels.size(); ++i) {
        if (!valid[i] || name == "fisheyes") continue;
        REQUIRE(rectified[i].x() >= rig.bounds().u_min - 0.1);
        REQUIRE(rectified[i].x() <= rig.bounds().u_max + 0.1);
        REQUIRE(rectified[i].y() >= rig.bounds().v_min - 0.1);
        REQUIRE(rectified[i].y() <= rig.bounds().v_max + 0.1);
      }
    }
  }
}

TEST_CASE("rectification's Jacobians agree with central differences", "[stereo_rig]") {
  for (const auto& [name, rig] : rigs()) {
    INFO(name);
    Random random(9);
    for (const Side side : kSides) {
      for (int i = 0; i < 20; ++i) {
        const Vec2<double> pixel(random.uniform(100, rig.camera(side).width() - 100.0),
                                 random.uniform(100, rig.camera(side).height() - 100.0));
        Eigen::Matrix2d J, J_back;
        const auto rectified = rig.rectify(side, pixel, &J);
        REQUIRE(rectified);
        test::check_jacobian([&](const Vec2<double>& x) -> Vec2<double> { return *rig.rectify(side, x); },
                             pixel, J, 1e-8, 0.05);
        REQUIRE(rig.unrectify(side, *rectified, &J_back));
        test::check_jacobian([&](const Vec2<double>& x) -> Vec2<double> { return *rig.unrectify(side, x); },
                             *rectified, J_back, 1e-8, 0.05);
        CHECK((J * J_back - Eigen::Matrix2d::Identity()).norm() < 1e-10);
      }
    }
    for (int i = 0; i < 20; ++i) {
      const Vec3<double> p = random_vector(random, 2) + Vec3<double>(0, 0, 5);
      Mat3<double> J, J_back;
      const Vec3<double> uvd = *rig.project_stereo(p, &J);
      test::check_jacobian([&](const Vec3<double>& x) -> Vec3<double> { return *rig.project_stereo(x); }, p,
                           J);
      const auto point = rig.point_from_disparity(uvd, &J_back);
      REQUIRE(point);
      test::check_jacobian(
          [&](const Vec3<double>& x) -> Vec3<double> { return *rig.point_from_disparity(x); }, uvd, J_back,
          1e-8);
      CHECK((J * J_back - Mat3<double>::Identity()).norm() < 1e-10);
    }
  }
}

TEST_CASE("a rectified rig is left exactly as it is", "[stereo_rig]") {
  // Also when the body is somewhere else, which brings rounding into the relative motion.
  const SE3d T_body_left(SO3d::exp({0.3, -1.2, 0.5}), {0.1, 0.2, -0.3});
  const StereoRig moved(kitti_camera(), kitti_camera(), T_body_left,
                        T_body_left * SE3d(SO3d(), Vec3<double>(0.53715, 0, 0)));
  for (const StereoRig& rig : {kitti(), moved}) {
    REQUIRE(rig.is_rectified());
    CHECK(rig.focal() == 707.0912);
    CHECK(rig.center() == Vec2<double>(601.8873, 183.1104));
    CHECK(rig.baseline() == Approx(0.53715).epsilon(1e-14));
    Random random(2);
    for (const Side side : kSides) {
      CHECK(rig.R_camera_raw(side) == Mat3<double>::Identity());
      for (int i = 0; i < 100; ++i) {
        const Vec2<double> p(random.uniform(-0.5, 1225), random.uniform(-0.5, 369));
        CHECK(*rig.rectify(side, p) == p);
        CHECK(*rig.unrectify(side, p) == p);
        CHECK(*rig.rectify_fast(side, p.cast<float>()) == p.cast<float>());
        CHECK(*rig.unrectify_fast(side, p.cast<float>()) == p.cast<float>());
      }
    }
    CHECK((rig.T_body_camera().inverse() * rig.T_body_raw(Side::left)).log().norm() < 1e-15);
    CHECK(rig.bounds().u_min == -0.5);
    CHECK(rig.bounds().u_max == 1225.5);
    CHECK(rig.bounds().v_min == -0.5);
    CHECK(rig.bounds().v_max == 369.5);
  }
  CHECK_FALSE(nearly_rectified().is_rectified());
}

TEST_CASE("the rectified frame stands as it should", "[stereo_rig]") {
  for (const auto& [name, rig] : rigs()) {
    INFO(name);
    const SE3d T_camera_body = rig.T_body_camera().inverse();
    // x from the left to the right centre of projection
    CHECK((T_camera_body * rig.T_body_raw(Side::left).translation()).norm() < 1e-15);
    CHECK((T_camera_body * rig.T_body_raw(Side::right).translation() - Vec3<double>(rig.baseline(), 0, 0))
              .norm() < 1e-14);
    // z between both optical axes: neither to one side nor up or down
    const Vec3<double> sum = rig.R_camera_raw(Side::left).col(2) + rig.R_camera_raw(Side::right).col(2);
    CHECK(std::abs(sum.y()) < 1e-14);
    for (const Side side : kSides) {
      const SO3d R = T_camera_body.rotation() * rig.T_body_raw(side).rotation();
      CHECK((R.matrix() - rig.R_camera_raw(side)).norm() < 1e-13);
    }
    const SE3d T = rig.T_body_raw(Side::left) * rig.T_left_right();
    CHECK((T.inverse() * rig.T_body_raw(Side::right)).log().norm() < 1e-14);
    // The middles of both images fall, in the mean, on the middle of the rectified one.
    if (name == "KITTI") continue;
    Vec2<double> offset(0, 0);
    for (const Side side : kSides) {
      const Vec2<double> middle(0.5 * (rig.camera(side).width() - 1), 0.5 * (rig.camera(side).height() - 1));
      offset += *rig.rectify(side, middle) - middle;
    }
    CHECK(offset.norm() < 1e-9);
  }
  // The VI-Sensor's known figures.
  const StereoRig rig = euroc();
  CHECK(rig.baseline() == Approx(0.110078).margin(1e-6));
  CHECK(rig.focal() == Approx(457.418).margin(1e-3));
  CHECK(rig.table(Side::left).coverage() == 1);
  CHECK(rig.table(Side::right).coverage() == 1);
}

TEST_CASE("rectified positions agree with cv::undistortPoints", "[stereo_rig]") {
  const StereoRig rig = euroc();
  for (const Side side : kSides) {
    const Camera& camera = rig.camera(side);
    const cv::Mat K =
        (cv::Mat_<double>(3, 3) << camera.fx(), 0, camera.cx(), 0, camera.fy(), camera.cy(), 0, 0, 1);
    const cv::Mat P = (cv::Mat_<double>(3, 3) << rig.focal(), 0, rig.center().x(), 0, rig.focal(),
                       rig.center().y(), 0, 0, 1);
    cv::Mat R(3, 3, CV_64F);
    for (int i = 0; i < 9; ++i) R.at<double>(i / 3, i % 3) = rig.R_camera_raw(side)(i / 3, i % 3);
    std::vector<cv::Point2d> pixels, rectified;
    for (int v = 20; v < 460; v += 20)
      for (int u = 20; u < 730; u += 20) pixels.emplace_back(u, v);
    cv::undistortPoints(pixels, rectified, K, cv::Mat(camera.coefficients(), true), R, P,
                        cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 500, 1e-12));
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      const auto ours = rig.rectify(side, {pixels[i].x, pixels[i].y});
      REQUIRE(ours);
      CHECK((*ours - Vec2<double>(rectified[i].x, rectified[i].y)).norm() < 1e-6);
    }
  }
}

TEST_CASE("the covariance of a stereo point is that of drawn samples", "[stereo_rig]") {
  const StereoRig rig = kitti();
  const Vec3<double> uvd(800, 100, 25);
  const Mat3<double> covariance = rig.point_covariance(uvd, 0.5, 0.2);
  Random random(4);
  const int count = 40000;
  Vec3<double> mean = Vec3<double>::Zero();
  Mat3<double> second = Mat3<double>::Zero();
  const Vec3<double> p0 = *rig.point_from_disparity(uvd);
  for (int i = 0; i < count; ++i) {
    const Vec3<double> noise(0.5 * random.normal(), 0.5 * random.normal(), 0.2 * random.normal());
    const Vec3<double> d = *rig.point_from_disparity(Vec3<double>(uvd + noise)) - p0;
    mean += d / count;
    second += d * d.transpose() / count;
  }
  const Mat3<double> sampled = second - mean * mean.transpose();
  CHECK((sampled - covariance).norm() < 0.03 * covariance.norm());
  CHECK_THROWS_AS(rig.point_covariance({1, 1, 0}, 1, 1), Error);
}

TEST_CASE("what has no depth or no place is said", "[stereo_rig]") {
  const StereoRig rig = euroc();
  CHECK_FALSE(rig.point_from_disparity(Vec3<double>(10, 10, 0)));
  CHECK_FALSE(rig.point_from_disparity(Vec3<double>(10, 10, -1)));
  CHECK_FALSE(rig.point_from_disparity(Vec3<double>(10, 10, std::nan(""))));
  CHECK_FALSE(rig.project_stereo(Vec3<double>(0, 0, -1)));
  const double nan = std::nan("");
  CHECK_FALSE(rig.rectify(Side::left, {nan, 0}));
  CHECK_FALSE(rig.unrectify(Side::left, {0, nan}));
  CHECK_FALSE(rig.rectify_fast(Side::left, Vec2<float>(static_cast<float>(nan), 0)));
  CHECK_FALSE(rig.unrectify_fast(Side::left, Vec2<float>(0, static_cast<float>(nan))));
  CHECK_FALSE(rig.rectify_fast(Side::left, Vec2<float>(1e30f, 0)));
  CHECK_FALSE(rig.unrectify(Side::left, {1e9, 0}));
  const StereoRig flat = kitti();
  CHECK_FALSE(flat.rectify(Side::left, {nan, 0}));
  CHECK_FALSE(flat.unrectify(Side::left, {0, nan}));
  CHECK_FALSE(flat.rectify_fast(Side::left, Vec2<float>(static_cast<float>(nan), 0)));
  CHECK_FALSE(flat.unrectify_fast(Side::left, Vec2<float>(0, static_cast<float>(nan))));
  std::vector<Position> pixels(3);
  std::vector<Vec2<float>> rectified(2);
  std::vector<std::uint8_t> valid(3);
  CHECK_THROWS_AS(rig.rectify(Side::left, pixels, rectified, valid), Error);
}

TEST_CASE("a rig that cannot be is refused", "[stereo_rig]") {
  const Camera c = kitti_camera();
  const auto at = [](double x, double y, double z, const Vec3<double>& phi = Vec3<double>::Zero()) {
    return SE3d(SO3d::exp(phi), Vec3<double>(x, y, z));
  };
  using Catch::Matchers::Contains;
  CHECK_THAT(refusal(c, c, SE3d(), at(0, 0, 0)), Contains("baseline") && Contains("(got 0)"));
  CHECK_THAT(refusal(c, c, SE3d(), at(5e-5, 0, 0)), Contains("baseline"));
  CHECK_THAT(refusal(c, c, SE3d(), at(0, 0, 0.2)), Contains("along the viewing axis"));
  CHECK_THAT(refusal(c, c, SE3d(), at(-0.5, 0, 0)), Contains("left of the left") && Contains("(got -0.5)"));
  CHECK_THAT(refusal(c, c, SE3d(), at(0.5, 0, 0, {0, 1.2, 0})),
             Contains("60 degrees") && Contains("(got 68.7"));
  CHECK_THAT(refusal(c, c, SE3d(), at(0.5, 0, 0, {0, M_PI, 0})), Contains("60 degrees"));
  CHECK_THAT(refusal(c, c, SE3d(), at(std::nan(""), 0, 0)), Contains("finite"));
  CHECK(refusal(c, c, SE3d(), at(0.5, 0, 0, {0, 0.3, 0})) == "accepted");
  // One above the other: a pair on its side.
  CHECK(refusal(c, c, SE3d(), at(0, 0.2, 0)) == "accepted");

  const auto from_matrices = [&](const Eigen::Matrix4d& left, const Eigen::Matrix4d& right) -> std::string {
    try {
      StereoRig(c, c, left, right);
    } catch (const Error& error) {
      CHECK(error.kind() == ErrorKind::calibration);
      return error.what();
    }
    return "accepted";
  };
  const Eigen::Matrix4d I = Eigen::Matrix4d::Identity();
  Eigen::Matrix4d right = I;
  right(0, 3) = 0.5;
  CHECK(from_matrices(I, right) == "accepted");
  Eigen::Matrix4d bad = right;
  bad(0, 0) = 1.1;
  CHECK_THAT(from_matrices(I, bad), Contains("T_body_right") && Contains("not orthogonal"));
  CHECK_THAT(from_matrices(bad, right), Contains("T_body_left"));
  bad = right;
  bad(1, 1) = -1;
  CHECK_THAT(from_matrices(I, bad), Contains("mirrors"));
  bad = right;
  bad(3, 0) = 0.1;
  CHECK_THAT(from_matrices(I, bad), Contains("last row"));
  bad = right;
  bad(2, 1) = std::nan("");
  CHECK_THAT(from_matrices(I, bad), Contains("finite"));
  bad.setZero();
  CHECK_THAT(from_matrices(I, bad), Contains("last row"));
}
