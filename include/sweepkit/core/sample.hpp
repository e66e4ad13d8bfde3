// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <variant>

#include "sweepkit/core/time.hpp"
#include "sweepkit/core/view.hpp"

namespace sweepkit {

/// A reading of the inertial unit, in its own frame.
struct ImuSample {
  TimeNs t = 0;
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();   ///< angular rate [rad/s]
  Eigen::Vector3d accel = Eigen::Vector3d::Zero();  ///< specific force: points up at rest [m/s^2]
};

/// What the two numbers of a wheel sample are.
enum class WheelReading {
  ticks,   ///< cumulative encoder counts, forward positive, any start value
  speeds,  ///< speed of the wheel over the interval that ends at the stamp [m/s]
};

/// A reading of the two drive wheels. A log of forward speed v and turn rate w is carried as speeds v -+ w b
/// / 2 with the track width b of WheelGeometry, which gives v and w back.
struct WheelSample {
  TimeNs t = 0;
  WheelReading reading = WheelReading::ticks;
  double left = 0.0;   ///< [ticks] or [m/s]
  double right = 0.0;  ///< [ticks] or [m/s]
};

/// An 8-bit grey image whose pixels somebody keeps alive: a view together with a share in the owner. Cheap to
/// copy; empty if there is no image.
struct SharedGray {
  GrayView view;
  std::shared_ptr<const void> owner;

  bool empty() const { return view.empty(); }
};

/// New pixels, not set, that can be written through `pixels` until the image is handed on.
struct NewGray {
  SharedGray image;
  View2d<std::uint8_t> pixels;
};

/// Allocates an image of that size [pixels]; rows follow one another without padding.
inline NewGray make_gray(int width, int height) {
  std::shared_ptr<std::uint8_t[]> owner(new std::uint8_t[static_cast<std::size_t>(width) * height]);
  const View2d<std::uint8_t> pixels(owner.get(), width, height);
  return {{pixels, std::move(owner)}, pixels};
}

/// The images of both cameras at one instant. One of them may be empty: that camera gave none.
struct StereoImage {
  TimeNs t = 0;
  SharedGray left;
  SharedGray right;
};

/// What a source delivers.
using Sample = std::variant<ImuSample, WheelSample, StereoImage>;

inline TimeNs stamp(const Sample& sample) {
  return std::visit([](const auto& s) { return s.t; }, sample);
}

/// Noise of an inertial unit as continuous-time densities, as data sheets give them.
struct ImuNoise {
  double gyro_noise_density = 2e-4;   ///< [rad/s/sqrt(Hz)]
  double gyro_random_walk = 2e-5;     ///< [rad/s^2/sqrt(Hz)]
  double accel_noise_density = 2e-3;  ///< [m/s^2/sqrt(Hz)]
  double accel_random_walk = 3e-3;    ///< [m/s^3/sqrt(Hz)]
};

/// Nominal measures of a differential drive.
struct WheelGeometry {
  double ticks_per_revolution = 1.0;
  double wheel_radius = 1.0;  ///< [m]
  double track_width = 1.0;   ///< between the wheels [m]

  double metres_per_tick() const {
    constexpr double kTwoPi = 6.283185307179586;
    return kTwoPi * wheel_radius / ticks_per_revolution;
  }
};

}  // namespace sweepkit
