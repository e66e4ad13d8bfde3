// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <concepts>
#include <sstream>
#include <string>

#include "sweepkit/geometry/camera.hpp"

namespace sweepkit {
namespace impl {

// Newton stops at this residual in the plane z = 1: below a thousandth of the promised 1e-9 px at any focal
// length in use.
inline constexpr double kUndistortTolerance = 1e-14;
inline constexpr int kUndistortIterations = 50;

/// Value of the polynomial c[0] + c[1] s + ... + c[n-1] s^(n-1).
template <std::size_t N>
double polynomial(const double (&c)[N], double s) {
  double value = 0;
  for (std::size_t i = N; i-- > 0;) value = value * s + c[i];
  return value;
}

/// The first s in (0, s_end) at which a polynomial with c[0] > 0 stops being positive, else s_end.
/// Between two neighbouring roots of its derivative a polynomial is monotone, so the search goes from the
/// highest derivative down and bisects each monotone piece: no root is stepped over.
template <std::size_t N>
double first_zero(const double (&c)[N], double s_end) {
  std::vector<double> roots;  // of the derivative treated before, ascending
  for (std::size_t order = N - 1; order-- > 0;) {
    double d[N] = {};
    for (std::size_t i = order; i < N; ++i) {
      double factor = c[i];
      for (std::size_t j = 0; j < order; ++j) factor *= static_cast<double>(i - j);
      d[i - order] = factor;
    }
    std::vector<double> bounds = {0.0};
    bounds.insert(bounds.end(), roots.begin(), roots.end());
    bounds.push_back(s_end);
    roots.clear();
    for (std::size_t i = 0; i + 1 < bounds.size(); ++i) {
      double low = bounds[i], high = bounds[i + 1];
      const bool sign = polynomial(d, low) > 0;
      if (sign == (polynomial(d, high) > 0)) continue;
      for (int k = 0; k < 200 && low < high; ++k) {
        const double middle = 0.5 * (low + high);
        if (middle == low || middle == high) break;
        ((polynomial(d, middle) > 0) == sign ? low : high) = middle;
      }
      roots.push_back(low);
    }
  }
  return roots.empty() ? s_end : roots.front();
}

}  // namespace impl

inline RadialTangential::RadialTangential(double k1, double k2, double p1, double p2, double k3)
    : k1_(k1), k2_(k2), p1_(p1), p2_(p2), k3_(k3) {
  // d(c r)/dr = 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3
  const double slope[] = {1, 3 * k1, 5 * k2, 7 * k3};
  max_squared_radius_ = impl::first_zero(slope, kMaxSquaredRadius);
}

template <class S>
Vec2<S> RadialTangential::distort(const Vec2<S>& m, Eigen::Matrix<S, 2, 2>* J) const {
  const S k1(k1_), k2(k2_), k3(k3_), p1(p1_), p2(p2_);
  const S x = m.x(), y = m.y();
  const S xx = x * x, yy = y * y, xy = x * y, s = xx + yy;
  const S c = S(1) + s * (k1 + s * (k2 + s * k3));
  if (J) {
    const S c_s2 = S(2) * (k1 + s * (S(2) * k2 + S(3) * s * k3));  // twice dc/ds
    const S mixed = c_s2 * xy + S(2) * (p1 * x + p2 * y);
    (*J)(0, 0) = c + c_s2 * xx + S(2) * p1 * y + S(6) * p2 * x;
    (*J)(0, 1) = mixed;
    (*J)(1, 0) = mixed;
    (*J)(1, 1) = c + c_s2 * yy + S(6) * p1 * y + S(2) * p2 * x;
  }
  return {c * x + S(2) * p1 * xy + p2 * (s + S(2) * xx), c * y + p1 * (s + S(2) * yy) + S(2) * p2 * xy};
}

inline std::optional<Vec2<double>> RadialTangential::undistort(const Vec2<double>& m_distorted) const {
  // From the distorted point inwards of the domain, Newton goes outwards without passing the solution while
  // the radius is a concave function (barrel distortion), and converges from outside when it is convex.
  Vec2<double> m = m_distorted;
  double residual = std::numeric_limits<double>::infinity();
  for (int i = 0; i < impl::kUndistortIterations; ++i) {
    const double s = m.squaredNorm();
    if (!(s <= max_squared_radius_)) {
      if (!std::isfinite(s)) return std::nullopt;
      m *= 0.999 * std::sqrt(max_squared_radius_ / s);
    }
    Eigen::Matrix2d J;
    const Vec2<double> error = distort<double>(m, &J) - m_distorted;
    residual = error.lpNorm<Eigen::Infinity>();
    if (residual <= impl::kUndistortTolerance) break;
    const double det = J.determinant();
    if (!(det > 0)) return std::nullopt;
    const Vec2<double> step(J(1, 1) * error.x() - J(0, 1) * error.y(),
                            J(0, 0) * error.y() - J(1, 0) * error.x());
    const Vec2<double> next = m - step / det;
    if (next == m) break;
    m = next;
  }
  // Rounding may keep the residual a few units above the tolerance; what has not converged is far above.
  if (!(residual <= 100 * impl::kUndistortTolerance * (1 + m_distorted.norm()))) return std::nullopt;
  if (!(m.squaredNorm() <= max_squared_radius_)) return std::nullopt;
  return m;
}

inline Equidistant::Equidistant(double k1, double k2, double k3, double k4) : k_{k1, k2, k3, k4} {
  // d theta_d / d theta = 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3 + 9 k4 s^4 with s = theta^2
  const double slope[] = {1, 3 * k1, 5 * k2, 7 * k3, 9 * k4};
  const double horizon = std::atan(std::sqrt(kMaxSquaredRadius));
  max_theta_ = std::sqrt(impl::first_zero(slope, horizon * horizon));
  const double radius = std::tan(max_theta_);
  max_squared_radius_ = std::min(radius * radius, kMaxSquaredRadius);
}

template <class S>
Vec2<S> Equidistant::distort(const Vec2<S>& m, Eigen::Matrix<S, 2, 2>* J) const {
  using std::atan;
  using std::sqrt;
  const S k1(k_[0]), k2(k_[1]), k3(k_[2]), k4(k_[3]);
  const S s = m.squaredNorm();
  S scale;      // theta_d / r
  S curvature;  // (d theta_d / dr - theta_d / r) / r^2
  if (s < S(1e-6)) {
    // theta_d / r = 1 + (k1 - 1/3) s + O(s^2) (k2 - k1 + 1/5)
    const S a = k1 - S(1.0 / 3.0), b = k2 - k1 + S(0.2);
    scale = S(1) + s * (a + s * b);
    curvature = S(2) * a + S(4) * b * s;
  } else {
    const S r = sqrt(s);
    const S theta = atan(r);
    const S t = theta * theta;
    scale = theta * (S(1) + t * (k1 + t * (k2 + t * (k3 + t * k4)))) / r;
    const S slope = S(1) + t * (S(3) * k1 + t * (S(5) * k2 + t * (S(7) * k3 + t * S(9) * k4)));
    curvature = (slope / (S(1) + s) - scale) / s;
  }
  if (J) {
    // d (scale m) / dm = scale I + (dscale/dr / r) m m^T, and dscale/dr / r = curvature
    J->noalias() = curvature * (m * m.transpose());
    (*J)(0, 0) += scale;
    (*J)(1, 1) += scale;
  }
  return scale * m;
}

inline std::optional<Vec2<double>> Equidistant::undistort(const Vec2<double>& m_distorted) const {
  const double target = m_distorted.norm();
  const auto angle = [&](double theta) {
    const double t = theta * theta;
    return theta * (1 + t * (k_[0] + t * (k_[1] + t * (k_[2] + t * k_[3]))));
  };
  if (!(target <= angle(max_theta_))) return std::nullopt;
  if (target < 1e-12) return m_distorted;
  double low = 0, high = max_theta_, theta = std::min(target, 0.5 * (low + high));
  for (int i = 0; i < impl::kUndistortIterations; ++i) {
    const double residual = angle(theta) - target;
    if (std::abs(residual) <= 1e-16) break;
    (residual > 0 ? high : low) = theta;
    const double t = theta * theta;
    const double slope = 1 + t * (3 * k_[0] + t * (5 * k_[1] + t * (7 * k_[2] + t * 9 * k_[3])));
    double next = theta - residual / slope;
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (next == theta) break;
    theta = next;
  }
  if (!(std::abs(angle(theta) - target) <= 1e-13)) return std::nullopt;
  const double radius = std::tan(theta);
  if (!(radius * radius <= max_squared_radius_)) return std::nullopt;
  return Vec2<double>(m_distorted * (radius / target));
}

inline Mat3<double> Camera::K() const {
  Mat3<double> K;
  K << fx(), 0, cx(), 0, fy(), cy(), 0, 0, 1;
  return K;
}

inline double Camera::max_radius() const {
  return std::sqrt(
      std::visit([](const auto& model) { return model.distortion().max_squared_radius(); }, model_));
}

inline Camera::Model Camera::make_model(const std::vector<double>& intrinsics, Distortion distortion,
                                        const std::vector<double>& coefficients, int width, int height) {
  const auto fail = [](std::string_view place, std::string_view message, const auto& value) {
    std::ostringstream text;
    text << value;
    throw Error(ErrorKind::calibration, std::string(place), message, text.str());
  };
  if (width <= 0) fail("width", "must be positive", width);
  if (height <= 0) fail("height", "must be positive", height);
  if (intrinsics.size() != 4)
    fail("intrinsics", "must be the four numbers fx, fy, cx, cy", intrinsics.size());
  static constexpr std::string_view kNames[] = {"fx", "fy", "cx", "cy"};
  for (int i = 0; i < 4; ++i) {
    if (!std::isfinite(intrinsics[i])) fail(kNames[i], "must be finite", intrinsics[i]);
    if (i < 2 && !(intrinsics[i] > 0)) fail(kNames[i], "must be positive", intrinsics[i]);
    // A principal point more than an image away is a mistyped one.
    const double size = i == 2 ? width : height;
    if (i >= 2 && !(intrinsics[i] > -size && intrinsics[i] < 2 * size))
      fail(kNames[i], "lies far outside the image", intrinsics[i]);
  }
  const std::size_t count = coefficients.size();
  for (std::size_t i = 0; i < count; ++i)
    if (!std::isfinite(coefficients[i]))
      fail("distortion_coefficients[" + std::to_string(i) + "]", "must be finite", coefficients[i]);
  const std::vector<double>& k = coefficients;
  switch (distortion) {
    case Distortion::none:
      if (count != 0) fail("distortion_coefficients", "must be empty for a camera without distortion", count);
      break;
    case Distortion::radial_tangential:
      if (count != 4 && count != 5)
        fail("distortion_coefficients", "must be four or five numbers: k1, k2, p1, p2 and perhaps k3", count);
      return PinholeCamera(intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3],
                           RadialTangential(k[0], k[1], k[2], k[3], count == 5 ? k[4] : 0.0));
    case Distortion::equidistant:
      if (count != 4) fail("distortion_coefficients", "must be the four numbers k1, k2, k3, k4", count);
      return PinholeCamera(intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3],
                           Equidistant(k[0], k[1], k[2], k[3]));
  }
  return PinholeCamera(intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3], NoDistortion());
}

inline Camera::Camera(const std::vector<double>& intrinsics, Distortion distortion,
                      const std::vector<double>& coefficients, int width, int height)
    : intrinsics_(intrinsics),
      distortion_(distortion),
      coefficients_(coefficients),
      width_(width),
      height_(height),
      model_(make_model(intrinsics, distortion, coefficients, width, height)) {}

}  // namespace sweepkit
