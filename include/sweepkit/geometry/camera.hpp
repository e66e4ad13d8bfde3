// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <limits>
#include <optional>
#include <string_view>
#include <variant>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/geometry/so3.hpp"

namespace sweepkit {

/// How a lens bends the image plane.
enum class Distortion {
  none,               ///< a pinhole
  radial_tangential,  ///< Brown-Conrady: k1 k2 p1 p2 and, if given, k3, in OpenCV's order
  equidistant,        ///< Kannala-Brandt as OpenCV's fisheye: k1 k2 k3 k4
};

/// The name of a model as EuRoC's sensor.yaml writes it.
constexpr std::string_view to_string(Distortion distortion) {
  switch (distortion) {
    case Distortion::none:
      return "none";
    case Distortion::radial_tangential:
      return "radial-tangential";
    case Distortion::equidistant:
      return "equidistant";
  }
  return "unknown";
}

// A distortion policy maps the ideal point m = (x/z, y/z) of the plane z = 1 to the distorted one. It offers
//   kind                               its Distortion
//   max_squared_radius()               up to this |m|^2 the map is one to one: its domain of validity
//   distort(m, J)                      the distorted point; J, if not null, is its 2x2 derivative by m
//   undistort(m_distorted)             the m within the domain that is distorted to it, nullopt if there is
//   none
// and is good for float, double and ceres::Jet in distort.
template <class D>
concept DistortionPolicy = requires(const D d, const Vec2<double> m, Eigen::Matrix2d* J) {
  { D::kind } -> std::convertible_to<Distortion>;
  { d.max_squared_radius() } -> std::convertible_to<double>;
  { d.distort(m, J) } -> std::convertible_to<Vec2<double>>;
  { d.undistort(m) } -> std::convertible_to<std::optional<Vec2<double>>>;
};

/// Points of the plane z = 1 farther out than this are at the horizon for every model (89.99 degrees): the
/// bound keeps all polynomials finite.
inline constexpr double kMaxSquaredRadius = 1e8;

/// An ideal pinhole.
struct NoDistortion {
  static constexpr Distortion kind = Distortion::none;

  double max_squared_radius() const { return kMaxSquaredRadius; }

  template <class S>
  Vec2<S> distort(const Vec2<S>& m, Eigen::Matrix<S, 2, 2>* J = nullptr) const {
    if (J) J->setIdentity();
    return m;
  }
  std::optional<Vec2<double>> undistort(const Vec2<double>& m_distorted) const {
    if (!(m_distorted.squaredNorm() <= kMaxSquaredRadius)) return std::nullopt;
    return m_distorted;
  }
};

/// Brown-Conrady: with s = x^2 + y^2 and c = 1 + k1 s + k2 s^2 + k3 s^3
///   x' = c x + 2 p1 x y + p2 (s + 2 x^2),  y' = c y + p1 (s + 2 y^2) + 2 p2 x y.
/// Brown, Decentering distortion of lenses (1966); coefficients as in OpenCV.
/// Valid while the distorted radius c r grows with r: beyond, rays from far outside fold back into the image.
class RadialTangential {
 public:
  static constexpr Distortion kind = Distortion::radial_tangential;

  RadialTangential(double k1, double k2, double p1, double p2, double k3 = 0);

  double max_squared_radius() const { return max_squared_radius_; }

  template <class S>
  Vec2<S> distort(const Vec2<S>& m, Eigen::Matrix<S, 2, 2>* J = nullptr) const;
  /// Newton in the plane, kept inside the domain.
  std::optional<Vec2<double>> undistort(const Vec2<double>& m_distorted) const;

 private:
  double k1_, k2_, p1_, p2_, k3_;
  double max_squared_radius_;
};

/// Kannala-Brandt: a ray at the angle theta from the axis meets the image at the radius
///   theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).
/// Kannala, Brandt, A generic camera model and calibration method (2006); coefficients as in OpenCV's
/// fisheye. Valid in front of the camera while theta_d grows with theta.
class Equidistant {
 public:
  static constexpr Distortion kind = Distortion::equidistant;

  Equidistant(double k1, double k2, double k3, double k4);

  double max_squared_radius() const { return max_squared_radius_; }

  template <class S>
  Vec2<S> distort(const Vec2<S>& m, Eigen::Matrix<S, 2, 2>* J = nullptr) const;
  /// Newton in the angle, safeguarded by bisection.
  std::optional<Vec2<double>> undistort(const Vec2<double>& m_distorted) const;

 private:
  double k_[4];
  double max_theta_;
  double max_squared_radius_;
};

/// A pinhole followed by a distortion known at compile time: pixel = (fx x' + cx, fy y' + cy), the centre of
/// the first pixel at (0, 0). Immutable; any number of threads may use one.
template <DistortionPolicy D>
class PinholeCamera {
 public:
  /// Values are taken as they are; `Camera` is the one that checks them.
  PinholeCamera(double fx, double fy, double cx, double cy, const D& distortion)
      : fx_(fx), fy_(fy), cx_(cx), cy_(cy), distortion_(distortion) {}

  double fx() const { return fx_; }
  double fy() const { return fy_; }
  double cx() const { return cx_; }
  double cy() const { return cy_; }
  const D& distortion() const { return distortion_; }

