// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <utility>

#include "sweepkit/geometry/se3.hpp"

namespace sweepkit::impl {

struct P3pPose {
  Mat3<double> R;  ///< world to camera
  Vec3<double> t;
};

/// A symmetric 3x3 matrix: a conic of the plane of distance ratios.
struct Conic {
  double xx, xy, xz, yy, yz, zz;

  Conic adjugate() const {
    return {yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy,
            xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy};
  }
  /// Trace of the product with another symmetric matrix.
  double dot(const Conic& o) const {
    return xx * o.xx + yy * o.yy + zz * o.zz + 2.0 * (xy * o.xy + xz * o.xz + yz * o.yz);
  }
  double determinant() const {
    return xx * (yy * zz - yz * yz) - xy * (xy * zz - xz * yz) + xz * (xy * yz - xz * yy);
  }
  Mat3<double> matrix() const {
    Mat3<double> m;
    m << xx, xy, xz, xy, yy, yz, xz, yz, zz;
    return m;
  }
};

/// a + s b
inline Conic combine(const Conic& a, double s, const Conic& b) {
  return {a.xx + s * b.xx, a.xy + s * b.xy, a.xz + s * b.xz,
          a.yy + s * b.yy, a.yz + s * b.yz, a.zz + s * b.zz};
}

/// The real root of x^3 + b x^2 + c x + d that stands apart: the single one, or of three the one on the other
/// side of the inflection from the two that are nearer to each other.
inline double isolated_cubic_root(double b, double c, double d) {
  const double inflection = -b / 3.0;
  const double p = c - b * b / 3.0;
  const double q = ((inflection + b) * inflection + c) * inflection + d;
  // The curve is steep and bends one way from this bound to the root, so Newton's method walks straight in:
  // |t|^3 = |q| + |p| |t| has its root below cbrt|q| + sqrt|p|.
  const double bound = std::cbrt(std::abs(q)) + std::sqrt(std::max(-p, 0.0));
  double x = q > 0.0 ? inflection - bound : inflection + bound;
  for (int i = 0; i < 50; ++i) {
    const double value = ((x + b) * x + c) * x + d;
    const double slope = (3.0 * x + 2.0 * b) * x + c;
    if (slope == 0.0) break;
    const double step = value / slope;
    x -= step;
    if (std::abs(step) <= 1e-15 * std::abs(x)) break;
  }
  return x;
}

/// The three distances' equations |l_i b_i - l_j b_j|^2 = a_ij, as (l_i - l_j)^2 + c_ij l_i l_j = a_ij with
/// c_ij = |b_i - b_j|^2, in the order 12, 13, 23.
struct DistanceEquations {
  std::array<double, 3> a, c;

  Vec3<double> residual(const Vec3<double>& l) const {
    const double d12 = l.x() - l.y(), d13 = l.x() - l.z(), d23 = l.y() - l.z();
    return {d12 * d12 + c[0] * l.x() * l.y() - a[0], d13 * d13 + c[1] * l.x() * l.z() - a[1],
            d23 * d23 + c[2] * l.y() * l.z() - a[2]};
  }

