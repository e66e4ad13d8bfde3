// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/camera.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <string>
#include <vector>

#include "ceres/jet.h"
#include "geometry/jacobian_check.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

struct NamedCamera {
  std::string name;
  Camera camera;
};

/// Cameras whose whole image lies in the domain of their model.
const std::vector<NamedCamera>& cameras() {
  static const std::vector<NamedCamera> result = {
      {"pinhole", Camera({700, 690, 601.9, 183.1}, Distortion::none, {}, 1226, 370)},
      // EuRoC cam0
      {"radial-tangential, 4", Camera({458.654, 457.296, 367.215, 248.375}, Distortion::radial_tangential,
                                      {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05}, 752, 480)},
      {"radial-tangential, 5", Camera({520, 525, 325.1, 249.7}, Distortion::radial_tangential,
                                      {0.23, -0.78, -0.0033, -0.0011, 0.92}, 640, 480)},
      // wide, the corners at 75 degrees
      {"equidistant",
       Camera({285, 286, 320.5, 241.2}, Distortion::equidistant, {-0.013, 0.021, -0.017, 0.004}, 640, 480)},
      {"equidistant, no bending",
       Camera({300, 300, 320, 240}, Distortion::equidistant, {0, 0, 0, 0}, 640, 480)},
  };
  return result;
}

/// Rays all over the image and well beyond it, within the domain, at different depths.
std::vector<Vec3<double>> points(const Camera& camera) {
  std::vector<Vec3<double>> result = {Vec3<double>(0, 0, 1), Vec3<double>(1e-9, -2e-9, 3),
                                      Vec3<double>(1e-3, 0, 1), Vec3<double>(0, 1.0001e-3, 1)};
  Random random(3);
  const double radius = std::min(1.2, 0.99 * camera.max_radius());
  for (int i = 0; i < 60; ++i) {
    const double r = radius * std::sqrt(random.uniform()), a = random.uniform(0, 2 * M_PI);
    result.push_back(random.uniform(0.2, 20) * Vec3<double>(r * std::cos(a), r * std::sin(a), 1));
  }
  return result;
}

cv::Mat K_of(const Camera& c) {
  return (cv::Mat_<double>(3, 3) << c.fx(), 0, c.cx(), 0, c.fy(), c.cy(), 0, 0, 1);
}

Error error_of(const std::vector<double>& intrinsics, Distortion distortion,
               const std::vector<double>& coefficients, int width = 640, int height = 480) {
  try {
    Camera(intrinsics, distortion, coefficients, width, height);
  } catch (const Error& error) {
    return error;
  }
  FAIL("no error");
  throw;
}

}  // namespace

TEST_CASE("unproject and project are inverses over the whole image", "[camera]") {
  for (const auto& [name, camera] : cameras()) {
    INFO(name);
    double worst = 0;
    for (double v = -0.5; v <= camera.height(); v += 5.7) {
      for (double u = -0.5; u <= camera.width(); u += 6.1) {
        const Vec2<double> pixel(u, v);
        const auto ray = camera.unproject(pixel);
        REQUIRE(ray);
        REQUIRE(ray->z() == 1);
        const auto back = camera.project(*ray * 3.7);
        REQUIRE(back);
        worst = std::max(worst, (*back - pixel).norm());
      }
    }
    CHECK(worst < 1e-9);
    for (const Vec3<double>& p : points(camera)) {
      const auto pixel = camera.project(p);
      REQUIRE(pixel);
      const auto ray = camera.unproject(*pixel);
      REQUIRE(ray);
      CHECK((*ray * p.z() - p).norm() < 1e-10 * p.norm());
    }
  }
}

TEST_CASE("camera Jacobians agree with central differences", "[camera]") {
  for (const auto& [name, camera] : cameras()) {
    INFO(name);
    for (const Vec3<double>& p : points(camera)) {
      Eigen::Matrix<double, 2, 3> J_p;
      const auto pixel = camera.project(p, &J_p);
      REQUIRE(pixel);
      test::check_jacobian([&](const Vec3<double>& x) -> Vec2<double> { return *camera.project(x); }, p, J_p,
                           1e-7, 1e-4 * p.z());
      Eigen::Matrix<double, 3, 2> J_pixel;
      REQUIRE(camera.unproject(*pixel, &J_pixel));
      if (!camera.contains(*pixel, 2)) continue;
      test::check_jacobian([&](const Vec2<double>& x) -> Vec3<double> { return *camera.unproject(x); },
                           *pixel, J_pixel, 1e-8, 0.1);
    }
  }
}

