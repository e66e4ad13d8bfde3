// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <span>

#include "sweepkit/core/error.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/geometry/sim3.hpp"

namespace sweepkit {

/// The motion that takes one set of points to another: p_dst = scale * R p_src + t.
template <class S>
struct Alignment {
  SE3<S> T_dst_src;       ///< R and t; the scale stands beside it, not in it
  S scale = S(1);         ///< exactly 1 for align_se3
  S rmse = S(0);          ///< root of the weighted mean of squared distances after it [m]
  bool mirrored = false;  ///< a reflection would fit better: one set is mirrored, or flat within its noise

  Sim3<S> similarity() const { return {T_dst_src.rotation(), T_dst_src.translation(), scale}; }
  Vec3<S> operator*(const Vec3<S>& p_src) const {
    return scale * (T_dst_src.rotation() * p_src) + T_dst_src.translation();
  }
};

namespace impl {

/// Umeyama, Least-squares estimation of transformation parameters between two point patterns (PAMI 1991),
/// equations 34 to 43, with weights. In double whatever S is.
template <class S>
std::optional<Alignment<S>> align_points(std::span<const Vec3<S>> src, std::span<const Vec3<S>> dst,
                                         std::span<const S> weights, bool with_scale) {
  require(src.size() == dst.size(), "align dst", "must have as many points as src", dst.size());
  require(weights.empty() || weights.size() == src.size(), "align weights",
          "must be none or as many as points", weights.size());
  if (src.size() < 3) return std::nullopt;

  double sum = 0.0, largest = 0.0;
  Vec3<double> mean_src = Vec3<double>::Zero(), mean_dst = Vec3<double>::Zero();
  for (std::size_t i = 0; i < src.size(); ++i) {
    const double w = weights.empty() ? 1.0 : static_cast<double>(weights[i]);
    if (!(w >= 0.0)) return std::nullopt;
    sum += w;
    mean_src += w * src[i].template cast<double>();
    mean_dst += w * dst[i].template cast<double>();
    largest = std::max({largest, static_cast<double>(src[i].template lpNorm<Eigen::Infinity>()),
                        static_cast<double>(dst[i].template lpNorm<Eigen::Infinity>())});
  }
  if (!(sum > 0.0)) return std::nullopt;
  mean_src /= sum;
  mean_dst /= sum;

  Mat3<double> cross = Mat3<double>::Zero();
  double variance_src = 0.0, variance_dst = 0.0;
  for (std::size_t i = 0; i < src.size(); ++i) {
    const double w = (weights.empty() ? 1.0 : static_cast<double>(weights[i])) / sum;
    const Vec3<double> a = src[i].template cast<double>() - mean_src;
    const Vec3<double> b = dst[i].template cast<double>() - mean_dst;
    cross += w * b * a.transpose();
    variance_src += w * a.squaredNorm();
    variance_dst += w * b.squaredNorm();
  }
  if (!cross.allFinite() || !(variance_src > 0.0) || !(variance_dst > 0.0)) return std::nullopt;

  const Eigen::JacobiSVD<Mat3<double>> svd(cross, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Vec3<double> s = svd.singularValues();
  const double sign = svd.matrixU().determinant() * svd.matrixV().determinant() < 0.0 ? -1.0 : 1.0;
  // The rotation is unique only if the last two singular values do not cancel (Umeyama, lemma): they do for
  // collinear sets (both zero) and for mirrored sets that are alike about an axis. What rounding of the
  // coordinates leaves of them counts as zero.
  const double rounding = 8.0 * static_cast<double>(std::numeric_limits<S>::epsilon()) * largest;
  const double tolerance = std::max(1e-10, rounding / std::sqrt(std::min(variance_src, variance_dst)));
  if (!(s(1) + sign * s(2) > tolerance * s(0))) return std::nullopt;

  const Mat3<double> R =
      svd.matrixU() * Vec3<double>(1.0, 1.0, sign).asDiagonal() * svd.matrixV().transpose();
  const double trace = s(0) + s(1) + sign * s(2);
  const double scale = with_scale ? trace / variance_src : 1.0;

  Alignment<S> result;
  const SO3<double> rotation(R);
  const Vec3<double> t = mean_dst - scale * (rotation * mean_src);
  result.T_dst_src = SE3<S>(rotation.template cast<S>(), t.template cast<S>());
  result.scale = static_cast<S>(scale);
  double squares = 0.0;
  for (std::size_t i = 0; i < src.size(); ++i)
    squares += (weights.empty() ? 1.0 : static_cast<double>(weights[i])) *
               (scale * (rotation * src[i].template cast<double>()) + t - dst[i].template cast<double>())
                   .squaredNorm();
  result.rmse = static_cast<S>(std::sqrt(squares / sum));
  result.mirrored = sign < 0.0 && s(2) > tolerance * s(0);
  return result;
}

}  // namespace impl

/// Rigid motion that brings src nearest to dst (least squares of the distances, Horn 1987, Umeyama 1991).
/// Points correspond by position in the lists.
/// @param weights empty, or one weight of at least zero for each pair
/// @return nothing if the rotation is not determined: fewer than three points, collinear ones, values that
///     are not finite, or mirrored sets for which several rotations are equally good
/// @throws Error(argument) if the lists differ in length
template <class S>
std::optional<Alignment<S>> align_se3(std::span<const Vec3<S>> src, std::span<const Vec3<S>> dst,
                                      std::span<const S> weights = {}) {
  return impl::align_points(src, dst, weights, false);
}

/// As align_se3, with a scale in the result that is found too (over the distances in dst: Umeyama's, which is
/// not the inverse of that from dst to src when there is noise).
template <class S>
std::optional<Alignment<S>> align_sim3(std::span<const Vec3<S>> src, std::span<const Vec3<S>> dst,
                                       std::span<const S> weights = {}) {
  return impl::align_points(src, dst, weights, true);
}

}  // namespace sweepkit
