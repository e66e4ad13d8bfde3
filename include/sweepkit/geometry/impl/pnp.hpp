// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <span>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/geometry/impl/p3p.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

namespace impl {

/// Nearer points than this are behind the camera [m].
inline constexpr double kMinDepth = 1e-6;

/// T_camera_world, kept as a matrix because it is applied to many points.
struct PnpPose {
  Mat3<double> R = Mat3<double>::Identity();
  Vec3<double> t = Vec3<double>::Zero();

  static PnpPose from(const SE3<double>& T_world_camera) {
    const SE3<double> T = T_world_camera.inverse();
    return {T.rotation().matrix(), T.translation()};
  }
  SE3<double> T_world_camera() const { return SE3<double>(SO3<double>(R), t).inverse(); }
  /// The pose after T_world_camera * Exp(xi).
  PnpPose moved(const Vec6<double>& xi) const {
    const SE3<double> T = SE3<double>::exp(-xi);
    const Mat3<double> dR = T.rotation().matrix();
    return {dR * R, dR * t + T.translation()};
  }
};

/// Errors of a match, predicted less measured, in normalised coordinates: x, y and, with `right`, x in the
/// right camera; false for a point behind the camera.
/// @param J derivatives by xi in T_world_camera * Exp(xi), a row for each error; may be null
inline bool pnp_error(const Vec3<double>& p_camera, const Vec2<double>& ray, const double* right,
                      double baseline, Vec3<double>& error, Eigen::Matrix<double, 3, 6>* J) {
  const double z = p_camera.z();
  if (!(z > kMinDepth)) return false;
  const double inverse_z = 1.0 / z;
  const double x = p_camera.x() * inverse_z, y = p_camera.y() * inverse_z;
  const double x_right = x - baseline * inverse_z;
  error << x - ray.x(), y - ray.y(), right ? x_right - *right : 0.0;
  if (J) {
    // The point moves by -rho + p x phi.
    J->row(0) << -inverse_z, 0.0, x * inverse_z, x * y, -1.0 - x * x, y;
    J->row(1) << 0.0, -inverse_z, y * inverse_z, 1.0 + y * y, -x * y, -x;
    if (right)
      J->row(2) << -inverse_z, 0.0, x_right * inverse_z, x_right * y, -1.0 - x * x_right, y;
    else
      J->row(2).setZero();
  }
  return true;
}

struct PnpFit {
  Mat6<double> H = Mat6<double>::Zero();  ///< J^T W J of whitened errors
  Vec6<double> g = Vec6<double>::Zero();  ///< J^T W e
  double cost = 0.0;                      ///< sum of Huber's loss, half squares
  double rmse = 0.0;                      ///< [sigmas]
  int iterations = 0;
};

template <class Matches>
void check_matches(const Matches& m) {
  require(m.rays.size() == m.points.size(), "PnpMatches.rays", "must be as many as points", m.rays.size());
  require(m.right_x.empty() || m.right_x.size() == m.points.size(), "PnpMatches.right_x",
          "must be none or as many as points", m.right_x.size());
  require(m.sigmas.empty() || m.sigmas.size() == m.points.size(), "PnpMatches.sigmas",
          "must be none or as many as points", m.sigmas.size());
  require(m.focal > 0.0 && std::isfinite(m.focal), "PnpMatches.focal", "must be above zero", m.focal);
}

template <class Matches>
const double* right_of(const Matches& m, std::size_t i) {
  return m.right_x.empty() || std::isnan(m.right_x[i]) ? nullptr : &m.right_x[i];
}

/// Pixels per unit of x/z over the sigma of the match [1/sigma].
template <class Matches>
double whitening(const Matches& m, std::size_t i) {
  return m.sigmas.empty() ? m.focal : m.focal / m.sigmas[i];
}

/// Normal equations and cost of every `stride`-th of the chosen matches.
template <class Matches>
PnpFit normal_equations(const Matches& m, std::span<const int> chosen, std::size_t stride, double huber_width,
                        const PnpPose& pose) {
  PnpFit fit;
  // The upper triangle in rows, as plain numbers: faster than products of small matrices.
  std::array<double, 21> H{};
  std::array<double, 6> g{};
  double squares = 0.0;
  int coordinates = 0;
  Eigen::Matrix<double, 3, 6> J;
  Vec3<double> e;
  for (std::size_t c = 0; c < chosen.size(); c += stride) {
    const auto i = static_cast<std::size_t>(chosen[c]);
    const double* right = right_of(m, i);
    const int rows = right ? 3 : 2;
    if (!pnp_error(pose.R * m.points[i] + pose.t, m.rays[i], right, m.baseline, e, &J)) {
      // As bad as a point at the edge of the linear part, so that no step gains by pushing points behind.
      fit.cost += 0.5 * huber_width * huber_width * 100.0;
      continue;
    }
    const double whiten = whitening(m, i);
    const double square = e.squaredNorm() * whiten * whiten;
    const double norm = std::sqrt(square);
    const bool linear = norm > huber_width;
    const double weight = linear ? huber_width / norm : 1.0;
    fit.cost += linear ? huber_width * (norm - 0.5 * huber_width) : 0.5 * square;
    squares += square;
    coordinates += rows;
    const double scale = weight * whiten * whiten;
    for (int r = 0; r < rows; ++r) {
      std::size_t k = 0;
      for (int a = 0; a < 6; ++a) {
        const double Ja = scale * J(r, a);
        g[static_cast<std::size_t>(a)] += Ja * e(r);
        for (int b = a; b < 6; ++b) H[k++] += Ja * J(r, b);
      }
    }
  }
  std::size_t k = 0;
  for (int a = 0; a < 6; ++a) {
    fit.g(a) = g[static_cast<std::size_t>(a)];
    for (int b = a; b < 6; ++b, ++k) fit.H(a, b) = fit.H(b, a) = H[k];
  }
  fit.rmse = coordinates > 0 ? std::sqrt(squares / coordinates) : 0.0;
  return fit;
}

/// Levenberg-Marquardt; `pose` is start and result. What it returns belongs to the result.
template <class Matches>
PnpFit fit_pnp(const Matches& m, std::span<const int> chosen, std::size_t stride, double huber_width,
               int max_iterations, PnpPose& pose) {
  PnpFit fit = normal_equations(m, chosen, stride, huber_width, pose);
  double damping = 1e-6;
  int iterations = 0;
  while (iterations < max_iterations) {
    ++iterations;
    Mat6<double> H = fit.H;
    H.diagonal() *= 1.0 + damping;
    const Eigen::LLT<Mat6<double>> llt(H);
    if (llt.info() != Eigen::Success) {
      damping = std::max(1e-3, damping * 10.0);
      continue;
    }
    const Vec6<double> xi = -llt.solve(fit.g);
    if (!xi.allFinite()) break;
    const PnpPose next = pose.moved(xi);
    const PnpFit next_fit = normal_equations(m, chosen, stride, huber_width, next);
    // The decrease that the quadratic model promises, in units in which one sigma of one error is one half.
    const double promised = -0.5 * fit.g.dot(xi);
    const bool done = promised < 1e-10;
    if (next_fit.cost <= fit.cost) {
      pose = next;
      fit = next_fit;
      damping = std::max(damping * 0.1, 1e-12);
    } else {
      damping = std::max(1e-4, damping * 10.0);
    }
    if (done) break;
  }
  // Steps add up rounding errors in R.
  pose.R = SO3<double>(pose.R).matrix();
  fit.iterations = iterations;
  return fit;
}

/// Inverse of H; false if a degree of freedom is not fixed, by the pivots of H scaled to a unit diagonal.
inline bool pnp_covariance(const Mat6<double>& H, Mat6<double>& covariance) {
  const Vec6<double> diagonal = H.diagonal();
  if (!(diagonal.minCoeff() > 0.0) || !diagonal.allFinite()) return false;
  const Vec6<double> scale = diagonal.cwiseSqrt().cwiseInverse();
  const Mat6<double> scaled = scale.asDiagonal() * H * scale.asDiagonal();
  const Eigen::LLT<Mat6<double>> llt(scaled);
  if (llt.info() != Eigen::Success) return false;
  const Vec6<double> pivots = llt.matrixLLT().diagonal();
  if (!(pivots.minCoeff() > 1e-5)) return false;
  const Mat6<double> inverse = llt.solve(Mat6<double>::Identity());
  covariance = scale.asDiagonal() * inverse * scale.asDiagonal();
  covariance = (0.5 * (covariance + covariance.transpose())).eval();
  return covariance.allFinite();
}

/// The estimator for ransac(): P3P, truncated reprojection errors, a few steps of fit_pnp.
template <class Matches>
class PnpEstimator {
 public:
  using Model = PnpPose;
  static constexpr int kSampleSize = 3;
  static constexpr int kMaxModels = 4;