TEST_CASE("projection works on float and on ceres::Jet", "[camera]") {
  using Jet = ceres::Jet<double, 3>;
  for (const auto& [name, camera] : cameras()) {
    INFO(name);
    for (const Vec3<double>& p : points(camera)) {
      Eigen::Matrix<double, 2, 3> J;
      const Vec2<double> pixel = *camera.project(p, &J);
      Vec3<Jet> p_jet;
      for (int i = 0; i < 3; ++i) p_jet[i] = Jet(p[i], i);
      const auto jet = camera.project<Jet>(p_jet);
      REQUIRE(jet);
      for (int i = 0; i < 2; ++i) {
        CHECK(std::abs((*jet)[i].a - pixel[i]) < 1e-11);
        CHECK(((*jet)[i].v.transpose() - J.row(i)).norm() < 1e-10 * (1 + J.norm()));
      }
      Eigen::Matrix<float, 2, 3> J_float;
      const auto single = camera.project<float>(p.cast<float>(), &J_float);
      REQUIRE(single);
      CHECK((single->cast<double>() - pixel).norm() < 1e-3);
      CHECK((J_float.cast<double>() - J).norm() < 1e-4 * (1 + J.norm()));
    }
  }
}

TEST_CASE("projection agrees with OpenCV", "[camera]") {
  for (const auto& [name, camera] : cameras()) {
    INFO(name);
    std::vector<cv::Point3d> object;
    for (const Vec3<double>& p : points(camera)) object.emplace_back(p.x(), p.y(), p.z());
    std::vector<cv::Point2d> image;
    const cv::Vec3d zero(0, 0, 0);
    const cv::Mat coefficients(camera.coefficients(), true);
    if (camera.distortion() == Distortion::equidistant)
      cv::fisheye::projectPoints(object, image, zero, zero, K_of(camera), coefficients);
    else
      cv::projectPoints(object, zero, zero, K_of(camera), coefficients, image);
    for (std::size_t i = 0; i < object.size(); ++i) {
      const auto pixel = camera.project(Vec3<double>(object[i].x, object[i].y, object[i].z));
      REQUIRE(pixel);
      // OpenCV's fisheye takes angles below 1e-8 for zero, which moves a pixel by 1e-6.
      CHECK((*pixel - Vec2<double>(image[i].x, image[i].y)).norm() <
            (camera.distortion() == Distortion::equidistant ? 2e-6 : 1e-10));
    }
  }
}

TEST_CASE("unprojection agrees with cv::undistortPoints where that converges", "[camera]") {
  for (const auto& [name, camera] : cameras()) {
    if (camera.distortion() == Distortion::equidistant) continue;
    INFO(name);
    std::vector<cv::Point2d> pixels, rays;
    for (int v = 60; v < camera.height() - 60; v += 20)
      for (int u = 60; u < camera.width() - 60; u += 20) pixels.emplace_back(u, v);
    cv::undistortPoints(pixels, rays, K_of(camera), cv::Mat(camera.coefficients(), true), cv::noArray(),
                        cv::noArray(),
                        cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 200, 1e-12));
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      const auto ray = camera.unproject(Vec2<double>(pixels[i].x, pixels[i].y));
      REQUIRE(ray);
      CHECK((ray->head<2>() - Vec2<double>(rays[i].x, rays[i].y)).norm() < 1e-8);
    }
  }
}

TEST_CASE("behind the camera there is no pixel", "[camera]") {
  for (const auto& [name, camera] : cameras()) {
    INFO(name);
    CHECK_FALSE(camera.project(Vec3<double>(0, 0, 0)));
    CHECK_FALSE(camera.project(Vec3<double>(0.1, 0, -1)));
    CHECK_FALSE(camera.project(Vec3<double>(1, 1, 0)));
    CHECK_FALSE(camera.project(Vec3<double>(0, 0, std::nan(""))));
    CHECK_FALSE(camera.project(Vec3<double>(std::nan(""), 0, 1)));
    CHECK_FALSE(camera.project(Vec3<double>(1, 0, 1e-30)));
    CHECK_FALSE(camera.unproject(Vec2<double>(std::nan(""), 0)));
    CHECK_FALSE(camera.unproject(Vec2<double>(std::numeric_limits<double>::infinity(), 0)));
  }
}

TEST_CASE("the domain of radial distortion ends where the distorted radius stops growing", "[camera]") {
  // k1 alone: 1 + 3 k1 r^2 = 0
  const double k1 = -0.4, limit = std::sqrt(1 / (3 * -k1));
  const Camera camera({300, 300, 320, 240}, Distortion::radial_tangential, {k1, 0, 0, 0}, 640, 480);
  CHECK(camera.max_radius() == Approx(limit).epsilon(1e-12));
  CHECK(camera.project(Vec3<double>(limit * (1 - 1e-9), 0, 1)));
  CHECK_FALSE(camera.project(Vec3<double>(limit * (1 + 1e-9), 0, 1)));
  // A ray from far outside would be folded to the middle of the image.
  const double folded = 1.58;
  CHECK(std::abs(folded * (1 + k1 * folded * folded)) < 0.01);
  CHECK_FALSE(camera.project(Vec3<double>(folded, 0, 1)));
  // The pixel that the limit is distorted to is the last one with a ray.
  const double edge = 320 + 300 * limit * (1 + k1 * limit * limit);
  CHECK(camera.unproject(Vec2<double>(edge - 1e-3, 240)));
  CHECK_FALSE(camera.unproject(Vec2<double>(edge + 1e-3, 240)));
  CHECK_FALSE(camera.unproject(Vec2<double>(0, 0)));
  // Whatever is found lies in the domain and projects back, right up to the rim.
  int found = 0;
  for (double v = 0; v < 480; v += 1.7) {
    for (double u = 0; u < 640; u += 1.9) {
      const auto ray = camera.unproject(Vec2<double>(u, v));
      const bool inside = std::hypot(u - 320, v - 240) < edge - 320;
      if (std::abs(std::hypot(u - 320, v - 240) - (edge - 320)) > 1e-6) REQUIRE(ray.has_value() == inside);
      if (!ray) continue;
      ++found;
      REQUIRE(ray->head<2>().norm() <= limit);
      REQUIRE((*camera.project(*ray) - Vec2<double>(u, v)).norm() < 1e-9);
    }
  }
  CHECK(found > 1000);
}

