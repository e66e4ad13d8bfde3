// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdint>

#include "sweepkit/core/options.hpp"
#include "sweepkit/geometry/camera.hpp"
#include "sweepkit/image/image.hpp"

namespace sweepkit {

/// How a sensor turns light into grey levels.
struct ExposureOptions {
  bool automatic = true;
  double target = 105.0;
  double lag = 0.35;
  double step = 0.0;
  double white = 200.0;
  double gain_min = 0.05;
  double gain_max = 16.0;
  double vignetting = 0.2;
  double read_noise = 0.75;
  double shot_noise = 0.005;
  double gamma = 1.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(automatic, "automatic", "", any_value(), "follows the light; otherwise the gain stays at 1");
    v(target, "target", "", range(1.0, 254.0), "mean of an image that the automatic aims at [grey levels]");
    v(lag, "lag", "s", range(0.0, 60.0), "in which the automatic comes closer by 1 - 1/e");
    v(step, "step", "", range(0.0, 1.0),
      "the gain goes in steps of this share, as in sensors with stops; 0: at will");
    v(white, "white", "", range(1.0, 10000.0),
      "what white paper in a lit room gives at gain 1 [grey levels]");
    v(gain_min, "gain_min", "", range(1e-4, 1.0), "smallest gain");
    v(gain_max, "gain_max", "", range(1.0, 1000.0), "largest gain: what is darker stays dark");
    v(vignetting, "vignetting", "", range(0.0, 0.9),
      "light that is lost in the corners; in between it goes with r^2");
    v(read_noise, "read_noise", "", range(0.0, 50.0), "standard deviation at gain 1 [grey levels]");
    v(shot_noise, "shot_noise", "", range(0.0, 5.0), "variance a grey level at gain 1 [grey levels]");
    v(gamma, "gamma", "", range(0.2, 5.0), "a pixel of linear level g gets 255 (g / 255)^(1 / gamma)");
  }
};

/// Turns radiance into 8-bit images. With the gain k a pixel of radiance L gets the linear level
/// s = white k v L, v the vignetting, and noise of the variance k^2 read_noise^2 + k shot_noise s: gain makes
/// noise of both kinds stronger. Then gamma, and rounding to 0 .. 255.
class Exposure {
 public:
  Exposure(const Camera& camera, const ExposureOptions& options);

  /// @param seed of the noise; one seed gives one image
  void develop(View2d<const float> radiance, double gain, std::uint64_t seed, GrayImage& image) const;
  /// The mean grey level of such an image without noise, from one pixel in 16.
  double mean_grey(View2d<const float> radiance, double gain) const;

  const ExposureOptions& options() const { return options_; }

 private:
  double level(float linear) const;

  ExposureOptions options_;
  int width_, height_;
  double cx_, cy_, inverse_r2_;
};

/// Follows the light as a camera does: the gain of an image is told from the images before it.
class AutoExposure {
 public:
  explicit AutoExposure(const ExposureOptions& options) : options_(options) {}

  /// The gain of the next image.
  double gain() const;
  /// Learns from an image and the time to the next one [s]. The first call settles at once, given `mean_of`,
  /// the mean grey level that a gain gives.
  template <class MeanOf>
  void observe(double dt, const MeanOf& mean_of) {
    if (!settled_) {
      settled_ = true;
      // A clipped mean is met from above: some rounds.
      for (int i = 0; i < 12; ++i) follow(1.0, mean_of(gain()));
    }
    follow(share(dt), mean_of(gain()));
  }
  /// The gain jumps by a factor; the automatic then takes it back.
  void jump(double factor) { log_gain_ += options_.automatic ? std::log(factor) : 0.0; }

 private:
  double share(double dt) const { return options_.lag > 0.0 ? 1.0 - std::exp(-dt / options_.lag) : 1.0; }
  void follow(double share, double mean);

  ExposureOptions options_;
  double log_gain_ = 0.0;
  bool settled_ = false;
};

}  // namespace sweepkit