  PnpEstimator(const Matches& matches, double threshold, double huber_width)
      : m_(matches), threshold_(threshold), huber_width_(huber_width) {
    const std::size_t n = m_.points.size();
    std::size_t finite = 0;
    for (std::size_t i = 0; i < n; ++i)
      if (m_.points[i].allFinite()) {
        mean_ += m_.points[i];
        ++finite;
      }
    if (finite > 0) mean_ /= static_cast<double>(finite);
    bearings_.resize(n);
    padded_ = (n + kBlock - 1) / kBlock * kBlock;
    // What fills the last block, and stands for values that are not finite, is an outlier to any pose.
    lanes_.assign(padded_ * kLanes, 0.0f);
    for (std::size_t i = 0; i < padded_; ++i) {
      const bool used = i < n && is_finite(i);
      const double* right = used ? right_of(m_, i) : nullptr;
      const Vec3<double> p = used ? Vec3<double>(m_.points[i] - mean_) : Vec3<double>::Zero();
      const double weight = used ? inverse_threshold2(i, right != nullptr) : 1.0;
      lane(0)[i] = static_cast<float>(p.x());
      lane(1)[i] = static_cast<float>(p.y());
      lane(2)[i] = static_cast<float>(p.z());
      lane(3)[i] = used ? static_cast<float>(m_.rays[i].x()) : kNowhere;
      lane(4)[i] = used ? static_cast<float>(m_.rays[i].y()) : kNowhere;
      lane(5)[i] = right ? static_cast<float>(*right) : 0.0f;
      lane(6)[i] = static_cast<float>(weight);
      lane(7)[i] = right ? 1.0f : 0.0f;
      if (i < n)
        bearings_[i] = used ? Vec3<double>(m_.rays[i].homogeneous().normalized()) : Vec3<double>::Zero();
    }
  }