TEST_CASE("the first end of the domain is found among several", "[camera]") {
  Random random(5);
  for (int i = 0; i < 300; ++i) {
    std::vector<double> k = {random.uniform(-1, 1), random.uniform(-1, 1), 0, 0, random.uniform(-1, 1)};
    const bool fisheye = i % 2;
    if (fisheye)
      k = {random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
    const Camera camera({300, 300, 320, 240},
                        fisheye ? Distortion::equidistant : Distortion::radial_tangential, k, 640, 480);
    // The slow way: walk outwards until the distorted radius shrinks.
    const auto distorted = [&](double x) {  // radius, or angle of the fisheye
      const double s = x * x;
      if (fisheye) return x * (1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))));
      return x * (1 + s * (k[0] + s * (k[1] + s * k[4])));
    };
    const double end = fisheye ? std::atan(camera.max_radius()) : camera.max_radius();
    const double last = std::min(end, 4.0);
    double x = 0;
    while (x + 1e-4 < last && distorted(x + 1e-4) > distorted(x)) x += 1e-4;
    INFO("coefficients " << k[0] << ' ' << k[1] << ' ' << k[2] << ' ' << k[3] << " end " << end << " walked "
                         << x);
    CHECK(std::abs(x - last) < 2e-3);
    if (end < 1.5) CHECK(distorted(end + 1e-3) < distorted(end));
  }
}

TEST_CASE("a wrong camera is refused with the field and its value", "[camera]") {
  const std::vector<double> good = {400, 400, 320, 240};
  const double nan = std::nan(""), inf = std::numeric_limits<double>::infinity();
  CHECK(error_of({0, 400, 320, 240}, Distortion::none, {}).place() == "fx");
  CHECK(error_of({400, -3, 320, 240}, Distortion::none, {}).place() == "fy");
  CHECK(error_of({400, -3, 320, 240}, Distortion::none, {}).value() == "-3");
  CHECK(error_of({400, -3, 320, 240}, Distortion::none, {}).kind() == ErrorKind::calibration);
  CHECK(error_of({nan, 400, 320, 240}, Distortion::none, {}).place() == "fx");
  CHECK(error_of({400, inf, 320, 240}, Distortion::none, {}).place() == "fy");
  CHECK(error_of({400, 400, nan, 240}, Distortion::none, {}).place() == "cx");
  CHECK(error_of({400, 400, 320, 2000}, Distortion::none, {}).place() == "cy");
  CHECK(error_of({400, 400, -700, 240}, Distortion::none, {}).place() == "cx");
  CHECK(error_of({400, 400, 320}, Distortion::none, {}).place() == "intrinsics");
  CHECK(error_of(good, Distortion::none, {}, 0, 480).place() == "width");
  CHECK(error_of(good, Distortion::none, {}, 640, -1).place() == "height");
  CHECK(error_of(good, Distortion::none, {0.1}).place() == "distortion_coefficients");
  CHECK(error_of(good, Distortion::radial_tangential, {0.1, 0, 0}).place() == "distortion_coefficients");
  CHECK(error_of(good, Distortion::radial_tangential, {0, 0, 0, 0, 0, 0}).value() == "6");
  CHECK(error_of(good, Distortion::equidistant, {0, 0, 0, 0, 0}).place() == "distortion_coefficients");
  CHECK(error_of(good, Distortion::equidistant, {0, nan, 0, 0}).place() == "distortion_coefficients[1]");
}

TEST_CASE("the border belongs to the image's pixels", "[camera]") {
  const Camera camera({400, 400, 320, 240}, Distortion::none, {}, 640, 480);
  CHECK(camera.contains({-0.5, -0.5}));
  CHECK(camera.contains({639.5, 479.5}));
  CHECK_FALSE(camera.contains({-0.6, 3}));
  CHECK_FALSE(camera.contains({640, 3}));
  CHECK(camera.contains({2, 2}, 2.5));
  CHECK_FALSE(camera.contains({1.9, 2}, 2.5));
  Mat3<double> K;
  K << 400, 0, 320, 0, 400, 240, 0, 0, 1;
  CHECK(camera.K() == K);
}
