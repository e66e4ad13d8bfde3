// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/direction/interpretation_plane.hpp"

#include <algorithm>
#include <numbers>

namespace sweepkit {

void interpretation_planes(const Camera& camera, std::span<const LineSegment> segments,
                           const SegmentTrustOptions& options, std::vector<InterpretationPlane>& planes,
                           const SO3d& R_frame_camera) {
  planes.clear();
  const Mat3<double> R = R_frame_camera.matrix();
  const double pixel = 2.0 / (camera.fx() + camera.fy());  // [rad] near the axis
  const auto limit = static_cast<std::size_t>(options.max_segments);

  // The length below which segments are left to longer ones; ties are kept.
  double shortest = options.min_length;
  if (segments.size() > limit) {
    std::vector<float> lengths;
    lengths.reserve(segments.size());
    for (const LineSegment& s : segments)
      if (const float length = s.length(); std::isfinite(length)) lengths.push_back(length);
    if (lengths.size() > limit) {
      std::nth_element(lengths.begin(), lengths.begin() + static_cast<std::ptrdiff_t>(limit) - 1,
                       lengths.end(), std::greater<>());
      shortest = std::max<double>(shortest, lengths[limit - 1]);
    }
  }

  for (std::size_t i = 0; i < segments.size(); ++i) {
    const LineSegment& s = segments[i];
    const double length = s.length();
    if (!std::isfinite(length) || length < shortest || planes.size() >= 2 * limit) continue;
    const auto begin = camera.unproject(Vec2<double>(s.x1, s.y1));
    const auto end = camera.unproject(Vec2<double>(s.x2, s.y2));
    if (!begin || !end) continue;
    const Vec3<double> a = begin->normalized(), b = end->normalized();
    const Vec3<double> normal = a.cross(b);
    const double sine = normal.norm();
    if (!(sine > 1e-6)) continue;
    InterpretationPlane plane;
    plane.normal = R * (normal / sine);
    plane.middle = R * (a + b).normalized();
    plane.along = plane.normal.cross(plane.middle);
    // Rays bend by less than a pixel of the axis away from it: the mean scale of the two ends.
    const double ray_sigma = options.endpoint_sigma * pixel * 0.5 * (a.z() + b.z());
    const double half = std::sin(0.5 * std::asin(std::min(sine, 1.0)));
    plane.turn_sigma = ray_sigma / (std::numbers::sqrt2 * half);
    plane.shift_sigma = ray_sigma / std::numbers::sqrt2;
    plane.length = length;
    plane.segment = static_cast<std::int32_t>(i);
    planes.push_back(plane);
  }
}

}  // namespace sweepkit