  int size() const { return static_cast<int>(m_.points.size()); }

  int solve(std::span<const int, 3> sample, std::span<PnpPose, 4> models) const {
    std::array<Vec3<double>, 3> points, bearings;
    for (std::size_t k = 0; k < 3; ++k) {
      points[k] = m_.points[static_cast<std::size_t>(sample[k])];
      bearings[k] = bearings_[static_cast<std::size_t>(sample[k])];
    }
    std::array<P3pPose, 4> poses;
    const int count = p3p_poses(points, bearings, poses);
    for (std::size_t k = 0; k < static_cast<std::size_t>(count); ++k) models[k] = {poses[k].R, poses[k].t};
    return count;
  }

  double cost(const PnpPose& pose, int index) const {
    const auto i = static_cast<std::size_t>(index);
    const double* right = right_of(m_, i);
    Vec3<double> e;
    if (!pnp_error(pose.R * m_.points[i] + pose.t, m_.rays[i], right, m_.baseline, e, nullptr)) return 1.0;
    const double cost = e.squaredNorm() * inverse_threshold2(i, right != nullptr);
    return cost < 1.0 ? cost : 1.0;
  }

  double score(const PnpPose& pose, double bound) const {
    using Block = Eigen::Array<float, static_cast<int>(kBlock), 1>;
    const Eigen::Matrix3f R = pose.R.cast<float>();
    const Eigen::Vector3f t = (pose.R * mean_ + pose.t).cast<float>();
    const auto baseline = static_cast<float>(m_.baseline);
    double sum = -static_cast<double>(padded_ - m_.points.size());
    for (std::size_t i = 0; i < padded_ && sum < bound; i += kBlock) {
      const auto load = [&](std::size_t k) { return Eigen::Map<const Block>(lane(k) + i); };
      const Block x = load(0), y = load(1), z = load(2);
      const Block Z = R(2, 0) * x + R(2, 1) * y + R(2, 2) * z + t(2);
      const Block X = R(0, 0) * x + R(0, 1) * y + R(0, 2) * z + t(0);
      const Block Y = R(1, 0) * x + R(1, 1) * y + R(1, 2) * z + t(1);
      const Block e_x = X - load(3) * Z, e_y = Y - load(4) * Z;
      Block squares = e_x.square() + e_y.square();
      if (!m_.right_x.empty()) squares += load(7) * (X - baseline - load(5) * Z).square();
      const Block cost = squares * load(6) / Z.square();
      sum += static_cast<double>((Z > static_cast<float>(kMinDepth)).select(cost.min(1.0f), 1.0f).sum());
    }
    return sum;
  }

