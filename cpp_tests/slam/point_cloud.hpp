// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/slam/scale_levels.hpp"
#include "sweepkit/slam/stereo_frame.hpp"

namespace sweepkit {

/// Points in front of a stereo camera, each with a descriptor of its own: frames as the front end would make
/// them, without images.
class PointCloud {
 public:
  static constexpr double kWidth = 640, kHeight = 400;

  PointCloud(int count, std::uint64_t seed) {
    Random random(seed);
    for (int i = 0; i < count; ++i) {
      points_.emplace_back(random.uniform(-2.5, 2.5), random.uniform(-1.2, 1.2), random.uniform(1.5, 5.0));
      OrbDescriptor descriptor;
      for (auto& word : descriptor.words) word = random();
      descriptors_.push_back(descriptor);
    }
  }

  RectifiedCamera camera() const { return {.focal = 350, .cx = 319.5, .cy = 199.5, .baseline = 0.1}; }
  StereoRig::Bounds view() const { return {0, kWidth - 1, 0, kHeight - 1}; }
  ScaleLevels levels() const { return {1.2, 8}; }
  const std::vector<Vec3<double>>& points() const { return points_; }

  /// The frame from a pose, with noise: `sigma` of u and v [px], half of it of the disparity; of each
  /// descriptor a few bits flip, and those of a share `wrong` of the points are exchanged for others'.
  StereoFrame see(const SE3d& T_camera_world, double sigma, std::uint64_t seed, double wrong = 0,
                  TimeNs t = 0) const {
    Random random(seed);
    StereoFrame frame;
    frame.t = t;
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const Vec3<double> p = T_camera_world * points_[i];
      const double du = sigma * random.normal(), dv = sigma * random.normal(),
                   dd = 0.5 * sigma * random.normal();
      const bool exchanged = random.uniform() < wrong;
      const auto flips = random();
      const auto uvr = camera().project_stereo(p);
      if (!uvr || uvr->x() < 0 || uvr->x() > kWidth || uvr->y() < 0 || uvr->y() > kHeight) continue;
      const double disparity = uvr->x() - uvr->z() + dd;
      if (disparity < 1) continue;
      Measurement m;
      m.u = static_cast<float>(uvr->x() + du);
      m.v = static_cast<float>(uvr->y() + dv);
      m.u_right = static_cast<float>(uvr->x() + du - disparity);
      m.sigma = static_cast<float>(sigma);
      m.sigma_right = static_cast<float>(0.5 * sigma);
      // A right column left of the image is no match.
      if (m.u_right < 0) m.u_right = -1;
      frame.measurements.push_back(m);
      OrbDescriptor descriptor = descriptors_[exchanged ? (i + 7) % points_.size() : i];
      for (int k = 0; k < 8; ++k) descriptor.words[k % 4] ^= std::uint64_t{1} << ((flips >> (6 * k)) & 63U);
      frame.descriptors.push_back(descriptor);
    }
    frame.grid.build(frame.measurements);
    return frame;
  }

 private:
  std::vector<Vec3<double>> points_;
  std::vector<OrbDescriptor> descriptors_;
};

}  // namespace sweepkit