  /// Point in the camera's frame (x right, y down, z forward) to pixel; nullopt behind the camera or outside
  /// the model's domain. The pixel may lie outside the image.
  /// @param J_p derivative of the pixel by the point, if not null [px/m]
  template <class S>
  std::optional<Vec2<S>> project(const Vec3<S>& p_camera, Eigen::Matrix<S, 2, 3>* J_p = nullptr) const {
    if (!(p_camera.z() > S(0))) return std::nullopt;
    const S inverse_z = S(1) / p_camera.z();
    const Vec2<S> m(p_camera.x() * inverse_z, p_camera.y() * inverse_z);
    if (!(m.squaredNorm() <= S(distortion_.max_squared_radius()))) return std::nullopt;
    Eigen::Matrix<S, 2, 2> J_m;
    const Vec2<S> d = distortion_.template distort<S>(m, J_p ? &J_m : nullptr);
    if (J_p) {
      J_m.row(0) *= S(fx_) * inverse_z;
      J_m.row(1) *= S(fy_) * inverse_z;
      J_p->template leftCols<2>() = J_m;
      J_p->col(2) = -(J_m * m);
    }
    return Vec2<S>(S(fx_) * d.x() + S(cx_), S(fy_) * d.y() + S(cy_));
  }

  /// Pixel to the ray (x, y, 1); nullopt where no ray of the domain is projected to it, or where the search
  /// for it does not converge. What it returns projects back to within 1e-9 px.
  /// @param J_pixel derivative of the ray by the pixel, if not null; its last row is zero
  std::optional<Vec3<double>> unproject(const Vec2<double>& pixel,
                                        Eigen::Matrix<double, 3, 2>* J_pixel = nullptr) const {
    const Vec2<double> d((pixel.x() - cx_) / fx_, (pixel.y() - cy_) / fy_);
    const std::optional<Vec2<double>> m = distortion_.undistort(d);
    if (!m) return std::nullopt;
    if (J_pixel) {
      Eigen::Matrix2d J_m;
      distortion_.template distort<double>(*m, &J_m);
      J_pixel->topRows<2>() = J_m.inverse() * Vec2<double>(1 / fx_, 1 / fy_).asDiagonal();
      J_pixel->row(2).setZero();
    }
    return Vec3<double>(m->x(), m->y(), 1.0);
  }

 private:
  double fx_, fy_, cx_, cy_;
  D distortion_;
};

/// A camera whose model is chosen at run time, with the size of its image; its values are checked.
/// Immutable; any number of threads may use one.
class Camera {
 public:
  using Model =
      std::variant<PinholeCamera<NoDistortion>, PinholeCamera<RadialTangential>, PinholeCamera<Equidistant>>;

  /// @param intrinsics fx, fy, cx, cy [px], the centre of the first pixel at (0, 0)
  /// @param coefficients none: empty; radial_tangential: k1 k2 p1 p2 [k3]; equidistant: k1 k2 k3 k4
  /// Throws Error(calibration) that names the field and its value.
  Camera(const std::vector<double>& intrinsics, Distortion distortion,
         const std::vector<double>& coefficients, int width, int height);

  int width() const { return width_; }
  int height() const { return height_; }
  double fx() const { return intrinsics_[0]; }
  double fy() const { return intrinsics_[1]; }
  double cx() const { return intrinsics_[2]; }
  double cy() const { return intrinsics_[3]; }
  const std::vector<double>& intrinsics() const { return intrinsics_; }
  Distortion distortion() const { return distortion_; }
  const std::vector<double>& coefficients() const { return coefficients_; }
  /// The matrix [fx 0 cx; 0 fy cy; 0 0 1].
  Mat3<double> K() const;
  /// The model itself, to be visited once outside an inner loop.
  const Model& model() const { return model_; }
  /// The largest |(x/z, y/z)| for which the model is valid.
  double max_radius() const;
  /// Whether a pixel position lies in the image, at least `border` from its edge [px].
  bool contains(const Vec2<double>& pixel, double border = 0) const {
    return pixel.x() >= border - 0.5 && pixel.y() >= border - 0.5 && pixel.x() <= width_ - 0.5 - border &&
           pixel.y() <= height_ - 0.5 - border;
  }

  /// As PinholeCamera::project.
  template <class S>
  std::optional<Vec2<S>> project(const Vec3<S>& p_camera, Eigen::Matrix<S, 2, 3>* J_p = nullptr) const {
    return std::visit([&](const auto& model) { return model.template project<S>(p_camera, J_p); }, model_);
  }
  std::optional<Vec2<double>> project(const Vec3<double>& p_camera,
                                      Eigen::Matrix<double, 2, 3>* J_p = nullptr) const {
    return project<double>(p_camera, J_p);
  }
  /// As PinholeCamera::unproject.
  std::optional<Vec3<double>> unproject(const Vec2<double>& pixel,
                                        Eigen::Matrix<double, 3, 2>* J_pixel = nullptr) const {
    return std::visit([&](const auto& model) { return model.unproject(pixel, J_pixel); }, model_);
  }

 private:
  static Model make_model(const std::vector<double>& intrinsics, Distortion distortion,
                          const std::vector<double>& coefficients, int width, int height);

  std::vector<double> intrinsics_;
  Distortion distortion_;
  std::vector<double> coefficients_;
  int width_, height_;
  Model model_;
};

}  // namespace sweepkit

#include "sweepkit/geometry/impl/camera.hpp"
