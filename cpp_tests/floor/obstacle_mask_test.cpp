// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/obstacle_mask.hpp"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>

#include "floor/random_disparities.hpp"
#include "sweepkit/core/simd.hpp"

using namespace sweepkit;

namespace {

const FloorTolerance kTolerance{1.2, 0.03, 0.1, 0.08};

/// The definition, in double; none within 1e-4 px of a bound, where single precision may decide otherwise.
std::optional<FloorLabel> label_of(double d, double f) {
  if (!(d >= 1.0 / 1024) || !std::isfinite(d)) return FloorLabel::unknown;
  const double ground = std::max(f, 0.0);
  const double high = ground + kTolerance.towards(f), low = ground - kTolerance.away(f);
  if (std::abs(d - high) < 1e-4 || std::abs(d - low) < 1e-4 || std::abs(f) < 1e-4) return std::nullopt;
  if (d > high) return FloorLabel::obstacle;
  if (d < low) return FloorLabel::hole;
  return f > 0 ? FloorLabel::floor : FloorLabel::unknown;
}

}  // namespace

TEMPLATE_TEST_CASE("A mask is the comparison with the floor, pixel by pixel", "", float, std::int16_t) {
  const FloorDisparity floor = tilted_floor().disparity(kFloorCamera);
  const int width = GENERATE(640, 1, 7, 8, 9, 31, 32, 33, 47, 71), height = 400;
  const Image<TestType> d = random_disparities<TestType>(width, height, floor, 1 + width);
  GrayImage fast(width, height), portable(width, height);
  obstacle_mask<TestType>(d, floor, kTolerance, fast.view());
  {
    const ScopedSimdLevel level(SimdLevel::portable);
    obstacle_mask<TestType>(d, floor, kTolerance, portable.view());
  }
  int differ = 0, wrong = 0, near_a_bound = 0, seen[4] = {};
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u) {
      differ += fast(u, v) != portable(u, v);
      const auto expected = label_of(d(u, v) * double(kDisparityUnit<TestType>), floor(u, v));
      near_a_bound += !expected;
      wrong += expected && static_cast<int>(*expected) != fast(u, v);
      ++seen[std::min<int>(fast(u, v), 3)];
    }
  CHECK(differ == 0);
  CHECK(wrong == 0);
  CHECK(near_a_bound < width * height / 100 + 2);
  for (const int count : seen) CHECK(count > 0);
}

TEST_CASE("A mask reads and writes within its views") {
  const FloorDisparity floor = tilted_floor().disparity(kFloorCamera);
  const Image<float> d = random_disparities<float>(100, 40, floor, 3);
  const View2d<const float> inner{d.row(5) + 11, 53, 20, d.stride()};
  GrayImage whole(100, 40), expected(53, 20), mask(80, 40);
  mask.fill(77);
  FloorDisparity shifted = floor;
  shifted.at_origin = floor(11, 5);
  obstacle_mask<float>(inner, shifted, kTolerance, {mask.row(3) + 5, 53, 20, mask.stride()});
  {
    const ScopedSimdLevel level(SimdLevel::portable);
    obstacle_mask<float>(inner, shifted, kTolerance, expected.view());
  }
  for (int v = 0; v < 40; ++v)
    for (int u = 0; u < 80; ++u) {
      const bool inside = u >= 5 && u < 58 && v >= 3 && v < 23;
      CHECK_FALSE(mask(u, v) != (inside ? expected(u - 5, v - 3) : 77));
    }
}

TEST_CASE("What lies on the floor, above and below it gets its label at any tilt") {
  const Vec3<double> down =
      GENERATE(Vec3<double>(0, 1, 0), Vec3<double>(0.1, 1, 0.1), Vec3<double>(0, 1, -0.1));
  const GroundPlane plane{down.normalized(), 0.08};
  const FloorDisparity floor = plane.disparity(kFloorCamera);
  FloorNoise noise;
  noise.min_height = 0.005;
  noise.min_depth = 0.01;
  const FloorTolerance tolerance = FloorTolerance::of(noise, plane, kFloorCamera);
  const std::pair<double, FloorLabel> heights[] = {{0.0, FloorLabel::floor},    {0.0045, FloorLabel::floor},
                                                   {-0.009, FloorLabel::floor}, {0.03, FloorLabel::obstacle},
                                                   {0.3, FloorLabel::obstacle}, {-0.1, FloorLabel::hole}};
  for (const auto& [height, label] : heights) {
    Image<float> d(640, 400);
    GrayImage mask(640, 400);
    int looked_at = 0;
    for (int v = 0; v < 400; ++v)
      for (int u = 0; u < 640; ++u) {
        // Depth of the level `height` above the floor, where it is seen within 0.8 m.
        const Vec3<double> ray((u - kFloorCamera.cx) / kFloorCamera.focal,
                               (v - kFloorCamera.cy) / kFloorCamera.focal, 1);
        const double z = (plane.height - height) / plane.down_camera.dot(ray);
        d(u, v) = z > 0.1 && z < 0.8 ? static_cast<float>(kFloorCamera.disparity(z)) : 0.0f;
      }
    obstacle_mask<float>(d, floor, tolerance, mask.view());
    for (int v = 0; v < 400; ++v)
      for (int u = 0; u < 640; ++u) {
        if (d(u, v) <= 0) {
          CHECK_FALSE(mask(u, v) != static_cast<int>(FloorLabel::unknown));
          continue;
        }
        ++looked_at;
        CHECK_FALSE(mask(u, v) != static_cast<int>(label));
      }
    CHECK(looked_at > 1000);
  }
}

TEST_CASE("Images without disparities have no floor") {
  const FloorDisparity floor = tilted_floor().disparity(kFloorCamera);
  const float value =
      GENERATE(0.0f, -1.0f, std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity());
  Image<float> d(65, 400);
  d.fill(value);
  GrayImage mask(65, 400);
  mask.fill(9);
  obstacle_mask<float>(d, floor, kTolerance, mask.view());
  for (int v = 0; v < 400; ++v) CHECK(std::count(mask.row(v), mask.row(v) + 65, 0) == 65);
}

TEST_CASE("A mask of another size is refused, an empty one is nothing to do") {
  const FloorDisparity floor = tilted_floor().disparity(kFloorCamera);
  const Image<float> d = random_disparities<float>(40, 30, floor, 3);
  GrayImage mask(40, 31);
  CHECK_THROWS_WITH((obstacle_mask<float>(d, floor, kTolerance, mask.view())),
                    Catch::Contains("40x30") && Catch::Contains("40x31"));
  FloorDisparity unknown = floor;
  unknown.along_v = std::numeric_limits<double>::quiet_NaN();
  GrayImage fits(40, 30);
  CHECK_THROWS_AS((obstacle_mask<float>(d, unknown, kTolerance, fits.view())), Error);
  CHECK_NOTHROW(obstacle_mask<float>({}, floor, kTolerance, {}));
}
