// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/camera_simulation.hpp"

#include <algorithm>
#include <array>
#include <numbers>

#include "sweepkit/core/random.hpp"

namespace sweepkit {
namespace {

constexpr std::size_t kQuantiles = 1 << 14;

// Means of the standard normal distribution over slices of equal probability, scaled to variance 1: a random
// index gives a normal number up to 4 sigma, many times faster than logarithm and cosine do.
const std::array<float, kQuantiles>& normal_quantiles() {
  static const std::array<float, kQuantiles> kTable = [] {
    const double root_two = std::numbers::sqrt2;
    std::array<float, kQuantiles> table{};
    double z = 0.0, squares = 0.0;
    // From the middle outwards: the quantile before is a good start for Newton's method.
    for (std::size_t i = kQuantiles / 2; i < kQuantiles; ++i) {
      const double tail = 1.0 - (static_cast<double>(i) + 0.5) / kQuantiles;
      for (int round = 0; round < 20; ++round) {
        const double density = std::exp(-0.5 * z * z) / std::sqrt(2.0 * std::numbers::pi);
        const double change = (0.5 * std::erfc(z / root_two) - tail) / density;
        z += std::clamp(change, -0.2, 0.2);
        if (std::abs(change) < 1e-9) break;
      }
      table[i] = static_cast<float>(z);
      squares += 2.0 * z * z / kQuantiles;
    }
    for (std::size_t i = kQuantiles / 2; i < kQuantiles; ++i) {
      table[i] = static_cast<float>(table[i] / std::sqrt(squares));
      table[kQuantiles - 1 - i] = -table[i];
    }
    return table;
  }();
  return kTable;
}

}  // namespace

Exposure::Exposure(const Camera& camera, const ExposureOptions& options)
    : options_(options),
      width_(camera.width()),
      height_(camera.height()),
      cx_(camera.cx()),
      cy_(camera.cy()) {
  check_options(options);
  const double x = std::max(cx_, width_ - 1 - cx_), y = std::max(cy_, height_ - 1 - cy_);
  inverse_r2_ = 1.0 / (x * x + y * y);
}

double Exposure::level(float linear) const {
  const double clipped = std::clamp(static_cast<double>(linear), 0.0, 255.0);
  return options_.gamma == 1.0 ? clipped : 255.0 * std::pow(clipped / 255.0, 1.0 / options_.gamma);
}

void Exposure::develop(View2d<const float> radiance, double gain, std::uint64_t seed,
                       GrayImage& image) const {
  require(radiance.width == width_ && radiance.height == height_, "Exposure::develop radiance",
          "must have the camera's size", radiance.width);
  image.resize(width_, height_);
  const auto& normals = normal_quantiles();
  Random random(seed);
  // Gamma by table: clipped, in 16ths of a grey level.
  std::array<std::uint8_t, 255 * 16 + 1> grey{};
  for (std::size_t i = 0; i < grey.size(); ++i)
    grey[i] = static_cast<std::uint8_t>(level(static_cast<float>(i) / 16.0f) + 0.5);
  const bool linear = options_.gamma == 1.0;
  const auto scale = static_cast<float>(options_.white * gain);
  const auto read = static_cast<float>(gain * gain * options_.read_noise * options_.read_noise);
  const auto shot = static_cast<float>(gain * options_.shot_noise);
  const auto fall = static_cast<float>(options_.vignetting * inverse_r2_);
  for (int y = 0; y < height_; ++y) {
    const float* light = radiance.row(y);
    std::uint8_t* out = image.row(y);
    const auto dy = static_cast<float>(y - cy_);
    std::uint64_t bits = 0;
    for (int x = 0; x < width_; ++x) {
      // Four numbers of 14 bits from each draw.
      if (x % 4 == 0) bits = random();
      const float normal = normals[bits & (kQuantiles - 1)];
      bits >>= 16;
      const auto dx = static_cast<float>(x - cx_);
      const float s = scale * light[x] * (1.0f - fall * (dx * dx + dy * dy));
      const float noisy = std::clamp(s + std::sqrt(read + shot * s) * normal, 0.0f, 255.0f);
      out[x] =
          linear ? static_cast<std::uint8_t>(noisy + 0.5f) : grey[static_cast<std::size_t>(16.0f * noisy)];
    }
  }
}

double Exposure::mean_grey(View2d<const float> radiance, double gain) const {
  double sum = 0.0;
  int count = 0;
  for (int y = 2; y < radiance.height; y += 4)
    for (int x = 2; x < radiance.width; x += 4) {
      const double r2 = (x - cx_) * (x - cx_) + (y - cy_) * (y - cy_);
      const double s =
          options_.white * gain * radiance(x, y) * (1.0 - options_.vignetting * inverse_r2_ * r2);
      sum += level(static_cast<float>(s));
      ++count;
    }
  return count > 0 ? sum / count : 0.0;
}

double AutoExposure::gain() const {
  if (!options_.automatic) return 1.0;
  double log_gain = log_gain_;
  if (options_.step > 0.0) {
    const double stop = std::log1p(options_.step);
    log_gain = stop * std::round(log_gain / stop);
  }
  return std::clamp(std::exp(log_gain), options_.gain_min, options_.gain_max);
}

void AutoExposure::follow(double share, double mean) {
  if (!options_.automatic) return;
  // No camera goes by more than some stops at once.
  constexpr double kMost = 1.5;
  const double change = std::clamp(std::log(options_.target / std::max(mean, 0.5)), -kMost, kMost);
  log_gain_ =
      std::clamp(log_gain_ + share * change, std::log(options_.gain_min), std::log(options_.gain_max));
}

}  // namespace sweepkit
