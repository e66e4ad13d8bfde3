// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/floor_scan.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <optional>

#include "sweepkit/core/random.hpp"
#include "sweepkit/image/image.hpp"

using namespace sweepkit;

namespace {

const RectifiedCamera kCamera{320.0, 319.5, 199.5, 0.06};
constexpr int kWidth = 640, kHeight = 400;

GroundPlane tilted_plane(double pitch, double roll) {
  GroundPlane plane;
  plane.height = 0.08;
  plane.down_camera =
      Vec3<double>(std::sin(roll), std::cos(roll) * std::cos(pitch), std::cos(roll) * std::sin(pitch));
  return plane;
}

/// A floor with a wall across, both infinite, and a box's front on the floor before the wall.
struct World {
  GroundPlane plane = tilted_plane(0.05, 0.01);
  double wall = 2.0;          // along the floor, from the camera [m]
  double low = 0.0;           // the wall's lower edge over the floor [m]
  std::optional<double> pit;  // beyond it the floor is 0.3 m lower [m]

  template <class D>
  Image<D> disparity() const {
    const Mat3<double> R = camera_from_scan(plane).rotation().matrix();
    Image<D> image(kWidth, kHeight);
    for (int v = 0; v < kHeight; ++v)
      for (int u = 0; u < kWidth; ++u) {
        const Vec3<double> ray((u - kCamera.cx) / kCamera.focal, (v - kCamera.cy) / kCamera.focal, 1);
        const Vec3<double> r = R.transpose() * ray;  // x forward, y left, z up
        double depth = std::numeric_limits<double>::infinity();
        const double to_wall = wall / r.x();
        if (r.x() > 0 && plane.height + to_wall * r.z() >= low) depth = to_wall;
        if (r.z() < 0) {
          double to_floor = plane.height / -r.z();
          if (pit && to_floor * r.x() > *pit) to_floor = (plane.height + 0.3) / -r.z();
          depth = std::min(depth, to_floor);
        }
        const double d = std::isfinite(depth) ? kCamera.disparity(depth) : 0.0;
        image(u, v) = std::is_same_v<D, float> ? static_cast<D>(d) : static_cast<D>(std::lround(16 * d));
      }
    return image;
  }
};

template <class D>
FloorScan scan_of(const Image<D>& image, const GroundPlane& plane, const FloorScanOptions& options = {}) {
  FloorScanner scanner(options);
  FloorScan scan;
  scanner.scan(View2d<const D>(image.view()), kCamera, plane, Vec3<double>(0, 0.08, -0.1), scan);
  return scan;
}

}  // namespace

TEST_CASE("the frame of a scan lies on the floor below the camera") {
  const GroundPlane plane = tilted_plane(0.1, -0.05);
  const SE3d T = camera_from_scan(plane);
  CHECK(std::abs(plane.height_of(T * Vec3<double>(1.3, -0.4, 0))) < 1e-12);
  CHECK((T * Vec3<double>(0, 0, plane.height)).norm() < 1e-12);
  CHECK((T.rotation() * Vec3<double>(1, 0, 0)).z() > 0.99);
  CHECK((T.rotation() * Vec3<double>(0, 1, 0)).x() < -0.99);
  const GroundPlane below{Vec3<double>::UnitZ(), 0.5};  // looks straight down
  CHECK(camera_from_scan(below).rotation().matrix().allFinite());
}

TEMPLATE_TEST_CASE("floor is free up to a wall, at whatever tilt", "", float, std::int16_t) {
  for (const double wall : {0.4, 1.0, 2.0})
    for (const auto& [pitch, roll] : {std::pair{0.05, 0.01}, {0.0, 0.0}, {0.12, -0.06}}) {
      World world;
      world.plane = tilted_plane(pitch, roll);
      world.wall = wall;
      const FloorScan scan = scan_of(world.disparity<TestType>(), world.plane);
      REQUIRE(scan.bearings > 150);
      int free = 0, obstacles = 0;
      for (const FloorStretch& s : scan.stretches) {
        const double b = scan.bearing(s.bearing);
        const double expected = wall / std::cos(b);  // at that bearing
        INFO(wall << " m, bearing " << b);
        if (s.label == FloorLabel::floor) {
          ++free;
          CHECK(1e-3 * s.to <= expected * 1.02);
          if (expected < 2.0) CHECK(1e-3 * s.to > expected * 0.85);
          CHECK(s.from < s.to);
        } else {
          CHECK(s.label == FloorLabel::obstacle);
          ++obstacles;
          CHECK(std::abs(1e-3 * s.from - expected) < 0.04 * expected);
        }
      }
      CHECK(free > 0.8 * scan.bearings);
      CHECK(obstacles > 0.8 * scan.bearings);
      CHECK(obstacles <= scan.bearings);
      CHECK(scan.bytes() < 8000);
    }
}

TEST_CASE("what hangs higher than the robot is passed under, what is lower is not") {
  World world;
  world.wall = 1.0;
  FloorScanOptions options;
  const auto hits = [&] {
    int count = 0;
    for (const FloorStretch& s : scan_of(world.disparity<float>(), world.plane, options).stretches)
      count += s.label == FloorLabel::obstacle;
    return count;
  };
  world.low = 0.15;
  CHECK(hits() == 0);
  options.max_height = 0.3;
  CHECK(hits() > 100);
}

