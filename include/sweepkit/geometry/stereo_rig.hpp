// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cmath>
#include <concepts>
#include <cstdint>
#include <memory>
#include <optional>
#include <ranges>
#include <span>

#include "sweepkit/geometry/camera.hpp"
#include "sweepkit/geometry/rectification_table.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

enum class Side { left, right };

/// Anything with the members x and y [px], such as a key point.
template <class P>
concept PixelPosition = requires(const P p) {
  { p.x } -> std::convertible_to<float>;
  { p.y } -> std::convertible_to<float>;
};

/// Two cameras fixed to a body, and the rectified pair they stand for: both cameras turned about their
/// centres so that x runs along the baseline from left to right and z lies as near as can be to both optical
/// axes (Fusiello, Trucco, Verri, A compact algorithm for rectification of stereo pairs, 2000, made
/// symmetric); one virtual pinhole without distortion for both. Only points are rectified, never images.
/// "camera" below is the rectified left camera; "raw" are the cameras as they are.
/// A rig that is rectified already (no distortion, equal intrinsics with fx = fy, parallel cameras) is left
/// exactly as it is. Immutable; any number of threads may use one; copies are cheap.
class StereoRig {
 public:
  /// Throws Error(calibration) for a baseline below 0.1 mm, one along the viewing axis or against the x axis
  /// (cameras taken for each other), or optical axes more than 60 degrees apart.
  StereoRig(const Camera& left, const Camera& right, const SE3d& T_body_left, const SE3d& T_body_right);
  /// From 4x4 matrices as calibration files hold them; throws Error(calibration) also where a value is not
  /// finite, a rotation part not a rotation (to 1e-3) or the last row not 0 0 0 1.
  StereoRig(const Camera& left, const Camera& right, const Eigen::Matrix4d& T_body_left,
            const Eigen::Matrix4d& T_body_right);

  /// The raw camera of a side.
  const Camera& camera(Side side) const { return side == Side::left ? left_ : right_; }
  const SE3d& T_body_raw(Side side) const { return side == Side::left ? T_body_left_ : T_body_right_; }
  /// From the raw right camera to the raw left one.
  SE3d T_left_right() const { return T_body_left_.inverse() * T_body_right_; }

  /// Focal length of the virtual pinhole, in x and y: the mean of the raw ones, which keeps the resolution
  /// [px].
  double focal() const { return focal_; }
  /// Principal point of the virtual pinhole, the same on both sides [px].
  const Vec2<double>& center() const { return center_; }
  /// Distance of the two centres of projection [m].
  double baseline() const { return baseline_; }
  /// Rectified left camera to body. The rectified right camera stands `baseline` farther along x.
  const SE3d& T_body_camera() const { return T_body_camera_; }
  /// R_camera_raw: turns rays of a raw camera into the rectified frame.
  const Mat3<double>& R_camera_raw(Side side) const { return R_camera_raw_[static_cast<int>(side)]; }
  /// Whether rectification changes nothing.
  bool is_rectified() const { return is_rectified_; }

  /// The rectangle that rectified positions of pixels of a raw image fill, over both sides [px].
  struct Bounds {
    double u_min, u_max, v_min, v_max;
  };
  const Bounds& bounds() const { return bounds_; }

  /// Raw pixel to rectified position, exact; nullopt where the camera's model does not hold or the ray runs
  /// more than 85 degrees off the rectified axis.
  /// @param J derivative of the rectified position by the pixel, if not null
  std::optional<Vec2<double>> rectify(Side side, const Vec2<double>& pixel,
                                      Eigen::Matrix2d* J = nullptr) const;
  /// Rectified position to raw pixel, exact: the inverse of rectify. The pixel may lie outside the image.
  /// @param J derivative of the pixel by the rectified position, if not null
  std::optional<Vec2<double>> unrectify(Side side, const Vec2<double>& rectified,
                                        Eigen::Matrix2d* J = nullptr) const;

  /// The table behind rectify_fast of a side, to see how much of the image it answers for; empty if
  /// is_rectified().
  const RectificationTable& table(Side side) const { return (*tables_)[static_cast<int>(side)]; }

  /// As rectify, to within 1e-3 px, by a table in most of the image.
  std::optional<Vec2<float>> rectify_fast(Side side, const Vec2<float>& pixel) const {
    Vec2<float> rectified;
    if (!rectify_into(side, pixel.x(), pixel.y(), rectified)) return std::nullopt;
    return rectified;
  }
  /// Also gives the derivative of the rectified position by the pixel, for warping patches.
  std::optional<Vec2<float>> rectify_fast(Side side, const Vec2<float>& pixel, Eigen::Matrix2f& J) const;
  /// As unrectify, in single precision (to about 1e-3 px).
  std::optional<Vec2<float>> unrectify_fast(Side side, const Vec2<float>& rectified,
                                            Eigen::Matrix2f* J = nullptr) const;

