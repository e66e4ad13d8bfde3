// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/wheel_simulation.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "smooth_step.hpp"
#include "sweepkit/core/random.hpp"

namespace sweepkit {
namespace {

struct Speeds {
  double left, right;
};

// Forward speeds of the rims against the base [m/s].
Speeds rim_speeds(const PoseSpline& base, double track, std::span<const WheelEpisode> episodes, double t) {
  const MotionState s = base.at(t);
  const double v = (s.T_world_body.rotation().inverse() * s.velocity).x();
  const double turn = 0.5 * track * s.angular_rate.z();
  Speeds rolled{v - turn, v + turn};
  for (const WheelEpisode& e : episodes) {
    if (t <= e.begin || t >= e.end) continue;
    const double share = smooth_step((t - e.begin) / e.ramp) * smooth_step((e.end - t) / e.ramp);
    if (e.kind == WheelEpisode::Kind::slip) {
      rolled.left /= 1.0 + share * (e.grip_left - 1.0);
      rolled.right /= 1.0 + share * (e.grip_right - 1.0);
    } else {
      rolled.left += share * (e.speed_left - rolled.left);
      rolled.right += share * (e.speed_right - rolled.right);
    }
  }
  return rolled;
}

}  // namespace

WheelSimulationOptions WheelSimulationOptions::ideal() const {
  WheelSimulationOptions o = *this;
  o.creep = 0.0;
  o.quantised = false;
  return o;
}

std::vector<WheelSample> simulate_wheels(const PoseSpline& base, TimeNs begin,
                                         const WheelSimulationOptions& options,
                                         std::span<const WheelEpisode> episodes, std::uint64_t seed) {
  check_options(options);
  for (const WheelEpisode& e : episodes) {
    require(e.end > e.begin, "simulate_wheels episodes", "must end after they begin", e.end);
    require(e.ramp > 0.0, "simulate_wheels episodes", "must have a ramp above 0", e.ramp);
    const double grip = std::min(e.grip_left, e.grip_right);
    require(grip > 0.0, "simulate_wheels episodes", "must have some grip", grip);
  }
  const double samples = std::floor(base.duration() * options.rate_hz + 1e-6) + 1.0;
  require(samples < 1e8, "simulate_wheels rate_hz", "gives too many samples", samples);
  const auto count = static_cast<std::size_t>(samples);

  Random random(seed);
  const std::array<double, 2> start = {std::floor(random.uniform(0.0, 5000.0)) + random.uniform(),
                                       std::floor(random.uniform(0.0, 5000.0)) + random.uniform()};
  const double ticks = options.ticks_per_revolution / (2.0 * std::numbers::pi);
  const std::array<double, 2> ticks_per_metre = {ticks / options.true_radius_left(),
                                                 ticks / options.true_radius_right()};
  const double track = options.true_track();

  std::array<double, 2> rolled = {0.0, 0.0};  // [m]
  std::vector<WheelSample> stream;
  stream.reserve(count);
  double t = 0.0;
  for (std::size_t i = 0; i < count; ++i) {
    const double stamp = static_cast<double>(i) / options.rate_hz;
    std::array<double, 2> way = {0.0, 0.0};
    while (t < stamp) {
      // No further than the next knot, between which the motion is a polynomial.
      double next = base.step() * (std::floor(t / base.step() + 1e-9) + 1.0);
      next = std::min(next, stamp);
      const double middle = 0.5 * (t + next), half = 0.5 * (next - t);
      constexpr std::array<double, 3> kPlace = {-0.7745966692414834, 0.0, 0.7745966692414834};
      constexpr std::array<double, 3> kWeight = {5.0 / 9.0, 8.0 / 9.0, 5.0 / 9.0};
      for (int k = 0; k < 3; ++k) {
        const Speeds v = rim_speeds(base, track, episodes, middle + half * kPlace[k]);
        way[0] += half * kWeight[k] * v.left;
        way[1] += half * kWeight[k] * v.right;
      }
      t = next;
    }
    for (int side = 0; side < 2; ++side) {
      const double noise = random.normal();
      rolled[side] += way[side] + options.creep * std::sqrt(std::abs(way[side])) * noise;
    }
    const auto reading = [&](int side) {
      const double value = start[side] + rolled[side] * ticks_per_metre[side];
      return options.quantised ? std::floor(value) : value;
    };
    stream.push_back({begin + from_seconds(stamp), WheelReading::ticks, reading(0), reading(1)});
  }
  return stream;
}

}  // namespace sweepkit