TEST_CASE("floor below a cabinet on legs is not free, though its bare front has no disparity") {
  // A front from 7 cm above the floor on, square to the camera or turned, seen at its edges only; floor goes
  // on below it to a wall.
  World world;
  world.wall = 2.0;
  const Image<float> room = world.disparity<float>();
  const SE3d T = camera_from_scan(world.plane);
  for (const double turn : {0.0, 0.5}) {
    const Vec3<double> normal(std::cos(turn), std::sin(turn), 0);  // of the front, in the scan's frame
    const auto front = [&](double bearing) {                       // its distance along the floor
      return normal.x() / (std::cos(bearing) * normal.x() + std::sin(bearing) * normal.y());
    };
    Image<float> image(kWidth, kHeight);
    const auto draw = [&](bool bare, bool edges) {
      for (int v = 0; v < kHeight; ++v)
        for (int u = 0; u < kWidth; ++u) {
          image(u, v) = room(u, v);
          const Vec3<double> r = T.rotation().inverse() * Vec3<double>((u - kCamera.cx) / kCamera.focal,
                                                                       (v - kCamera.cy) / kCamera.focal, 1);
          const double bearing = std::atan2(r.y(), r.x());
          const double depth = front(bearing) / std::hypot(r.x(), r.y());
          if (std::abs(bearing) > 0.4 || world.plane.height + depth * r.z() < 0.07) continue;
          const bool edge = std::abs(bearing) > 0.35 || std::abs(bearing) < 0.03;
          if (edge ? edges : !bare)
            image(u, v) = static_cast<float>(kCamera.disparity(depth));
          else
            image(u, v) = 0.0f;
        }
      return scan_of(image, world.plane);
    };
    const auto farthest = [&](const FloorScan& scan, double at) {  // as a part of the front's distance
      double to = 0.0;
      for (const FloorStretch& s : scan.stretches)
        if (s.label == FloorLabel::floor && std::abs(scan.bearing(s.bearing) - at) < 0.005)
          to = std::max(to, 1e-3 * s.to / front(at));
      return to;
    };
    for (const double bearing : {-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3}) {
      INFO("front turned by " << turn << ", bearing " << bearing);
      CHECK(farthest(draw(true, true), bearing) < 1.0);
      CHECK(farthest(draw(true, true), bearing) > 0.9);
      CHECK(farthest(draw(true, true), bearing) == Approx(farthest(draw(false, true), bearing)).margin(0.02));
    }
    // Beside it the floor is free.
    CHECK(farthest(draw(true, true), 0.6) * front(0.6) > 1.8);
    // Where the edges are not seen either, what is seen beside it at the camera's height counts.
    CHECK(farthest(draw(true, false), 0.2) > 1.3);
  }
}

TEST_CASE("the last rows of floor are left out unless what stands at the camera's height is seen") {
  World world;
  world.wall = 2.5;
  Image<float> image = world.disparity<float>();
  // Nothing is known between the floor's last row, before 1.2 m, and the horizon.
  const FloorDisparity floor = world.plane.disparity(kCamera);
  const auto last = static_cast<float>(kCamera.focal * kCamera.baseline / 1.2);
  for (int v = 0; v < kHeight; ++v)
    for (int u = 0; u < kWidth; ++u)
      if (floor(u, v) > 0 && floor(u, v) < last) image(u, v) = 0.0f;
  const auto ahead = [&] {
    double to = 0.0;
    const FloorScan scan = scan_of(image, world.plane);
    for (const FloorStretch& s : scan.stretches)
      if (s.label == FloorLabel::floor && std::abs(scan.bearing(s.bearing)) < 0.01) to = 1e-3 * s.to;
    return to;
  };
  CHECK(ahead() == Approx(1.2).margin(0.06));
  for (int v = 0; v < kHeight; ++v)
    for (int u = 0; u < kWidth; ++u)
      if (floor(u, v) <= 0) image(u, v) = 0.0f;
  CHECK(ahead() < 1.12);
  CHECK(ahead() > 0.9);
}

TEST_CASE("a step down is a hole where the floor ends") {
  World world;
  world.wall = 5.0;
  world.pit = 0.7;
  const FloorScan scan = scan_of(world.disparity<float>(), world.plane);
  int holes = 0;
  for (const FloorStretch& s : scan.stretches) {
    const double expected = 0.7 / std::cos(scan.bearing(s.bearing));
    if (s.label == FloorLabel::floor) CHECK(1e-3 * s.to < expected * 1.06);
    if (s.label != FloorLabel::hole) continue;
    ++holes;
    CHECK(std::abs(1e-3 * s.from - expected) < 0.06 * expected);
  }
  CHECK(holes > 150);
}

TEST_CASE("without disparities nothing is said, and nonsense does no harm") {
  World world;
  Image<float> image(kWidth, kHeight);
  for (const float value :
       {0.0f, -1.0f, std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
    image.fill(value);
    CHECK(scan_of(image, world.plane).stretches.empty());
  }
  CHECK(scan_of(Image<float>(), world.plane).stretches.empty());
  CHECK(scan_of(Image<float>(1, 1), world.plane).stretches.empty());
  image.fill(1e30f);
  scan_of(image, world.plane);
  Random random(3);
  for (int n = 0; n < 3; ++n) {
    for (int v = 0; v < kHeight; ++v)
      for (int u = 0; u < kWidth; ++u)
        image(u, v) = random.uniform() < 0.3 ? 0.0f : static_cast<float>(random.uniform(-5, 200));
    GroundPlane plane;
    plane.height = random.uniform(0.01, 1.0);
    plane.down_camera =
        Vec3<double>(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)).normalized();
    const FloorScan scan = scan_of(image, plane);
    for (const FloorStretch& s : scan.stretches) {
      CHECK(s.bearing < scan.bearings);
      CHECK(s.from <= s.to);
    }
  }
  FloorScanOptions options;
  options.bearing_step = 0;
  CHECK_THROWS_AS(FloorScanner(options), Error);
}
