// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/wheel_simulation.hpp"

#include <catch2/catch.hpp>
#include <numbers>

#include "data/moving_body.hpp"

using namespace sweepkit;

namespace {

struct Planar {
  double x, y, yaw;
};

// Dead reckoning with the measures that the wheels really have.
Planar reckon(const std::vector<WheelSample>& samples, const WheelSimulationOptions& o, const SE3d& start) {
  const auto R = start.rotation().matrix();
  Planar p{start.translation().x(), start.translation().y(), std::atan2(R(1, 0), R(0, 0))};
  const double turn = 2.0 * std::numbers::pi / o.ticks_per_revolution;
  for (std::size_t i = 1; i < samples.size(); ++i) {
    const double left = (samples[i].left - samples[i - 1].left) * turn * o.true_radius_left();
    const double right = (samples[i].right - samples[i - 1].right) * turn * o.true_radius_right();
    const double way = 0.5 * (left + right), angle = (right - left) / o.true_track();
    // Along the arc of constant curvature.
    const double chord = std::abs(angle) < 1e-9 ? way : way * std::sin(0.5 * angle) / (0.5 * angle);
    p.x += chord * std::cos(p.yaw + 0.5 * angle);
    p.y += chord * std::sin(p.yaw + 0.5 * angle);
    p.yaw += angle;
  }
  return p;
}

}  // namespace

TEST_CASE("ideal wheels bring back the truth after a minute", "[wheel_simulation]") {
  const PoseSpline base = test::flat_drive(60.0);
  WheelSimulationOptions options;
  options.radius_error_left = 0.012;
  options.radius_error_right = -0.015;
  options.track_error = 0.02;
  for (const double rate : {50.0, 200.0}) {
    options.rate_hz = rate;
    const auto samples = simulate_wheels(base, 0, options.ideal(), {}, 3);
    REQUIRE(samples.size() == static_cast<std::size_t>(60 * rate) + 1);
    const Planar end = reckon(samples, options, base.pose(0));
    const SE3d truth = base.pose(60.0);
    const double position = std::hypot(end.x - truth.translation().x(), end.y - truth.translation().y());
    const double angle =
        (SO3d::exp({0, 0, end.yaw}).inverse() * truth.rotation()).angle() * 180.0 / std::numbers::pi;
    CAPTURE(rate, position, angle);
    CHECK(position < 1e-3);
    CHECK(angle < 0.01);
  }
}

TEST_CASE("quantised wheels count whole ticks of the ideal ones", "[wheel_simulation]") {
  const PoseSpline base = test::flat_drive(10.0);
  WheelSimulationOptions options;
  options.creep = 0.0;
  const auto ticks = simulate_wheels(base, 0, options, {}, 5),
             exact = simulate_wheels(base, 0, options.ideal(), {}, 5);
  for (std::size_t i = 0; i < ticks.size(); ++i) {
    CHECK(ticks[i].left == std::floor(exact[i].left));
    CHECK(ticks[i].right == std::floor(exact[i].right));
  }
}

TEST_CASE("creep grows with the root of the way", "[wheel_simulation]") {
  const PoseSpline base = test::flat_drive(30.0);
  WheelSimulationOptions options;
  options.quantised = false;
  options.creep = 0.02;
  const auto way = [&](std::uint64_t seed, double creep) {
    WheelSimulationOptions o = options;
    o.creep = creep;
    const auto s = simulate_wheels(base, 0, o, {}, seed);
    return (s.back().left - s.front().left) * o.nominal().metres_per_tick();
  };
  double rolled = 0;
  const auto exact = simulate_wheels(base, 0, options.ideal(), {}, 0);
  for (std::size_t i = 1; i < exact.size(); ++i)
    rolled += std::abs(exact[i].left - exact[i - 1].left) * options.nominal().metres_per_tick();
  const double truth = way(0, 0.0);
  double squares = 0;
  constexpr int kRuns = 60;
  for (std::uint64_t seed = 0; seed < kRuns; ++seed) squares += std::pow(way(seed, 0.02) - truth, 2) / kRuns;
  CHECK(std::sqrt(squares) == Approx(0.02 * std::sqrt(rolled)).epsilon(0.3));
}

TEST_CASE("slipping wheels roll farther, free ones as they like", "[wheel_simulation]") {
  const PoseSpline base = test::flat_drive(12.0);
  WheelSimulationOptions options;
  const auto rolled = [&](const std::vector<WheelSample>& s, double a, double b) {
    const auto at = [&](double t) { return s[static_cast<std::size_t>(std::lround(t * options.rate_hz))]; };
    return std::pair((at(b).left - at(a).left) * options.nominal().metres_per_tick(),
                     (at(b).right - at(a).right) * options.nominal().metres_per_tick());
  };
  const auto clean = simulate_wheels(base, 0, options.ideal(), {}, 1);
  WheelEpisode slip;
  slip.begin = 4.0, slip.end = 6.0, slip.grip_left = 0.25;
  const std::vector<WheelEpisode> episodes = {slip};
  const auto slipped = simulate_wheels(base, 0, options.ideal(), episodes, 1);
  const auto [l0, r0] = rolled(clean, 4.2, 5.8);
  const auto [l1, r1] = rolled(slipped, 4.2, 5.8);
  CHECK(l1 == Approx(4.0 * l0).epsilon(1e-9));
  CHECK(r1 == Approx(r0).epsilon(1e-9));
  CHECK(rolled(slipped, 0, 3.9).first == Approx(rolled(clean, 0, 3.9).first));

  WheelEpisode free;
  free.kind = WheelEpisode::Kind::free;
  free.begin = 7.0, free.end = 9.0, free.speed_left = 0.5, free.speed_right = -0.2;
  const auto spun = simulate_wheels(base, 0, options.ideal(), std::vector{free}, 1);
  const auto [l2, r2] = rolled(spun, 7.2, 8.8);
  // Counts times the nominal radius; the rims are those of the true ones.
  CHECK(l2 * options.true_radius_left() / options.wheel_radius == Approx(0.8).epsilon(1e-6));
  CHECK(r2 * options.true_radius_right() / options.wheel_radius == Approx(-0.32).epsilon(1e-6));
}

TEST_CASE("impossible wheels are refused", "[wheel_simulation]") {
  const PoseSpline base = test::flat_drive(5.0);
  WheelSimulationOptions options;
  options.wheel_radius = 0;
  CHECK_THROWS_AS(simulate_wheels(base, 0, options, {}, 1), Error);
  WheelEpisode backwards;
  backwards.begin = 2, backwards.end = 1;
  CHECK_THROWS_AS(simulate_wheels(base, 0, {}, std::vector{backwards}, 1), Error);
}
