// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/image/disparity.hpp"

namespace sweepkit {

/// The disparity that the floor has at a pixel: `at_origin + along_u * u + along_v * v` [px]. Linear in row
/// and column for any tilt of the camera; not positive above the floor's horizon, where there is no floor to
/// see.
struct FloorDisparity {
  double at_origin = 0.0;
  double along_u = 0.0;
  double along_v = 0.0;

  double operator()(double u, double v) const { return at_origin + along_u * u + along_v * v; }

  /// What dense matching should expect of a floor like this one: its disparities in column u.
  DisparityRamp ramp(double u) const { return {(*this)(u, 0.0), along_v}; }
};

/// The floor seen from a camera: the points with `down_camera . p_camera = height`.
struct GroundPlane {
  Vec3<double> down_camera =
      Vec3<double>::UnitY();  ///< unit normal of the floor, pointing down, in the camera's frame
  double height = 0.0;        ///< of the camera's centre above the floor [m], positive

  /// How far a point is above the floor [m]; negative below it.
  double height_of(const Vec3<double>& p_camera) const { return height - down_camera.dot(p_camera); }

  /// A pixel's ray r = (x, y, 1) meets the floor at depth height / (down . r), hence the disparity
  /// focal * baseline * (down . r) / height: exact for any tilt.
  FloorDisparity disparity(const RectifiedCamera& camera) const {
    const double per_slope = camera.focal * camera.baseline / height;
    FloorDisparity floor;
    floor.along_u = per_slope * down_camera.x() / camera.focal;
    floor.along_v = per_slope * down_camera.y() / camera.focal;
    floor.at_origin = per_slope * down_camera.z() - floor.along_u * camera.cx - floor.along_v * camera.cy;
    return floor;
  }

  /// The plane that has this disparity; the inverse of `disparity`. `floor` must not be zero everywhere.
  static GroundPlane of(const FloorDisparity& floor, const RectifiedCamera& camera) {
    const Vec3<double> down(floor.along_u * camera.focal, floor.along_v * camera.focal,
                            floor(camera.cx, camera.cy));  // times height / (focal baseline) it is the normal
    const double norm = down.norm();
    return {down / norm, camera.focal * camera.baseline / norm};
  }
};

}  // namespace sweepkit
