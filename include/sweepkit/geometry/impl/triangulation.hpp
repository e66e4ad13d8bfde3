// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <span>

#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// Rays with less than this between all of them are taken for parallel [rad].
template <class S>
inline constexpr S kMinParallax = std::numeric_limits<S>::epsilon() < S(1e-10) ? S(1e-6) : S(1e-5);

namespace impl {

inline double angle_between(const Vec3<double>& a, const Vec3<double>& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

/// A ray in the frame of the result.
struct WorldRay {
  Vec3<double> center;
  Vec3<double> direction;  ///< unit
};

/// The matrix that removes what is along the ray.
inline Mat3<double> across(const Vec3<double>& direction) {
  return Mat3<double>::Identity() - direction * direction.transpose();
}

/// Nothing if the bearing has no direction or something is not finite.
template <class S>
std::optional<WorldRay> make_ray(const SE3<S>& T_world_camera, const Vec3<S>& bearing) {
  const Vec3<double> b = bearing.template cast<double>();
  const double norm = b.norm();
  const WorldRay ray{T_world_camera.translation().template cast<double>(),
                     T_world_camera.rotation().template cast<double>() * Vec3<double>(b / norm)};
  if (!(norm > 0.0) || !ray.center.allFinite() || !ray.direction.allFinite()) return std::nullopt;
  return ray;
}

/// What the result says beside the point. `weight(distance)` is the one that the estimator gives a ray: with
/// M = sum w P, a turn of the ray by e moves the point by M^-1 w distance e, to first order.
template <class Result, class Weight>
std::optional<Result> describe_point(const Vec3<double>& point, std::span<const WorldRay> rays,
                                     double parallax, const Weight& weight, double sigma) {
  using S = typename Result::Scalar;
  Mat3<double> M = Mat3<double>::Zero(), noise = Mat3<double>::Zero();
  double max_angle = 0.0;
  bool in_front = true;
  for (const WorldRay& ray : rays) {
    const Vec3<double> v = point - ray.center;
    const double distance = v.norm();
    if (!(distance > 0.0) || !std::isfinite(distance)) return std::nullopt;
    const double w = weight(distance);
    const Mat3<double> P = across(ray.direction);
    M += w * P;
    noise += w * w * distance * distance * P;
    max_angle = std::max(max_angle, angle_between(v, ray.direction));
    in_front = in_front && v.dot(ray.direction) > 0.0;
  }
  const Mat3<double> M_inverse = M.inverse();
  const Mat3<double> covariance = sigma * sigma * M_inverse * noise * M_inverse;
  if (!covariance.allFinite()) return std::nullopt;
  Result result;
  result.point = point.template cast<S>();
  result.covariance = (0.5 * (covariance + covariance.transpose())).eval().template cast<S>();
  result.parallax = static_cast<S>(parallax);
  result.max_angle = static_cast<S>(max_angle);
  result.in_front = in_front;
  return result;
}

template <class Result>
std::optional<Result> triangulate_rays(std::span<const WorldRay> rays, double sigma, int reweightings) {
  Vec3<double> origin = Vec3<double>::Zero();
  double parallax = 0.0;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    origin += rays[i].center / static_cast<double>(rays.size());
    for (std::size_t j = 0; j < i; ++j)
      parallax = std::max(parallax, angle_between(rays[i].direction, rays[j].direction));
  }
  if (!(parallax > static_cast<double>(kMinParallax<typename Result::Scalar>))) return std::nullopt;

  // Relative to the mean of the centres, so that a place far from the origin of world costs no digits.
  Vec3<double> point = Vec3<double>::Zero();
  for (int round = 0; round <= reweightings; ++round) {
    Mat3<double> M = Mat3<double>::Zero();
    Vec3<double> b = Vec3<double>::Zero();
    for (const WorldRay& ray : rays) {
      const Vec3<double> center = ray.center - origin;
      const double w = round == 0 ? 1.0 : 1.0 / (point - center).squaredNorm();
      const Mat3<double> P = w * across(ray.direction);
      M += P;
      b += P * center;
    }
    point = M.inverse() * b;
    if (!point.allFinite()) return std::nullopt;
  }
  const auto weight = [&](double distance) { return reweightings <= 0 ? 1.0 : 1.0 / (distance * distance); };
  return describe_point<Result>(origin + point, rays, parallax, weight, sigma);
}

/// Lee and Civera (2019); rays[0] is that of camera a, at the origin.
template <class Result>
std::optional<Result> triangulate_two_rays(const std::array<WorldRay, 2>& rays, double sigma) {
  const Vec3<double>& f_a = rays[0].direction;
  const Vec3<double>& f_b = rays[1].direction;
  const Vec3<double>& t = rays[1].center;
  const double parallax = angle_between(f_a, f_b);
  if (!(parallax > static_cast<double>(kMinParallax<typename Result::Scalar>))) return std::nullopt;

  // Names of the paper, with its frame 0 = b and 1 = a.
  const double p = f_b.cross(f_a).norm(), q = f_b.cross(t).norm(), r = f_a.cross(t).norm();
  if (!(q + r > 0.0)) return std::nullopt;
  const double depth_a = q / p, depth_b = r / p;
  const Vec3<double> point = q / (q + r) * (t + depth_b * (f_b + f_a));
  const auto gap = [&](double sign_a, double sign_b) {
    return (t + sign_b * depth_b * f_b - sign_a * depth_a * f_a).squaredNorm();
  };
  const auto weight = [](double distance) { return 1.0 / distance; };
  auto result = describe_point<Result>(point, rays, parallax, weight, sigma);
  if (result) result->in_front = gap(1, 1) < std::min({gap(-1, 1), gap(1, -1), gap(-1, -1)});
  return result;
}

}  // namespace impl
}  // namespace sweepkit
