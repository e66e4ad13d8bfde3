// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <optional>

#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// A straight edge in space, between two points, with how uncertain these are. Along the edge they are as
/// uncertain as the ends of its image, across it as the line is.
struct Segment3d {
  Vec3<double> p1 = Vec3<double>::Zero();  ///< [m]
  Vec3<double> p2 = Vec3<double>::Zero();
  Mat3<double> covariance1 = Mat3<double>::Zero();  ///< of p1 [m^2]
  Mat3<double> covariance2 = Mat3<double>::Zero();  ///< of p2

  double length() const { return (p2 - p1).norm(); }
  Vec3<double> direction() const { return (p2 - p1).normalized(); }
};

/// The segment in another frame.
inline Segment3d transformed(const SE3d& T_a_b, const Segment3d& segment_b) {
  const Mat3<double> R = T_a_b.rotation().matrix();
  return {T_a_b * segment_b.p1, T_a_b * segment_b.p2, R * segment_b.covariance1 * R.transpose(),
          R * segment_b.covariance2 * R.transpose()};
}

/// One view of a segment: rays to its two ends, in the frame of the camera and of any length.
struct SegmentView {
  Vec3<double> ray1, ray2;
  double sigma1 = 1e-3, sigma2 = 1e-3;  ///< standard deviations of the ends across the segment [rad]
  double sigma_along = 2e-3;            ///< that of an end along the segment [rad]
};

/// Where the rays to the ends of a segment in view a meet the plane of the segment as view b sees it. The
/// ends need not be the same in b: it only has to be the same line (R. Hartley, A. Zisserman, Multiple View
/// Geometry, 2004, section 15). Covariances are to first order.
/// @param T_a_b pose of camera b in a
/// @param min_angle rays of a that run nearer than this to the plane of b do not meet it reliably [rad]
/// @return the segment in a; nothing if a ray is nearly in the plane, a point behind one of the cameras, a
/// ray
///   zero or not finite, or two rays the same
inline std::optional<Segment3d> triangulate_segment(const SE3d& T_a_b, const SegmentView& a,
                                                    const SegmentView& b, double min_angle = 5e-3) {
  const Vec3<double> a1 = a.ray1.normalized(), a2 = a.ray2.normalized();
  const Vec3<double> b1 = b.ray1.normalized(), b2 = b.ray2.normalized();
  const Mat3<double> R = T_a_b.rotation().matrix();
  const Vec3<double> center = T_a_b.translation();
  const Vec3<double> cross_a = a1.cross(a2), cross_b = R * b1.cross(b2);
  const double angle_a = std::atan2(cross_a.norm(), a1.dot(a2)),
               angle_b = std::atan2(cross_b.norm(), b1.dot(b2));
  if (!(angle_a > 1e-9) || !(angle_b > 1e-9)) return std::nullopt;
  const Vec3<double> normal_a = cross_a.normalized(), normal_b = cross_b.normalized();
  // Angle of a ray from the middle of b, in the plane of b: to tell how far the line's error is carried.
  const Vec3<double> middle_b = (R * (b1 + b2)).normalized(), forward_b = normal_b.cross(middle_b);

  Segment3d segment;
  const Vec3<double>* rays[2] = {&a1, &a2};
  const double sigmas[2] = {a.sigma1, a.sigma2};
  Vec3<double>* points[2] = {&segment.p1, &segment.p2};
  for (int i = 0; i < 2; ++i) {
    const double slope = normal_b.dot(*rays[i]);
    const double depth = normal_b.dot(center) / slope;
    if (!(std::abs(slope) >= min_angle) || !(depth > 0)) return std::nullopt;
    *points[i] = depth * *rays[i];
    if (!((*points[i] - center).dot(middle_b) > 0)) return std::nullopt;
  }
  Mat3<double>* covariances[2] = {&segment.covariance1, &segment.covariance2};
  const Vec3<double> per_angle = (segment.p2 - segment.p1) / angle_a;
  for (int i = 0; i < 2; ++i) {
    const Vec3<double>&ray = *rays[i], &p = *points[i];
    const double slope = normal_b.dot(ray), depth = p.norm();
    // The ray turned by an angle across the segment: it moves and meets the plane elsewhere.
    const Vec3<double> by_ray = depth * (normal_a - ray * (normal_b.dot(normal_a) / slope));
    // The plane of b turned so that it moves by an angle as b sees the point; between its ends their standard
    // deviations, beyond them carried on in proportion.
    const Vec3<double> from_b = p - center;
    const double place =
        2 * std::atan2(from_b.dot(forward_b), from_b.dot(middle_b)) / angle_b;  // ends at -1, 1
    const double w1 = 0.5 * (1 - place), w2 = 0.5 * (1 + place);
    const double sigma_b = std::hypot(w1 * b.sigma1, w2 * b.sigma2);
    const Vec3<double> by_plane = ray * (from_b.norm() / slope);
    *covariances[i] = sigmas[i] * sigmas[i] * by_ray * by_ray.transpose() +
                      sigma_b * sigma_b * by_plane * by_plane.transpose() +
                      a.sigma_along * a.sigma_along * per_angle * per_angle.transpose();
  }
  return segment;
}

}  // namespace sweepkit
