// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <concepts>
#include <numbers>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/image/image.hpp"

namespace sweepkit {

/// A grey texture known at every point: waves of all directions with amplitudes that fall as the frequency
/// rises, as in photographs. No interpolation is needed to show it moved or warped.
class AnalyticTexture {
 public:
  /// @param max_frequency of a wave [rad/unit]
  AnalyticTexture(std::uint64_t seed, double max_frequency, int waves = 30) {
    const double min_frequency = 0.08 * max_frequency;
    Random random(seed);
    double energy = 0;
    for (int i = 0; i < waves; ++i) {
      const double frequency = min_frequency * std::pow(max_frequency / min_frequency, random.uniform());
      const double direction = random.uniform(0, 2 * std::numbers::pi);
      const double amplitude = 1 / std::sqrt(frequency / max_frequency);
      waves_.push_back({frequency * std::cos(direction), frequency * std::sin(direction),
                        random.uniform(0, 2 * std::numbers::pi), amplitude});
      energy += amplitude * amplitude / 2;
    }
    if (energy > 0)
      for (Wave& wave : waves_) wave.amplitude *= 40 / std::sqrt(energy);
  }

  double operator()(double x, double y) const {
    double value = 128;
    for (const Wave& w : waves_) value += w.amplitude * std::cos(w.x * x + w.y * y + w.phase);
    return value;
  }

 private:
  struct Wave {
    double x, y, phase, amplitude;
  };
  std::vector<Wave> waves_;
};

/// An image whose pixel (x, y) is value(x, y), rounded, with white noise.
template <std::invocable<double, double> Value>
GrayImage render(int width, int height, Value&& value, double noise = 0, std::uint64_t seed = 1) {
  Random random(seed);
  GrayImage image(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      image(x, y) = static_cast<std::uint8_t>(
          std::clamp(std::lround(value(x, y) + (noise > 0 ? random.normal(0, noise) : 0.0)), 0L, 255L));
  return image;
}

}  // namespace sweepkit