  /// On at most about kLocal matches: enough to pull a model of three points to where its inliers are.
  bool refine(PnpPose& pose, std::span<const int> chosen) const {
    const std::size_t stride = std::max<std::size_t>(1, chosen.size() / kLocal);
    fit_pnp(m_, chosen, stride, huber_width_, kLocalIterations, pose);
    return pose.R.allFinite() && pose.t.allFinite();
  }

  /// Replaces the list by the inliers of the pose; false if it stays the same.
  bool select(const PnpPose& pose, std::vector<int>& inliers) const {
    std::vector<int> chosen;
    chosen.reserve(m_.points.size());
    for (int i = 0; i < size(); ++i)
      if (cost(pose, i) < 1.0) chosen.push_back(i);
    if (chosen == inliers) return false;
    inliers.swap(chosen);
    return true;
  }

 private:
  static constexpr std::size_t kBlock = 16;
  static constexpr std::size_t kLanes = 8;
  static constexpr std::size_t kLocal = 50;
  static constexpr int kLocalIterations = 3;
  static constexpr float kNowhere = 1e6f;
  /// 95 % quantile of chi square with three degrees of freedom over that with two.
  static constexpr double kThirdCoordinate = 7.815 / 5.991;

  const float* lane(std::size_t k) const { return lanes_.data() + k * padded_; }
  float* lane(std::size_t k) { return lanes_.data() + k * padded_; }

  bool is_finite(std::size_t i) const {
    const double whiten = whitening(m_, i);
    const double* right = right_of(m_, i);
    return m_.points[i].allFinite() && m_.rays[i].allFinite() && whiten > 0.0 && std::isfinite(whiten) &&
           (!right || std::isfinite(*right));
  }
  /// Squared error in normalised coordinates to squared error over squared threshold; infinite, which makes
  /// an outlier, for a sigma that cannot be.
  double inverse_threshold2(std::size_t i, bool has_right) const {
    const double factor = whitening(m_, i) / threshold_;
    if (!(factor > 0.0)) return std::numeric_limits<double>::infinity();
    return factor * factor / (has_right ? kThirdCoordinate : 1.0);
  }

  const Matches& m_;
  double threshold_;
  double huber_width_;
  Vec3<double> mean_ = Vec3<double>::Zero();
  std::size_t padded_ = 0;
  std::vector<float> lanes_;
  std::vector<Vec3<double>> bearings_;
};

}  // namespace impl
}  // namespace sweepkit