  /// As rectify_fast for many points at once.
  /// @param pixels a contiguous range of PixelPosition (key points)
  /// @param rectified as many places; (0, 0) is written for points that cannot be rectified
  /// @param valid as many places; 1 where the point was rectified, else 0
  /// Returns the number of valid points; throws Error(argument) if the lengths differ.
  template <std::ranges::contiguous_range Points>
  requires PixelPosition<std::ranges::range_value_t<Points>> std::size_t rectify(
      Side side, const Points& pixels, std::span<Vec2<float>> rectified, std::span<std::uint8_t> valid)
  const {
    const std::size_t count = std::ranges::size(pixels);
    require(rectified.size() == count, "StereoRig::rectify rectified", "must be as long as pixels",
            rectified.size());
    require(valid.size() == count, "StereoRig::rectify valid", "must be as long as pixels", valid.size());
    std::size_t good = 0;
    const auto* pixel = std::ranges::data(pixels);
    for (std::size_t i = 0; i < count; ++i) {
      const bool ok = rectify_into(side, pixel[i].x, pixel[i].y, rectified[i]);
      if (!ok) rectified[i].setZero();
      valid[i] = ok;
      good += ok;
    }
    return good;
  }

  /// Depth along the rectified axis of a disparity [m]; the disparity must be positive [px].
  template <class S>
  S depth_from_disparity(const S& disparity) const {
    return S(focal_ * baseline_) / disparity;
  }
  /// (u_left, v, disparity) in the rectified pair to the point in the rectified left camera; nullopt for a
  /// disparity that is not positive.
  /// @param J derivative of the point by (u, v, disparity), if not null
  template <class S>
  std::optional<Vec3<S>> point_from_disparity(const Vec3<S>& uvd, Mat3<S>* J = nullptr) const;
  /// A point in the rectified left camera to (u_left, v, disparity); nullopt behind the camera.
  /// @param J derivative of (u, v, disparity) by the point, if not null
  template <class S>
  std::optional<Vec3<S>> project_stereo(const Vec3<S>& p_camera, Mat3<S>* J = nullptr) const;
  /// Covariance of point_from_disparity to first order [m^2], from the standard deviations of u_left and v
  /// and of the disparity, taken as independent [px]; the disparity must be positive.
  Mat3<double> point_covariance(const Vec3<double>& uvd, double sigma_pixel, double sigma_disparity) const;

 private:
  bool rectify_into(Side side, float x, float y, Vec2<float>& rectified) const {
    if (is_rectified_) {
      rectified = {x, y};
      return std::isfinite(x) && std::isfinite(y);
    }
    if ((*tables_)[static_cast<int>(side)].lookup(x, y, rectified)) [[likely]]
      return true;
    const std::optional<Vec2<double>> exact = rectify(side, Vec2<double>(x, y));
    if (exact) rectified = exact->cast<float>();
    return exact.has_value();
  }

  Camera left_, right_;
  SE3d T_body_left_, T_body_right_, T_body_camera_;
  Mat3<double> R_camera_raw_[2];
  double focal_ = 0, baseline_ = 0;
  Vec2<double> center_;
  Bounds bounds_{};
  bool is_rectified_ = false;
  std::shared_ptr<const std::array<RectificationTable, 2>> tables_;
};

template <class S>
std::optional<Vec3<S>> StereoRig::point_from_disparity(const Vec3<S>& uvd, Mat3<S>* J) const {
  if (!(uvd.z() > S(0))) return std::nullopt;
  const S scale = S(baseline_) / uvd.z();
  const Vec3<S> p = scale * Vec3<S>(uvd.x() - S(center_.x()), uvd.y() - S(center_.y()), S(focal_));
  if (J) {
    *J << scale, S(0), -p.x() / uvd.z(),  //
        S(0), scale, -p.y() / uvd.z(),    //
        S(0), S(0), -p.z() / uvd.z();
  }
  return p;
}

template <class S>
std::optional<Vec3<S>> StereoRig::project_stereo(const Vec3<S>& p_camera, Mat3<S>* J) const {
  if (!(p_camera.z() > S(0))) return std::nullopt;
  const S scale = S(focal_) / p_camera.z();
  const Vec3<S> projected = scale * Vec3<S>(p_camera.x(), p_camera.y(), S(baseline_));
  if (J) {
    *J << scale, S(0), -projected.x() / p_camera.z(),  //
        S(0), scale, -projected.y() / p_camera.z(),    //
        S(0), S(0), -projected.z() / p_camera.z();
  }
  return Vec3<S>(projected.x() + S(center_.x()), projected.y() + S(center_.y()), projected.z());
}

}  // namespace sweepkit
