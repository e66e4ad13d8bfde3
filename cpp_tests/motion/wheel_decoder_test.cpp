// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/motion/wheel_decoder.hpp"

#include <catch2/catch.hpp>
#include <limits>

using namespace sweepkit;

namespace {

const WheelGeometry kGeometry{1560, 0.035, 0.235};
constexpr TimeNs kStep = 20'000'000;
const double kTick = kGeometry.metres_per_tick();

WheelSample at(int k, double left, double right) { return {k * kStep, WheelReading::ticks, left, right}; }

}  // namespace

TEST_CASE("counts become distances", "[motion][wheels]") {
  WheelDecoder decoder(kGeometry);
  CHECK_FALSE(decoder.push(at(0, 1000, -50)));
  const auto step = decoder.push(at(1, 1040, -80));
  REQUIRE(step);
  CHECK(step->begin == 0);
  CHECK(step->end == kStep);
  CHECK(step->left == Approx(40 * kTick));
  CHECK(step->right == Approx(-30 * kTick));
  CHECK(step->measured);

  WheelDecoder speeds(kGeometry);
  CHECK_FALSE(speeds.push({0, WheelReading::speeds, 0.1, 0.2}));
  const auto rolled = speeds.push({kStep, WheelReading::speeds, 0.3, -0.2});
  REQUIRE(rolled);
  CHECK(rolled->left == Approx(0.006));
  CHECK(rolled->right == Approx(-0.004));
  // After a hole nobody knows how fast it went in between.
  const auto hole = speeds.push({kStep + kNsPerSecond, WheelReading::speeds, 0.3, -0.2});
  REQUIRE(hole);
  CHECK_FALSE(hole->measured);
  CHECK(hole->left == Approx(0.03));
}

TEST_CASE("a counter that wraps around goes on", "[motion][wheels]") {
  for (const double range : {0x1p16, 0x1p32, 10000.0}) {
    WheelDecoderOptions options;
    options.counter_range = range == 10000.0 ? range : 0;
    WheelDecoder decoder(kGeometry, options);
    double left = range - 100, right = 60;
    double sum_left = 0, sum_right = 0;
    for (int k = 0; k < 10; ++k) {
      const auto wrapped = [&](double x) { return x - range * std::floor(x / range); };
      if (const auto step = decoder.push(at(k, wrapped(left + 30 * k), wrapped(right - 20 * k)))) {
        CHECK(step->measured);
        sum_left += step->left;
        sum_right += step->right;
      }
    }
    CHECK(sum_left == Approx(270 * kTick));
    CHECK(sum_right == Approx(-180 * kTick));
    CHECK(decoder.wraps() == 2);
    CHECK(decoder.resets() == 0);
  }
}

TEST_CASE("counters set to zero leave one step open and go on", "[motion][wheels]") {
  WheelDecoder decoder(kGeometry);
  decoder.push(at(0, 5000, 7000));
  decoder.push(at(1, 5030, 7030));
  const auto reset = decoder.push(at(2, 3, 2));
  REQUIRE(reset);
  CHECK_FALSE(reset->measured);
  CHECK(reset->left == Approx(30 * kTick));  // the speed before, held
  const auto next = decoder.push(at(3, 33, 32));
  REQUIRE(next);
  CHECK(next->measured);
  CHECK(next->left == Approx(30 * kTick));
  CHECK(decoder.resets() == 1);
}

TEST_CASE("bad wheel samples are refused", "[motion][wheels]") {
  WheelDecoder decoder(kGeometry);
  decoder.push(at(5, 100, 100));
  decoder.push(at(6, 110, 110));
  CHECK_FALSE(decoder.push(at(6, 110, 110)));
  CHECK_FALSE(decoder.push(at(3, 90, 90)));
  CHECK_FALSE(decoder.push(at(7, std::numeric_limits<double>::quiet_NaN(), 90)));
  CHECK_FALSE(decoder.push(at(7, 120, std::numeric_limits<double>::infinity())));
  CHECK(decoder.refused() == 4);
  const auto step = decoder.push(at(8, 130, 120));
  REQUIRE(step);
  CHECK(step->begin == 6 * kStep);
  CHECK(step->left == Approx(20 * kTick));
  // Ticks count through a hole.
  const auto hole = decoder.push(at(108, 1130, 1120));
  REQUIRE(hole);
  CHECK(hole->measured);
  CHECK(hole->left == Approx(1000 * kTick));
  // A change of what is read starts anew.
  CHECK_FALSE(decoder.push({200 * kStep, WheelReading::speeds, 0, 0}));
  CHECK_THROWS_AS(WheelDecoder(WheelGeometry{0, 0.035, 0.2}), Error);
}
