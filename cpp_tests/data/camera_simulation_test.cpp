// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/camera_simulation.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <vector>

using namespace sweepkit;

namespace {

const Camera kCamera({200, 200, 159.5, 119.5}, Distortion::none, {}, 320, 240);

Image<float> even(float value) {
  Image<float> radiance(320, 240);
  radiance.fill(value);
  return radiance;
}

struct Statistics {
  double mean = 0, variance = 0;
};

Statistics statistics(const GrayImage& image) {
  Statistics s;
  const double n = 320.0 * 240.0;
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 320; ++x) s.mean += image(x, y) / n;
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 320; ++x) s.variance += std::pow(image(x, y) - s.mean, 2) / n;
  return s;
}

}  // namespace

TEST_CASE("noise has the variance that was asked for", "[camera_simulation]") {
  ExposureOptions options;
  options.vignetting = 0;
  options.white = 200;
  options.read_noise = 1.5;
  options.shot_noise = 0.05;
  const Exposure exposure(kCamera, options);
  GrayImage image;
  for (const double gain : {0.5, 1.0, 3.0})
    for (const double level : {30.0, 100.0, 180.0}) {
      exposure.develop(even(static_cast<float>(level / 200 / gain)).view(), gain, 5, image);
      const Statistics s = statistics(image);
      // Rounding adds 1/12.
      const double expected = gain * gain * 1.5 * 1.5 + gain * 0.05 * level + 1.0 / 12;
      CAPTURE(gain, level);
      CHECK(s.mean == Approx(level).margin(0.1));
      CHECK(s.variance == Approx(expected).epsilon(0.02));
    }
}

TEST_CASE("noise of neighbours is independent, and normal", "[camera_simulation]") {
  ExposureOptions options;
  options.vignetting = 0;
  options.read_noise = 10;
  options.shot_noise = 0;
  GrayImage image;
  Exposure(kCamera, options).develop(even(0.5f).view(), 1.0, 3, image);
  const Statistics s = statistics(image);
  double across = 0, down = 0, fourth = 0, beyond = 0;
  for (int y = 0; y + 1 < 240; ++y)
    for (int x = 0; x + 1 < 320; ++x) {
      const double d = image(x, y) - s.mean;
      across += d * (image(x + 1, y) - s.mean);
      down += d * (image(x, y + 1) - s.mean);
      fourth += d * d * d * d;
      beyond += std::abs(d) > 2 * std::sqrt(s.variance);
    }
  const double n = 319.0 * 239.0;
  CHECK(std::abs(across / n / s.variance) < 0.02);
  CHECK(std::abs(down / n / s.variance) < 0.02);
  CHECK(fourth / n / s.variance / s.variance == Approx(3.0).epsilon(0.05));
  CHECK(beyond / n == Approx(0.0455).epsilon(0.1));
}

TEST_CASE("light falls off to the corners", "[camera_simulation]") {
  ExposureOptions options;
  options.read_noise = options.shot_noise = 0;
  options.vignetting = 0.3;
  GrayImage image;
  Exposure(kCamera, options).develop(even(1.0f).view(), 1.0, 1, image);
  CHECK(image(160, 120) == 200);
  CHECK(image(0, 0) == 140);
  CHECK(image(319, 239) == 140);
  CHECK(image(159, 0) == Approx(200 * (1 - 0.3 * 0.36)).margin(1));
}

TEST_CASE("gamma brightens what is dark", "[camera_simulation]") {
  ExposureOptions options;
  options.read_noise = options.shot_noise = options.vignetting = 0;
  options.gamma = 2.2;
  GrayImage image;
  Exposure(kCamera, options).develop(even(0.25f).view(), 1.0, 1, image);
  CHECK(image(7, 7) == Approx(255 * std::pow(50.0 / 255, 1 / 2.2)).margin(0.6));
}

TEST_CASE("one seed gives one image", "[camera_simulation]") {
  const Exposure exposure(kCamera, {});
  GrayImage a, b, c;
  exposure.develop(even(0.5f).view(), 1.0, 9, a);
  exposure.develop(even(0.5f).view(), 1.0, 9, b);
  exposure.develop(even(0.5f).view(), 1.0, 10, c);
  int same = 0, other = 0;
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 320; ++x) same += a(x, y) == b(x, y), other += a(x, y) == c(x, y);
  CHECK(same == 320 * 240);
  CHECK(other < 320 * 240 / 2);
}

TEST_CASE("the automatic settles at once, then follows with its lag", "[camera_simulation]") {
  ExposureOptions options;
  options.vignetting = 0;
  const Exposure exposure(kCamera, options);
  AutoExposure automatic(options);
  const Image<float> bright = even(1.0f), dark = even(0.25f);
  const auto mean = [&](const Image<float>& radiance) {
    return [&](double gain) { return exposure.mean_grey(radiance.view(), gain); };
  };
  automatic.observe(0.1, mean(bright));
  CHECK(automatic.gain() * 200 == Approx(options.target).epsilon(0.01));
  const double before = std::log(automatic.gain());
  // The lag is where 1 - 1/e of the way is gone.
  for (int i = 0; i < 35; ++i) automatic.observe(0.01, mean(dark));
  const double way = std::log(automatic.gain()) - before;
  CHECK(way == Approx(std::log(4.0) * (1 - std::exp(-1.0))).epsilon(0.02));
  for (int i = 0; i < 1000; ++i) automatic.observe(0.01, mean(dark));
  CHECK(automatic.gain() * 50 == Approx(options.target).epsilon(0.01));
  automatic.jump(1.35);
  CHECK(automatic.gain() * 50 == Approx(1.35 * options.target).epsilon(0.01));
}

TEST_CASE("the gain has limits, and stops if asked to", "[camera_simulation]") {
  ExposureOptions options;
  const Exposure exposure(kCamera, options);
  const Image<float> night = even(1e-5f);
  AutoExposure automatic(options);
  for (int i = 0; i < 100; ++i)
    automatic.observe(1.0, [&](double gain) { return exposure.mean_grey(night.view(), gain); });
  CHECK(automatic.gain() == Approx(options.gain_max));
  options.step = 0.25;
  AutoExposure stops(options);
  stops.jump(1.1);
  CHECK(stops.gain() == Approx(1.0));
  stops.jump(1.1);
  CHECK(stops.gain() == Approx(1.25));
  options.automatic = false;
  AutoExposure fixed(options);
  fixed.jump(3.0);
  CHECK(fixed.gain() == 1.0);
}

TEST_CASE("impossible sensors are refused", "[camera_simulation]") {
  ExposureOptions options;
  options.gamma = 0;
  CHECK_THROWS_AS(Exposure(kCamera, options), Error);
  GrayImage image;
  const Image<float> small(10, 10);
  CHECK_THROWS_AS(Exposure(kCamera, {}).develop(small.view(), 1, 1, image), Error);
}
