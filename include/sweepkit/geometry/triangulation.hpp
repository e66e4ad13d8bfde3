// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/geometry/impl/triangulation.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// A point seen along several rays.
template <class S>
struct Triangulation {
  using Scalar = S;

  Vec3<S> point;       ///< [m], in the frame that the function names
  Mat3<S> covariance;  ///< of the point, to first order, for the given bearing sigma [m^2]
  S parallax;          ///< largest angle between two of the rays [rad]
  S max_angle;         ///< largest angle between a ray and the point as seen from its camera [rad]
  bool in_front;       ///< every camera sees the point along its ray, not behind it
};

/// Point nearest to any number of rays, by linear least squares: minimises the sum of w_i |(I - b_i b_i^T)
/// (R_i p + t_i)|^2. These are the squared rows [b]x (R p + t) = 0 of the direct linear transform with unit
/// bearings. The first round has w = 1, each further one 1 / distance^2 of the round before, which makes the
/// residuals angles: Hartley and Sturm, Triangulation (1997), section 5.2, "Iterative-LS". One further round
/// is the maximum-likelihood estimate to first order. Sums are in double for float too.
/// @param T_camera_world a pose for each ray
/// @param bearings rays in their camera's frame, of any length above zero: unit or (x/z, y/z, 1)
/// @param bearing_sigma standard deviation of a ray's direction, about each axis across it [rad]
/// @param reweightings rounds after the first
/// @return the point in world; nothing for fewer than two rays, rays that are not finite or of length zero,
///     all rays parallel (within kMinParallax), or a point in a camera's centre. A point behind a camera is
///     returned with `in_front` false.
/// @throws Error(argument) if the numbers of poses and bearings differ
template <class S>
std::optional<Triangulation<S>> triangulate_linear(std::span<const SE3<S>> T_camera_world,
                                                   std::span<const Vec3<S>> bearings,
                                                   S bearing_sigma = S(1e-3), int reweightings = 1) {
  require(T_camera_world.size() == bearings.size(), "triangulate_linear bearings",
          "must be as many as the poses", bearings.size());
  std::vector<impl::WorldRay> rays;
  rays.reserve(bearings.size());
  for (std::size_t i = 0; i < bearings.size(); ++i) {
    const auto ray = impl::make_ray(T_camera_world[i].inverse(), bearings[i]);
    if (!ray) return std::nullopt;
    rays.push_back(*ray);
  }
  return impl::triangulate_rays<Triangulation<S>>(rays, static_cast<double>(bearing_sigma), reweightings);
}

/// Classical midpoint of two rays: the middle of the shortest segment between them, the cheapest way; Hartley
/// and Sturm (1997), section 5.3. Its covariance is that of the midpoint, not of the best estimate.
/// @param T_a_b pose of camera b in a
/// @return the point in a; nothing in the cases of triangulate_linear
template <class S>
std::optional<Triangulation<S>> triangulate_midpoint(const SE3<S>& T_a_b, const Vec3<S>& bearing_a,
                                                     const Vec3<S>& bearing_b, S bearing_sigma = S(1e-3)) {
  const auto ray_a = impl::make_ray(SE3<S>(), bearing_a);
  const auto ray_b = impl::make_ray(T_a_b, bearing_b);
  if (!ray_a || !ray_b) return std::nullopt;
  const std::array<impl::WorldRay, 2> rays{*ray_a, *ray_b};
  return impl::triangulate_rays<Triangulation<S>>(rays, static_cast<double>(bearing_sigma), 0);
}

/// Midpoint of two rays weighted by inverse depth: nearly as accurate as the best estimate at the price of a
/// few cross products; Lee and Civera, Triangulation: Why Optimize? (BMVC 2019), equations 8 to 10. In front
/// is decided by their test: no choice of signs of the two depths brings the rays' points nearer together.
/// @param T_a_b pose of camera b in a
/// @return the point in a; nothing in the cases of triangulate_linear
template <class S>
std::optional<Triangulation<S>> triangulate_inverse_depth(const SE3<S>& T_a_b, const Vec3<S>& bearing_a,
                                                          const Vec3<S>& bearing_b,
                                                          S bearing_sigma = S(1e-3)) {
  const auto ray_a = impl::make_ray(SE3<S>(), bearing_a);
  const auto ray_b = impl::make_ray(T_a_b, bearing_b);
  if (!ray_a || !ray_b) return std::nullopt;
  return impl::triangulate_two_rays<Triangulation<S>>({*ray_a, *ray_b}, static_cast<double>(bearing_sigma));
}

}  // namespace sweepkit