  /// Newton's method; false if it leaves the distances negative or the equations unsolved.
  bool polish(Vec3<double>& l) const {
    Vec3<double> r = residual(l);
    double size = r.lpNorm<1>();
    for (int i = 0; i < 6 && size > 1e-16; ++i) {
      // Rows (u12, v12, 0), (u13, 0, v13), (0, u23, v23) of the Jacobian.
      const double d12 = 2.0 * (l.x() - l.y()), d13 = 2.0 * (l.x() - l.z()), d23 = 2.0 * (l.y() - l.z());
      const double u12 = d12 + c[0] * l.y(), v12 = -d12 + c[0] * l.x();
      const double u13 = d13 + c[1] * l.z(), v13 = -d13 + c[1] * l.x();
      const double u23 = d23 + c[2] * l.z(), v23 = -d23 + c[2] * l.y();
      const double determinant = -u12 * v13 * u23 - v12 * u13 * v23;
      if (determinant == 0.0) break;
      const Vec3<double> step((-v13 * u23 * r.x() - v12 * v23 * r.y() + v12 * v13 * r.z()) / determinant,
                              (-u13 * v23 * r.x() + u12 * v23 * r.y() - u12 * v13 * r.z()) / determinant,
                              (u13 * u23 * r.x() - u12 * u23 * r.y() - v12 * u13 * r.z()) / determinant);
      const Vec3<double> next = l - step;
      const Vec3<double> next_r = residual(next);
      const double next_size = next_r.lpNorm<1>();
      if (!(next_size < size)) break;
      l = next;
      r = next_r;
      size = next_size;
    }
    // Distances much larger than the triangle are known to fewer digits of its sides.
    return l.minCoeff() > 0.0 && size < 1e-8 + 1e-13 * l.squaredNorm();
  }
};

/// Real positive points where the line meets the conic, in homogeneous coordinates; returns their number.
inline int intersect_positive(const Vec3<double>& line, const Mat3<double>& conic,
                              std::array<Vec3<double>, 2>& points) {
  Eigen::Index k;
  line.cwiseAbs().maxCoeff(&k);
  const Eigen::Index i = (k + 1) % 3, j = (k + 2) % 3;
  // Points (u, v) -> u e_i + v e_j + (g u + h v) e_k of the line.
  const double g = -line(i) / line(k), h = -line(j) / line(k);
  const double A = conic(i, i) + 2.0 * g * conic(i, k) + g * g * conic(k, k);
  const double B = conic(i, j) + g * conic(j, k) + h * conic(i, k) + g * h * conic(k, k);
  const double C = conic(j, j) + 2.0 * h * conic(j, k) + h * h * conic(k, k);
  double discriminant = B * B - A * C;
  // A tangent that rounding has lifted off the conic still touches it.
  if (discriminant < 0.0 && discriminant > -1e-10 * (B * B + std::abs(A * C))) discriminant = 0.0;
  if (!(discriminant >= 0.0)) return 0;
  const double root = std::sqrt(discriminant);
  const double q = B >= 0.0 ? -(B + root) : root - B;
  int count = 0;
  const auto add = [&](double u, double v) {
    if (v < 0.0) u = -u, v = -v;
    const double w = g * u + h * v;
    if (!(u > 0.0 && v > 0.0 && w > 0.0)) return;
    auto& point = points[static_cast<std::size_t>(count++)];
    point(i) = u;
    point(j) = v;
    point(k) = w;
  };
  add(q, A);
  if (root > 0.0) add(C, q);
  return count;
}

/// Orthonormal axes spanned by two sides of a triangle: along the first, in the plane, normal to it.
inline Mat3<double> triangle_axes(const Vec3<double>& side, const Vec3<double>& other) {
  Mat3<double> axes;
  axes.col(0) = side.normalized();
  axes.col(2) = side.cross(other).normalized();
  axes.col(1) = axes.col(2).cross(axes.col(0));
  return axes;
}

inline int p3p_poses(std::span<const Vec3<double>, 3> points, std::span<const Vec3<double>, 3> bearings,
                     std::span<P3pPose, 4> poses) {
  // Numbered so that the longest side is between 2 and 3: the two conics below are then most different.
  std::array<std::size_t, 3> n{0, 1, 2};
  const double s01 = (points[0] - points[1]).squaredNorm(), s02 = (points[0] - points[2]).squaredNorm(),
               s12 = (points[1] - points[2]).squaredNorm();
  if (s02 >= s12 && s02 >= s01) n = {1, 0, 2};
  if (s01 > s12 && s01 > s02) n = {2, 0, 1};
  const Vec3<double>&x1 = points[n[0]], &x2 = points[n[1]], &x3 = points[n[2]];
  const Vec3<double>&b1 = bearings[n[0]], &b2 = bearings[n[1]], &b3 = bearings[n[2]];

  const double longest = (x2 - x3).squaredNorm();
  const Vec3<double> normal = (x2 - x1).cross(x3 - x1);
  if (!(normal.squaredNorm() > 1e-20 * longest * longest) || !std::isfinite(longest)) return 0;

  // In units of the longest side.
  DistanceEquations equations;
  equations.a = {(x1 - x2).squaredNorm() / longest, (x1 - x3).squaredNorm() / longest, 1.0};
  equations.c = {(b1 - b2).squaredNorm(), (b1 - b3).squaredNorm(), (b2 - b3).squaredNorm()};
  const double a12 = equations.a[0], a13 = equations.a[1];
  const double k12 = 1.0 - 0.5 * equations.c[0], k13 = 1.0 - 0.5 * equations.c[1],
               k23 = 1.0 - 0.5 * equations.c[2];

  // Two conics without constant term: a_23 Q_12 - a_12 Q_23 and a_23 Q_13 - a_13 Q_23.
  const Conic D1{1.0, -k12, 0.0, 1.0 - a12, a12 * k23, -a12};
  const Conic D2{1.0, 0.0, -k13, -a13, a13 * k23, 1.0 - a13};
  // det(D1 + g D2) = c3 g^3 + c2 g^2 + c1 g + c0, read from the end with the larger coefficient.
  const double c0 = D1.determinant(), c3 = D2.determinant();
  const double c1 = D1.adjugate().dot(D2), c2 = D2.adjugate().dot(D1);
  Conic D0 = D1;
  bool use_second = true;  // which conic the lines are intersected with: the one that D0 is less like
  if (std::abs(c3) >= std::abs(c0) && c3 != 0.0) {
    const double g = isolated_cubic_root(c2 / c3, c1 / c3, c0 / c3);
    use_second = std::abs(g) < 1.0;
    D0 = combine(D1, g, D2);
  } else if (c0 != 0.0) {
    const double g = isolated_cubic_root(c1 / c0, c2 / c0, c3 / c0);
    use_second = std::abs(g) > 1.0;
    D0 = combine(D2, g, D1);
  }

  // A conic of rank two is a pair of lines l m^T + m l^T; their common point p has adj(D0) = -p p^T, and
  // D0 + [p]x is 2 l m^T or its transpose (Richter-Gebert, Perspectives on Projective Geometry, 11.1).
  const Mat3<double> D = D0.matrix();
  const Mat3<double> adjugate = D0.adjugate().matrix();
  Eigen::Index largest;
  adjugate.diagonal().cwiseAbs().maxCoeff(&largest);
  const double square = -adjugate(largest, largest);
  if (!std::isfinite(square)) return 0;
  Mat3<double> lines = D;
  if (square > 0.0) {
    lines += SO3<double>::hat(adjugate.col(largest) / std::sqrt(square));
  } else if (square < -1e-12 * D.squaredNorm()) {
    return 0;  // two imaginary lines: no real pair of distances
  }
  Eigen::Index row, column;
  lines.cwiseAbs().maxCoeff(&row, &column);

  int count = 0;
  const Mat3<double> conic = (use_second ? D2 : D1).matrix();
  const double total = a12 + a13 + 1.0;
  const Mat3<double> world_axes = triangle_axes(x3 - x2, x1 - x2);
  const double unit = std::sqrt(longest);
  std::array<Vec3<double>, 4> distances;
  for (const Vec3<double>& line : {Vec3<double>(lines.row(row)), Vec3<double>(lines.col(column))}) {
    std::array<Vec3<double>, 2> meets;
    const int number = intersect_positive(line, conic, meets);
    for (int m = 0; m < number; ++m) {
      Vec3<double> l = meets[static_cast<std::size_t>(m)];
      const double form = equations.residual(l).sum() + total;
      l *= std::sqrt(total / form);
      if (!l.allFinite() || !equations.polish(l)) continue;
      const auto known = std::span<const Vec3<double>>(distances).first(static_cast<std::size_t>(count));
      const bool repeated = std::any_of(known.begin(), known.end(), [&](const Vec3<double>& k) {
        return (k - l).squaredNorm() < 1e-16 * l.squaredNorm();
      });
      if (repeated) continue;
      distances[static_cast<std::size_t>(count)] = l;
      const Vec3<double> y1 = l.x() * b1, y2 = l.y() * b2, y3 = l.z() * b3;
      P3pPose& pose = poses[static_cast<std::size_t>(count)];
      pose.R = triangle_axes(y3 - y2, y1 - y2) * world_axes.transpose();
      pose.t = unit * (y1 + y2 + y3) / 3.0 - pose.R * ((x1 + x2 + x3) / 3.0);
      if (pose.R.allFinite() && pose.t.allFinite()) ++count;
    }
  }
  return count;
}

}  // namespace sweepkit::impl
