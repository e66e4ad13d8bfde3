// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "sweepkit/core/sample.hpp"
#include "sweepkit/data/source.hpp"
#include "sweepkit/geometry/camera.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"

namespace sweepkit {

/// Looks at a box-shaped room with random patches on its walls, through a distorted stereo pair of 320x200
/// pixels. The body frame: x forward, y left, z up.
class Room {
 public:
  static constexpr int kWidth = 320, kHeight = 200;

  Room() : left_(camera(175.0, 161.0, 99.0, -0.1)), right_(camera(174.0, 158.5, 101.0, -0.09)) {
    Mat3<double> R;
    R << 0, 0, 1, -1, 0, 0, 0, -1, 0;
    const SO3d forward(R);
    T_body_left_ = SE3d(forward * SO3d::exp({0.01, 0.0, 0.005}), {0.1, 0.05, 0.1});
    T_body_right_ = SE3d(forward * SO3d::exp({0.0, 0.006, -0.004}), {0.1, -0.05, 0.101});
  }

  StereoRig rig() const { return StereoRig(left_, right_, T_body_left_, T_body_right_); }
  /// The cameras, and what tells motion, if anything does.
  Rig rig(const MotionSensors& motion) const {
    return {.left = MountedCamera{left_, T_body_left_, 10},
            .right = MountedCamera{right_, T_body_right_, 10},
            .imu = motion.imu,
            .wheels = motion.wheels};
  }

  StereoImage see(TimeNs t, const SE3d& T_world_body) const {
    return {t, draw(left_, T_world_body * T_body_left_), draw(right_, T_world_body * T_body_right_)};
  }

  static SharedGray black(int width = kWidth, int height = kHeight) {
    const NewGray image = make_gray(width, height);
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) image.pixels(x, y) = 0;
    return image.image;
  }

 private:
  static Camera camera(double focal, double cu, double cv, double k1) {
    return Camera({focal, focal, cu, cv}, Distortion::radial_tangential, {k1, 0.01, 0.0, 0.0}, kWidth,
                  kHeight);
  }

  static double patch(int surface, double a, double b, double size) {
    auto h = static_cast<std::uint32_t>(surface) * 0x9e3779b1U +
             static_cast<std::uint32_t>(static_cast<int>(std::floor(a / size))) * 0x85ebca6bU +
             static_cast<std::uint32_t>(static_cast<int>(std::floor(b / size))) * 0xc2b2ae35U;
    h = (h ^ (h >> 15)) * 0x2c1b3c6dU;
    h = (h ^ (h >> 12)) * 0x297a2d39U;
    return static_cast<double>((h ^ (h >> 15)) & 0xffffU) / 65535.0;
  }

  static double grey(const Vec3<double>& origin, const Vec3<double>& ray) {
    const Vec3<double> low(-1.5, -1.6, 0.0), high(2.5, 1.7, 1.4);
    double nearest = std::numeric_limits<double>::infinity();
    int axis = 0;
    for (int k = 0; k < 3; ++k) {
      const double t = ((ray[k] > 0 ? high[k] : low[k]) - origin[k]) / ray[k];
      if (t < nearest) nearest = t, axis = k;
    }
    const Vec3<double> p = origin + nearest * ray;
    const double a = p[axis == 0 ? 1 : 0], b = p[axis == 2 ? 1 : 2];
    const int surface = 2 * axis + (ray[axis] > 0 ? 1 : 0);
    return 20 + 130 * patch(surface, a, b, 0.17) + 90 * patch(surface + 8, a, b, 0.043);
  }

  // Four rays a pixel.
  static SharedGray draw(const Camera& camera, const SE3d& T_world_camera) {
    const NewGray image = make_gray(kWidth, kHeight);
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x) {
        double sum = 0;
        for (const double dy : {-0.25, 0.25})
          for (const double dx : {-0.25, 0.25})
            sum += grey(T_world_camera.translation(),
                        T_world_camera.rotation() * *camera.unproject({x + dx, y + dy}));
        image.pixels(x, y) = static_cast<std::uint8_t>(sum / 4 + 0.5);
      }
    return image.image;
  }

  Camera left_, right_;
  SE3d T_body_left_, T_body_right_;
};

inline constexpr TimeNs kFirstImage = 5 * kNsPerSecond, kImagePeriod = kNsPerSecond / 10;

/// T_world_body of a drive in a curve, 4 cm an image, from rest at the origin.
inline SE3d drive_pose(int image) {
  const double s = image < 2 ? 0.0 : 0.04 * (image - 2);
  return SE3d(SO3d::exp({0, 0, 0.4 * s}), {s * std::cos(0.2 * s), s * std::sin(0.2 * s), 0.0});
}

/// The images of the drive, drawn once. They may be shared: nobody writes to them.
inline const std::vector<StereoImage>& drive_images() {
  static const std::vector<StereoImage> images = [] {
    const Room room;
    std::vector<StereoImage> drawn;
    for (int i = 0; i < 24; ++i) drawn.push_back(room.see(kFirstImage + i * kImagePeriod, drive_pose(i)));
    return drawn;
  }();
  return images;
}

}  // namespace sweepkit
