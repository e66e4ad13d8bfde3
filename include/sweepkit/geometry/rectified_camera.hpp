// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>

#include "sweepkit/geometry/so3.hpp"

namespace sweepkit {

/// The rectified left camera of a stereo pair: a pinhole without distortion whose right partner stands
/// `baseline` along its x axis. A point at depth z has the disparity u - u_right = focal * baseline / z.
struct RectifiedCamera {
  double focal = 0.0;     ///< fx = fy [px]
  double cx = 0.0;        ///< [px]
  double cy = 0.0;        ///< [px]
  double baseline = 0.0;  ///< [m]

  /// Depth below which a point counts as behind the camera [m].
  static constexpr double kMinDepth = 1e-6;

  /// The pixel (u, v) of a point in the camera's frame; nothing if it is behind the camera.
  /// @param J d(u, v) / d p_camera
  std::optional<Vec2<double>> project(const Vec3<double>& p_camera,
                                      Eigen::Matrix<double, 2, 3>* J = nullptr) const {
    if (!(p_camera.z() > kMinDepth)) return std::nullopt;
    const double iz = 1.0 / p_camera.z();
    const double a = p_camera.x() * iz, b = p_camera.y() * iz, fz = focal * iz;
    if (J) *J << fz, 0.0, -fz * a, 0.0, fz, -fz * b;
    return Vec2<double>(cx + focal * a, cy + focal * b);
  }

  /// (u, v, u_right) of a point in the camera's frame; nothing if it is behind the camera.
  /// @param J d(u, v, u_right) / d p_camera
  std::optional<Vec3<double>> project_stereo(const Vec3<double>& p_camera, Mat3<double>* J = nullptr) const {
    if (!(p_camera.z() > kMinDepth)) return std::nullopt;
    const double iz = 1.0 / p_camera.z();
    const double a = p_camera.x() * iz, b = p_camera.y() * iz, fz = focal * iz;
    const double disparity = baseline * fz;
    if (J) *J << fz, 0.0, -fz * a, 0.0, fz, -fz * b, fz, 0.0, -fz * a + disparity * iz;
    const double u = cx + focal * a;
    return Vec3<double>(u, cy + focal * b, u - disparity);
  }

  /// The disparity of a depth, and the depth of a disparity (both positive).
  double disparity(double depth) const { return focal * baseline / depth; }
  double depth(double disparity) const { return focal * baseline / disparity; }

  /// A point with the uncertainty that its measurement gives it.
  struct StereoPoint {
    Vec3<double> p_camera;
    Mat3<double> covariance;  ///< [m^2]
  };

  /// The point seen at (u, v) with a disparity; nothing unless the disparity is positive.
  /// @param sigma standard deviation of u and v [px]
  /// @param sigma_disparity that of the disparity [px]; the three errors are taken as independent, as they
  ///   are when the disparity comes from matching the patch around (u, v)
  std::optional<StereoPoint> back_project(double u, double v, double disparity, double sigma,
                                          double sigma_disparity) const {
    if (!(disparity > 0.0)) return std::nullopt;
    const double z = depth(disparity);
    const Vec3<double> ray((u - cx) / focal, (v - cy) / focal, 1.0);
    StereoPoint point{z * ray, Mat3<double>::Zero()};
    const double lateral = sigma * z / focal;
    const double along = sigma_disparity * z / disparity;
    point.covariance(0, 0) = point.covariance(1, 1) = lateral * lateral;
    point.covariance += (along * along) * ray * ray.transpose();
    return point;
  }
};

}  // namespace sweepkit
