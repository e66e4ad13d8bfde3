// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/floor/floor_tolerance.hpp"
#include "sweepkit/floor/obstacle_mask.hpp"
#include "sweepkit/floor/obstacles.hpp"
#include "sweepkit/image/image.hpp"

/// A floor with boxes on it, as disparities: each pixel's ray is cut with all surfaces.
namespace box_world {

using namespace sweepkit;

/// Between two corners of the frame of the floor below the camera (floor_frame): x forward, y left, z up.
struct Box {
  Vec3<double> low, high;
};

/// A part of the floor that lies lower.
struct Pit {
  Vec2<double> low, high;
  double depth;
};

struct World {
  RectifiedCamera camera{173.0, 159.5, 95.5, 0.06};
  GroundPlane plane{Vec3<double>(0.01, std::cos(0.05), std::sin(0.05)).normalized(), 0.08};
  std::vector<Box> boxes;
  std::vector<Pit> pits;
  double far_wall = 4.0;
  int width = 320, height = 200;

  /// The disparity at a pixel seen from a camera that stands at `shift` on the floor.
  double disparity(int u, int v, const Vec2<double>& shift = {0, 0}) const {
    const SE3d T = floor_frame(plane);
    const Vec3<double> d =
        T.rotation() * Vec3<double>((u - camera.cx) / camera.focal, (v - camera.cy) / camera.focal, 1.0);
    const Vec3<double> o = T.translation() + Vec3<double>(shift.x(), shift.y(), 0);
    double best = far_wall / d.x();
    if (d.z() < 0) {
      double s = -o.z() / d.z();
      const Vec3<double> p = o + s * d;
      for (const Pit& pit : pits)
        if ((p.head<2>().array() > pit.low.array()).all() && (p.head<2>().array() < pit.high.array()).all()) {
          // Its bottom, or the wall at its far side.
          const double bottom = -(o.z() + pit.depth) / d.z(), side = (pit.high.x() - o.x()) / d.x();
          s = std::min(bottom, side);
        }
      best = std::min(best, s);
    }
    for (const Box& box : boxes) {
      double in = 0, out = std::numeric_limits<double>::infinity();
      for (int k = 0; k < 3; ++k) {
        const double a = (box.low[k] - o[k]) / d[k], b = (box.high[k] - o[k]) / d[k];
        in = std::max(in, std::min(a, b));
        out = std::min(out, std::max(a, b));
      }
      if (in < out && in > 0) best = std::min(best, in);
    }
    // The ray's z is 1 in the camera.
    return camera.focal * camera.baseline / best;
  }

  Image<float> disparities(double noise = 0, const Vec2<double>& shift = {0, 0},
                           std::uint64_t seed = 1) const {
    Random random(seed);
    Image<float> image(width, height);
    for (int v = 0; v < height; ++v)
      for (int u = 0; u < width; ++u)
        image(u, v) = static_cast<float>(disparity(u, v, shift) + noise * random.normal());
    return image;
  }

  GrayImage mask(const Image<float>& disparities, const FloorNoise& noise = {}) const {
    GrayImage mask(disparities.width(), disparities.height());
    obstacle_mask(disparities.view(), plane.disparity(camera), FloorTolerance::of(noise, plane, camera),
                  mask.view());
    return mask;
  }
};

/// A box of a size [m] that stands on the floor, its near face at a distance.
inline Box standing(double distance, double left, double length, double width, double height) {
  return {{distance, left - 0.5 * width, 0}, {distance + length, left + 0.5 * width, height}};
}

}  // namespace box_world
