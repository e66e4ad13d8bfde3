// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>

#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// The turn by which `from` comes to lie on `to` on the shortest way; both are unit vectors. Of opposite ones
/// any half turn.
inline SO3<double> shortest_turn(const Vec3<double>& from, const Vec3<double>& to) {
  return SO3<double>(Eigen::Quaterniond::FromTwoVectors(from, to).toRotationMatrix());
}

/// Pose of a camera that knows where down is, from two points: only the turn about the vertical and the
/// translation are free (Kukelova, Bujnak and Pajdla, Closed-form solutions to minimal absolute pose problems
/// with known vertical direction, ACCV 2010). What two rays say of the translation is eliminated, which
/// leaves a cos + b sin + c = 0 of the angle.
/// @param p_world two points [m]
/// @param rays x/z and y/z of where they are seen
/// @param down_world, down_camera the same direction in both frames, unit
/// @param T_camera_world world to camera: room for two
/// @return number of poses, 0 to 2; points behind the camera and values that are not finite give none
inline int solve_upright_p2p(std::span<const Vec3<double>, 2> p_world, std::span<const Vec2<double>, 2> rays,
                             const Vec3<double>& down_world, const Vec3<double>& down_camera,
                             std::span<SE3<double>, 2> T_camera_world) {
  const SO3<double> tilt = shortest_turn(down_world, down_camera);
  // A point turned by an angle is cos * level + sin * aside + along, in the camera's axes.
  Vec3<double> level[2], aside[2], along[2];
  for (std::size_t i = 0; i < 2; ++i) {
    const Vec3<double> vertical = down_world * down_world.dot(p_world[i]);
    level[i] = tilt * Vec3<double>(p_world[i] - vertical);
    aside[i] = tilt * Vec3<double>(down_world.cross(p_world[i]));
    along[i] = tilt * vertical;
  }
  const Vec2<double> d = rays[0] - rays[1];
  // How far a point without translation misses its ray; the sum of both free of the translation.
  const auto miss = [&](std::size_t i, const Vec3<double>& p) -> Vec2<double> {
    return p.head<2>() - rays[i] * p.z();
  };
  const auto eliminated = [&](const Vec3<double>(&p)[2]) {
    const Vec2<double> e = miss(0, p[0]) - miss(1, p[1]);
    return d.y() * e.x() - d.x() * e.y();
  };
  const double a = eliminated(level), b = eliminated(aside), c = eliminated(along);
  const double length = std::hypot(a, b);
  if (!(length > 0.0) || !std::isfinite(c)) return 0;
  const double cosine = -c / length;
  // Noise may push a solution at the brim over it.
  if (!(std::abs(cosine) < 1.02)) return 0;
  const double middle = std::atan2(b, a), half = std::acos(std::clamp(cosine, -1.0, 1.0));
  int count = 0;
  for (const double angle : {middle - half, middle + half}) {
    Vec3<double> p[2];
    for (std::size_t i = 0; i < 2; ++i)
      p[i] = std::cos(angle) * level[i] + std::sin(angle) * aside[i] + along[i];
    const Vec2<double> e0 = miss(0, p[0]), e1 = miss(1, p[1]);
    const bool by_x = std::abs(d.x()) > std::abs(d.y());
    const double z = by_x ? (e0.x() - e1.x()) / d.x() : (e0.y() - e1.y()) / d.y();
    const Vec2<double> xy = 0.5 * (rays[0] * z - e0 + rays[1] * z - e1);
    const Vec3<double> t(xy.x(), xy.y(), z);
    if (!t.allFinite() || !(p[0].z() + z > 0.0) || !(p[1].z() + z > 0.0)) continue;
    T_camera_world[static_cast<std::size_t>(count++)] =
        SE3<double>(tilt * SO3<double>::exp(down_world * angle), t);
  }
  return count;
}

}  // namespace sweepkit
