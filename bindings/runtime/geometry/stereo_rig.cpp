// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/stereo_rig.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <sstream>
#include <string>

namespace sweepkit {
namespace {

/// A rectified ray nearer to the image plane than this is taken as lost: cos(85 degrees) in terms of z / |p|.
constexpr double kMinRectifiedCosine = 0.08715574274765817;

[[noreturn]] void rig_fails(const char* place, const char* message, double value) {
  std::ostringstream text;
  text << value;
  throw Error(ErrorKind::calibration, place, message, text.str());
}

/// A 4x4 matrix as a rigid motion, or an Error(calibration) that names what is wrong with it.
SE3d checked_motion(const Eigen::Matrix4d& T, const char* place) {
  for (int i = 0; i < 16; ++i)
    if (!std::isfinite(T(i / 4, i % 4))) rig_fails(place, "must be finite", T(i / 4, i % 4));
  const Eigen::RowVector4d last(0, 0, 0, 1);
  const double last_error = (T.row(3) - last).cwiseAbs().maxCoeff();
  if (last_error > 1e-9) rig_fails(place, "its last row must be 0 0 0 1; it is off by", last_error);
  const Mat3<double> R = T.topLeftCorner<3, 3>();
  const double error = (R.transpose() * R - Mat3<double>::Identity()).cwiseAbs().maxCoeff();
  if (error > 1e-3) rig_fails(place, "its rotation part is not orthogonal; R^T R is off by", error);
  if (R.determinant() < 0)
    rig_fails(place, "its rotation part mirrors space; its determinant is", R.determinant());
  return SE3d(T);
}

}  // namespace

StereoRig::StereoRig(const Camera& left, const Camera& right, const Eigen::Matrix4d& T_body_left,
                     const Eigen::Matrix4d& T_body_right)
    : StereoRig(left, right, checked_motion(T_body_left, "T_body_left"),
                checked_motion(T_body_right, "T_body_right")) {}

StereoRig::StereoRig(const Camera& left, const Camera& right, const SE3d& T_body_left,
                     const SE3d& T_body_right)
    : left_(left), right_(right), T_body_left_(T_body_left), T_body_right_(T_body_right) {
  constexpr double kMinBaseline = 1e-4;  // [m]
  const SE3d T_left_right = T_body_left.inverse() * T_body_right;
  const Mat3<double> R_left_right = T_left_right.rotation().matrix();
  if (!T_body_left.matrix().allFinite())
    rig_fails("T_body_left", "must be finite", T_body_left.matrix().sum());
  if (!T_body_right.matrix().allFinite())
    rig_fails("T_body_right", "must be finite", T_body_right.matrix().sum());
  baseline_ = T_left_right.translation().norm();
  if (!(baseline_ >= kMinBaseline)) rig_fails("baseline", "is zero or too small [m]", baseline_);

  // The axes of the rectified frame, in the raw left camera.
  const Vec3<double> x_axis = T_left_right.translation() / baseline_;
  const double axes_cosine = R_left_right(2, 2);
  if (axes_cosine < 0.5)
    rig_fails("T_body_right", "the optical axes are more than 60 degrees apart [deg]",
              std::acos(std::clamp(axes_cosine, -1.0, 1.0)) * 180 / M_PI);
  const Vec3<double> mean_axis = (Vec3<double>::UnitZ() + R_left_right.col(2)).normalized();
  const double along_view = x_axis.dot(mean_axis);
  if (std::abs(along_view) > std::sqrt(0.75))
    rig_fails("T_body_right", "the baseline runs along the viewing axis; its angle to it [deg]",
              std::acos(std::min(1.0, std::abs(along_view))) * 180 / M_PI);
  // A pair that is mounted upright has its x axis square to the baseline; only a clear opposite is a mistake.
  if (x_axis.x() < -0.5)
    rig_fails("T_body_right", "the right camera stands left of the left one; their distance along x [m]",
              T_left_right.translation().x());
  const Vec3<double> z_axis = (mean_axis - along_view * x_axis).normalized();
  Mat3<double> R_left_camera;
  R_left_camera << x_axis, z_axis.cross(x_axis), z_axis;

  // Already rectified, to the precision that calibration files have: then nothing may change, not even by
  // rounding.
  constexpr double kSameRotation = 1e-9;
  const Mat3<double> I = Mat3<double>::Identity();
  is_rectified_ = left.distortion() == Distortion::none && right.distortion() == Distortion::none &&
                  left.intrinsics() == right.intrinsics() && left.fx() == left.fy() &&
                  (R_left_camera - I).cwiseAbs().maxCoeff() < kSameRotation &&
                  (R_left_right - I).cwiseAbs().maxCoeff() < kSameRotation;
  if (is_rectified_) R_left_camera = I;
  R_camera_raw_[0] = R_left_camera.transpose();
  R_camera_raw_[1] = is_rectified_ ? I : Mat3<double>(R_left_camera.transpose() * R_left_right);
  T_body_camera_ =
      is_rectified_ ? T_body_left : T_body_left * SE3d(SO3d(R_left_camera), Vec3<double>::Zero());

  if (is_rectified_) {
    focal_ = left.fx();
    center_ = {left.cx(), left.cy()};
  } else {
    focal_ = 0.25 * (left.fx() + left.fy() + right.fx() + right.fy());
    // The middle of each image, rectified, should fall on the middle of the rectified image, in the mean.
    center_.setZero();
    for (const Side side : {Side::left, Side::right}) {
      const Camera& raw = camera(side);
      const Vec2<double> middle(0.5 * (raw.width() - 1), 0.5 * (raw.height() - 1));
      const std::optional<Vec3<double>> ray = raw.unproject(middle);
      if (!ray)
        rig_fails("distortion_coefficients",
                  "the middle of the image is outside the model's domain; "
                  "its radius ends at",
                  raw.max_radius());
      const Vec3<double> p = R_camera_raw(side) * *ray;
      center_ += 0.5 * (middle - focal_ * p.head<2>() / p.z());
    }
    auto tables = std::make_shared<std::array<RectificationTable, 2>>();
    for (const Side side : {Side::left, Side::right})
      (*tables)[static_cast<int>(side)] =
          RectificationTable(camera(side).width(), camera(side).height(),
                             [&](const Vec2<double>& pixel) { return rectify(side, pixel); });
    tables_ = std::move(tables);
  }

  // Walked in steps of four pixels, inside too: the border may lie outside the model's domain.
  bounds_ = {center_.x(), center_.x(), center_.y(), center_.y()};
  for (const Side side : {Side::left, Side::right}) {
    const Camera& raw = camera(side);
    const double right_edge = raw.width() - 0.5, bottom_edge = raw.height() - 0.5;
    for (double y = -0.5; y <= bottom_edge; y = y < bottom_edge ? std::min(y + 4, bottom_edge) : y + 1) {
      for (double x = -0.5; x <= right_edge; x = x < right_edge ? std::min(x + 4, right_edge) : x + 1) {
        const std::optional<Vec2<float>> p = rectify_fast(side, Vec2<float>(x, y));
        if (!p) continue;
        bounds_.u_min = std::min<double>(bounds_.u_min, p->x());
        bounds_.u_max = std::max<double>(bounds_.u_max, p->x());
        bounds_.v_min = std::min<double>(bounds_.v_min, p->y());
        bounds_.v_max = std::max<double>(bounds_.v_max, p->y());
      }
    }
  }
}

std::optional<Vec2<double>> StereoRig::rectify(Side side, const Vec2<double>& pixel,
                                               Eigen::Matrix2d* J) const {
  if (is_rectified_) {
    if (!pixel.allFinite()) return std::nullopt;
    if (J) J->setIdentity();
    return pixel;
  }
  Eigen::Matrix<double, 3, 2> J_ray;
  const std::optional<Vec3<double>> ray = camera(side).unproject(pixel, J ? &J_ray : nullptr);
  if (!ray) return std::nullopt;
  const Mat3<double>& R = R_camera_raw(side);
  const Vec3<double> p = R * *ray;
  if (!(p.z() > kMinRectifiedCosine * p.norm())) return std::nullopt;
  const Vec2<double> m = p.head<2>() / p.z();
  if (J) {
    Eigen::Matrix<double, 2, 3> J_p;
    J_p << Eigen::Matrix2d::Identity(), -m;
    *J = (focal_ / p.z()) * J_p * R * J_ray;
  }
  return Vec2<double>(focal_ * m + center_);
}

std::optional<Vec2<double>> StereoRig::unrectify(Side side, const Vec2<double>& rectified,
                                                 Eigen::Matrix2d* J) const {
  if (is_rectified_) {
    if (!rectified.allFinite()) return std::nullopt;
    if (J) J->setIdentity();
    return rectified;
  }
  const Vec2<double> m = (rectified - center_) / focal_;
  const Vec3<double> p(m.x(), m.y(), 1.0);
  if (!(1.0 > kMinRectifiedCosine * p.norm())) return std::nullopt;
  const Mat3<double>& R = R_camera_raw(side);
  Eigen::Matrix<double, 2, 3> J_p;
  const std::optional<Vec2<double>> pixel = camera(side).project(R.transpose() * p, J ? &J_p : nullptr);
  if (pixel && J) *J = J_p * R.transpose().leftCols<2>() / focal_;
  return pixel;
}

std::optional<Vec2<float>> StereoRig::rectify_fast(Side side, const Vec2<float>& pixel,
                                                   Eigen::Matrix2f& J) const {
  if (is_rectified_) {
    if (!pixel.allFinite()) return std::nullopt;
    J.setIdentity();
    return pixel;
  }
  Vec2<float> rectified;
  if ((*tables_)[static_cast<int>(side)].lookup(pixel.x(), pixel.y(), rectified, J)) [[likely]]
    return rectified;
  Eigen::Matrix2d J_exact;
  const std::optional<Vec2<double>> exact = rectify(side, pixel.cast<double>(), &J_exact);
  if (!exact) return std::nullopt;
  J = J_exact.cast<float>();
  return exact->cast<float>();
}

std::optional<Vec2<float>> StereoRig::unrectify_fast(Side side, const Vec2<float>& rectified,
                                                     Eigen::Matrix2f* J) const {
  if (is_rectified_) {
    if (!rectified.allFinite()) return std::nullopt;
    if (J) J->setIdentity();
    return rectified;
  }
  const Vec2<float> m = (rectified - center_.cast<float>()) / static_cast<float>(focal_);
  const Vec3<float> p(m.x(), m.y(), 1.0f);
  if (!(1.0f > static_cast<float>(kMinRectifiedCosine) * p.norm())) return std::nullopt;
  const Mat3<float> R_raw_camera = R_camera_raw(side).transpose().cast<float>();
  Eigen::Matrix<float, 2, 3> J_p;
  const std::optional<Vec2<float>> pixel = camera(side).project<float>(R_raw_camera * p, J ? &J_p : nullptr);
  if (pixel && J) *J = J_p * R_raw_camera.leftCols<2>() / static_cast<float>(focal_);
  return pixel;
}

Mat3<double> StereoRig::point_covariance(const Vec3<double>& uvd, double sigma_pixel,
                                         double sigma_disparity) const {
  require(uvd.z() > 0, "StereoRig::point_covariance uvd", "its disparity must be positive", uvd.z());
  Mat3<double> J;
  point_from_disparity<double>(uvd, &J);
  const Vec3<double> variance(sigma_pixel * sigma_pixel, sigma_pixel * sigma_pixel,
                              sigma_disparity * sigma_disparity);
  return J * variance.asDiagonal() * J.transpose();
}

}  // namespace sweepkit
