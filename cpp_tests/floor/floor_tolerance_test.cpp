// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/floor_tolerance.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

#include "floor/random_disparities.hpp"
#include "sweepkit/core/options.hpp"

using namespace sweepkit;

TEST_CASE("The tolerance holds the noise that it is made of, and not much more") {
  const GroundPlane plane = tilted_floor();
  FloorNoise noise;
  const double tilt = GENERATE(0.0, 0.05, 0.2), height = GENERATE(0.0, 0.001);
  noise.sigma_pitch = tilt;
  noise.sigma_height = height;
  const FloorTolerance t = FloorTolerance::of(noise, plane, kFloorCamera);
  const double moved =
      kFloorCamera.focal * kFloorCamera.baseline / plane.height * tilt * std::numbers::pi / 180;
  for (double f = 0; f <= 128; f += 0.5) {
    const double sigma =
        std::hypot(noise.sigma + noise.sigma_per_disparity * f, moved, f * height / plane.height);
    CHECK(t.towards(f) >= noise.factor * sigma * (1 - 1e-12));
    CHECK(t.towards(f) <= 1.5 * noise.factor * sigma);
    CHECK(t.away(f) == t.towards(f));
  }
  CHECK(t.towards(-50) == t.towards(0));
}

TEST_CASE("What is too low to matter lies just within the tolerance") {
  const GroundPlane plane = tilted_floor();
  FloorNoise noise;
  noise.factor = 0;
  noise.min_height = 0.012;
  noise.min_depth = 0.02;
  const FloorTolerance t = FloorTolerance::of(noise, plane, kFloorCamera);
  const FloorDisparity floor = plane.disparity(kFloorCamera);
  for (const double y : {0.012, -0.02}) {
    GroundPlane level = plane;
    level.height -= y;
    const FloorDisparity d = level.disparity(kFloorCamera);
    for (const int v : {240, 300, 399}) {
      const double f = floor(100, v), off = d(100, v) - f;
      CHECK(off == Approx(y > 0 ? t.towards(f) : -t.away(f)).epsilon(1e-12));
    }
  }
  noise.min_height = 1;  // higher than the camera: nothing on the floor matters
  CHECK(FloorTolerance::of(noise, plane, kFloorCamera).towards(10) > 1000);
}

TEST_CASE("Options of the floor's noise have names, units and ranges") {
  FloorNoise noise;
  const OptionList list = list_options(noise);
  CHECK(list.find("sigma_pitch") != nullptr);
  CHECK(list.size() == 7);
}
