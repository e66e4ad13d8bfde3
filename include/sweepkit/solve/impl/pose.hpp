// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "sweepkit/core/error.hpp"
#include "sweepkit/solve/motion_error.hpp"
#include "sweepkit/solve/pose.hpp"

// Left to itself the compiler gives up inlining Eigen's expressions in so long a function, which then takes
// three times as long. Without optimization, or with sanitizers, to insist would take minutes to compile.
#if defined(__OPTIMIZE__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define SWEEPKIT_INLINE_ALL [[gnu::noinline, gnu::flatten]]
#else
#define SWEEPKIT_INLINE_ALL [[gnu::noinline]]
#endif

namespace sweepkit {
namespace pose_detail {

using Eigen::Array4d;

constexpr double kGateMono = 5.991464547107979;    // chi-square, 95 %, 2 degrees of freedom
constexpr double kGateStereo = 7.814727903251179;  // and 3
constexpr double kBehindChi2 = 1e9;
// What a point behind the camera costs, in gates: keeps steps from turning the camera away from the points.
constexpr double kBehindCost = 100.0;

/// Normal equations at a pose: H xi = -g.
struct Linearization {
  Mat6<double> H;
  Vec6<double> g;
  double cost;
};

inline void prepare(const RectifiedCamera& camera, const SE3d& T_camera_world,
                    std::span<const PoseObservation> observations, const PoseOptions& options,
                    std::vector<PoseBlock>& blocks) {
  const Mat3<double> R = T_camera_world.rotation().matrix();
  blocks.resize((observations.size() + 3) / 4);
  const double bf = camera.focal * camera.baseline;
  for (std::size_t i = 0; i < 4 * blocks.size(); ++i) {
    PoseBlock& block = blocks[i / 4];
    const Eigen::Index l = static_cast<Eigen::Index>(i % 4);
    if (i >= observations.size()) {
      block.x[l] = block.y[l] = block.z[l] = block.u[l] = block.v[l] = block.d[l] = 0.0;
      block.wu[l] = block.wv[l] = block.wd[l] = block.use[l] = 0.0;
      block.gate[l] = block.inv_gate[l] = 1.0;
      continue;
    }
    const PoseObservation& o = observations[i];
    const bool stereo = !(o.u_right < 0.0F);
    // A sum is finite only if its terms are.
    const double sum = o.p_world.sum() + o.u + o.v + o.u_right + o.p_world_spread.sum();
    require(std::isfinite(sum), "solve_pose observation", "must be finite", i);
    require(o.sigma > 0.0F && std::isfinite(o.sigma), "solve_pose sigma", "must be positive", o.sigma);
    double var_u = static_cast<double>(o.sigma) * o.sigma, var_v = var_u, var_d = 0.0;
    if (stereo) {
      require(o.sigma_disparity > 0.0F && std::isfinite(o.sigma_disparity), "solve_pose sigma_disparity",
              "must be positive", o.sigma_disparity);
      var_d = static_cast<double>(o.sigma_disparity) * o.sigma_disparity;
    }
    if (options.point_uncertainty && !o.p_world_spread.isZero(0.0F)) {
      const Vec3<double> p = T_camera_world * o.p_world, spread = R * o.p_world_spread.cast<double>();
      if (p.z() > RectifiedCamera::kMinDepth) {
        const double iz = 1.0 / p.z(), fz = camera.focal * iz;
        const double du = fz * (spread.x() - p.x() * iz * spread.z());
        const double dv = fz * (spread.y() - p.y() * iz * spread.z());
        const double dd = bf * iz * iz * spread.z();
        var_u += du * du;
        var_v += dv * dv;
        var_d += dd * dd;
      }
    }
    block.x[l] = o.p_world.x();
    block.y[l] = o.p_world.y();
    block.z[l] = o.p_world.z();
    block.u[l] = o.u - camera.cx;
    block.v[l] = o.v - camera.cy;
    block.d[l] = stereo ? static_cast<double>(o.u) - o.u_right : 0.0;
    block.wu[l] = 1.0 / var_u;
    block.wv[l] = 1.0 / var_v;
    block.wd[l] = stereo ? 1.0 / var_d : 0.0;
    block.gate[l] = (stereo ? kGateStereo : kGateMono) * options.gate;
    block.inv_gate[l] = 1.0 / block.gate[l];
    block.use[l] = 1.0;
  }
}

inline void add_prior(const PosePrior& prior, const SE3d& T, Linearization& out) {
  Mat6<double> J;
  const Vec6<double> e = pose_error(T, prior.T_camera_world, &J);
  const Vec6<double> weighted = prior.information * e;
  out.H.noalias() += J.transpose() * prior.information * J;
  out.g.noalias() += J.transpose() * weighted;
  out.cost += e.dot(weighted);
}

/// The sums over all blocks; also leaves each observation's chi2 in its block.
/// @param scale2 squared scale of the loss, in gates
template <RobustLoss Loss>
SWEEPKIT_INLINE_ALL void linearize(const RectifiedCamera& camera, const SE3d& T,
                                   std::vector<PoseBlock>& blocks, double scale2, const PosePrior* prior,
                                   Linearization& out) {
  const Mat3<double> R = T.rotation().matrix();
  const Vec3<double> t = T.translation();
  const double f = camera.focal, bf = camera.focal * camera.baseline;
  const double inv_scale2 = 1.0 / scale2;
  Array4d h00 = Array4d::Zero(), h02 = h00, h03 = h00, h04 = h00, h05 = h00, h11 = h00, h12 = h00, h13 = h00,
          h14 = h00, h15 = h00, h22 = h00, h23 = h00, h24 = h00, h25 = h00, h33 = h00, h34 = h00, h35 = h00,
          h44 = h00, h45 = h00, h55 = h00, g0 = h00, g1 = h00, g2 = h00, g3 = h00, g4 = h00, g5 = h00,
          cost = h00;
  for (PoseBlock& k : blocks) {
    const Array4d x = R(0, 0) * k.x + R(0, 1) * k.y + R(0, 2) * k.z + t.x();
    const Array4d y = R(1, 0) * k.x + R(1, 1) * k.y + R(1, 2) * k.z + t.y();
    const Array4d z = R(2, 0) * k.x + R(2, 1) * k.y + R(2, 2) * k.z + t.z();
    const Array4d in_front = (z > RectifiedCamera::kMinDepth).select(Array4d::Ones(), Array4d::Zero());
    const Array4d iz = (z > RectifiedCamera::kMinDepth).select(z, Array4d::Ones()).inverse();
    const Array4d a = x * iz, b = y * iz;
    const Array4d ru = f * a - k.u, rv = f * b - k.v, rd = bf * iz - k.d;
    const Array4d wru = k.wu * ru, wrv = k.wv * rv, wrd = k.wd * rd;
    const Array4d chi2 = wru * ru + wrv * rv + wrd * rd;
    k.chi2 = in_front * chi2 + (1.0 - in_front) * kBehindChi2;
    // A point that has come behind costs much, but pulls no more.
    const Array4d e = (in_front * chi2 * k.inv_gate + (1.0 - in_front) * kBehindCost) * inv_scale2;
    Array4d rho, weight;
    Loss::evaluate(e, rho, weight);
    cost += k.use * k.gate * rho;
    weight *= k.use * in_front;

    // Rows of the Jacobian for Exp(xi) T, p <- p + rho - p x phi:
    //   u: f (iz, 0, -a iz, -ab, 1 + aa, -b)   v: f (0, iz, -b iz, -1 - bb, ab, a)
    //   disparity: f baseline iz (0, 0, -iz, -b, a, 0)
    const Array4d fw = f * weight;
    const Array4d su = fw * wru, sv = fw * wrv, sd = (bf * iz) * weight * wrd;
    const Array4d wu = f * fw * k.wu, wv = f * fw * k.wv, wd = (bf * iz).square() * weight * k.wd;
    const Array4d ab = a * b, aiz = a * iz, biz = b * iz;
    const Array4d u4 = 1.0 + a * a, v3 = 1.0 + b * b;

    g0 += su * iz;
    g1 += sv * iz;
    g2 -= su * aiz + sv * biz + sd * iz;
    g3 -= su * ab + sv * v3 + sd * b;
    g4 += su * u4 + sv * ab + sd * a;
    g5 += sv * a - su * b;

    const Array4d u0 = wu * iz, v1 = wv * iz;
    h00 += u0 * iz;
    h02 -= u0 * aiz;
    h03 -= u0 * ab;
    h04 += u0 * u4;
    h05 -= u0 * b;
    h11 += v1 * iz;
    h12 -= v1 * biz;
    h13 -= v1 * v3;
    h14 += v1 * ab;
    h15 += v1 * a;
    const Array4d u2 = wu * aiz, v2 = wv * biz, d2 = wd * iz;
    h22 += u2 * aiz + v2 * biz + d2 * iz;
    h23 += u2 * ab + v2 * v3 + d2 * b;
    h24 -= u2 * u4 + v2 * ab + d2 * a;
    h25 += u2 * b - v2 * a;
    const Array4d u3 = wu * ab, v33 = wv * v3, d3 = wd * b;
    h33 += u3 * ab + v33 * v3 + d3 * b;
    h34 -= u3 * u4 + v33 * ab + d3 * a;
    h35 += u3 * b - v33 * a;
    const Array4d u44 = wu * u4, v4 = wv * ab;
    h44 += u44 * u4 + v4 * ab + wd * a * a;
    h45 += v4 * a - u44 * b;
    h55 += wu * b * b + wv * a * a;
  }
  Mat6<double>& H = out.H;
  H(0, 0) = h00.sum();
  H(0, 1) = 0.0;
  H(0, 2) = h02.sum();
  H(0, 3) = h03.sum();
  H(0, 4) = h04.sum();
  H(0, 5) = h05.sum();
  H(1, 1) = h11.sum();
  H(1, 2) = h12.sum();
  H(1, 3) = h13.sum();
  H(1, 4) = h14.sum();
  H(1, 5) = h15.sum();
  H(2, 2) = h22.sum();
  H(2, 3) = h23.sum();
  H(2, 4) = h24.sum();
  H(2, 5) = h25.sum();
  H(3, 3) = h33.sum();
  H(3, 4) = h34.sum();
  H(3, 5) = h35.sum();
  H(4, 4) = h44.sum();
  H(4, 5) = h45.sum();
  H(5, 5) = h55.sum();
  for (int r = 1; r < 6; ++r)
    for (int c = 0; c < r; ++c) H(r, c) = H(c, r);
  out.g << g0.sum(), g1.sum(), g2.sum(), g3.sum(), g4.sum(), g5.sum();
  out.cost = scale2 * cost.sum();
  if (prior) add_prior(*prior, T, out);
}

/// Solves (D (H) D + lambda I) with D making H's diagonal ones; nothing if H has no full rank.
class ScaledCholesky {
 public:
  bool compute(const Mat6<double>& H, double lambda) {
    for (int i = 0; i < 6; ++i) {
      if (!(H(i, i) > 0.0)) return false;
      scale_[i] = 1.0 / std::sqrt(H(i, i));
    }
    Mat6<double> A = scale_.asDiagonal() * H * scale_.asDiagonal();
    A.diagonal().array() += lambda;
    llt_.compute(A);
    // Pivots are what the columns before leave unexplained of a parameter, 1 at best.
    return llt_.info() == Eigen::Success && llt_.matrixLLT().diagonal().minCoeff() > kMinPivotRoot;
  }
  Vec6<double> solve(const Vec6<double>& b) const {
    return scale_.asDiagonal() * llt_.solve(scale_.asDiagonal() * b);
  }
  Mat6<double> inverse() const {
    return scale_.asDiagonal() * llt_.solve(Mat6<double>::Identity()) * scale_.asDiagonal();
  }

 private:
  static constexpr double kMinPivotRoot = 3e-5;  // root of 1e-9
  Vec6<double> scale_;
  Eigen::LLT<Mat6<double>> llt_;
};

/// Levenberg and Marquardt's method from T, whose linearization `at` has to be; leaves both at the best pose.
/// True once a step moves the pose by less than `tolerance` standard deviations.
template <RobustLoss Loss>
bool descend(const RectifiedCamera& camera, std::vector<PoseBlock>& blocks, double scale2,
             const PosePrior* prior, int max_iterations, double tolerance, SE3d& T, Linearization& at,
             int& iterations) {
  double lambda = 0.0;
  ScaledCholesky cholesky;
  Linearization next;
  for (int i = 0; i < max_iterations; ++i) {
    while (!cholesky.compute(at.H, lambda)) {
      lambda = std::max(1e-6, 10.0 * lambda);
      if (lambda > 1e3) return false;
    }
    ++iterations;
    const Vec6<double> xi = -cholesky.solve(at.g);
    if (!xi.allFinite()) return false;
    const SE3d T_next = SE3d::exp(xi) * T;
    linearize<Loss>(camera, T_next, blocks, scale2, prior, next);
    const double moved2 = xi.dot(at.H * xi);
    // Near the minimum rounding decides whether the cost still falls.
    if (next.cost <= at.cost * (1.0 + 1e-12) + 1e-12) {
      T = T_next;
      at = next;
      lambda = lambda > 1e-6 ? 0.1 * lambda : 0.0;
      if (moved2 < tolerance * tolerance) return true;
    } else {
      if (moved2 < tolerance * tolerance) {
        linearize<Loss>(camera, T, blocks, scale2, prior, at);
        return true;
      }
      lambda = std::max(1e-3, 10.0 * lambda);
    }
  }
  // The blocks hold the chi2 of the last trial, which may have been refused.
  linearize<Loss>(camera, T, blocks, scale2, prior, at);
  return false;
}

/// Median of chi2 over its gate, of the observations in front of the camera.
inline double median_error(const std::vector<PoseBlock>& blocks, std::vector<double>& sorted) {
  sorted.clear();
  for (const PoseBlock& k : blocks)
    for (Eigen::Index l = 0; l < 4; ++l)
      if (k.use[l] > 0.0 && k.chi2[l] < kBehindChi2) sorted.push_back(k.chi2[l] * k.inv_gate[l]);
  if (sorted.empty()) return 0.0;
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  return *middle;
}

/// How much less than its inverse variance an observation within the gate c of chi-square tells of the
/// pose, because the gate cuts the tails on which the sum of squares rests. For normal errors of k dimensions
/// the estimate that solves sum J^T r [r^2 < c] = 0 has the covariance (J^T J)^-1 / F_{k+2}(c), F_n the
/// distribution of chi-square (an M-estimator's, Huber 1981, section 6.3, by Stein's lemma), while F_k(c) of
/// the observations are within.
inline double gated_information(bool stereo, double c) {
  const double tail = std::exp(-0.5 * c);
  if (!stereo) return (1.0 - tail * (1.0 + 0.5 * c)) / (1.0 - tail);
  const double density = std::sqrt(2.0 * c / std::numbers::pi) * tail;
  const double f3 = std::erf(std::sqrt(0.5 * c)) - density;
  return (f3 - density * c / 3.0) / f3;
}

}  // namespace pose_detail

template <RobustLoss Loss>
PoseResult solve_pose_with(const RectifiedCamera& camera, const SE3d& T_camera_world,
                           std::span<const PoseObservation> observations, const PoseOptions& options,
                           std::vector<std::uint8_t>& inlier, const PosePrior* prior,
                           PoseWorkspace& workspace) {
  using namespace pose_detail;
  require(camera.focal > 0.0 && std::isfinite(camera.focal + camera.cx + camera.cy + camera.baseline),
          "solve_pose camera", "must be finite with a positive focal length", camera.focal);
  require(T_camera_world.matrix().allFinite(), "solve_pose T_camera_world", "must be finite",
          T_camera_world.translation().transpose());
  if (prior)
    require(prior->T_camera_world.matrix().allFinite() && prior->information.allFinite(), "solve_pose prior",
            "must be finite", prior->T_camera_world.translation().transpose());

  std::vector<PoseBlock>& blocks = workspace.blocks;
  prepare(camera, T_camera_world, observations, options, blocks);
  inlier.assign(observations.size(), 0);
  PoseResult result;
  result.T_camera_world = T_camera_world;
  const auto failed = [&](PoseStatus status) {
    result.status = status;
    result.inliers = result.stereo_inliers = 0;
    std::fill(inlier.begin(), inlier.end(), std::uint8_t{0});
    return result;
  };

  SE3d T = T_camera_world;
  Linearization at;
  const double scale2 = options.loss_scale * options.loss_scale;
  linearize<Loss>(camera, T, blocks, scale2, prior, at);
  if constexpr (Loss::kRedescending) {
    double wide = 2.0 * median_error(blocks, workspace.sorted);
    if (wide > scale2) {
      for (; wide > scale2; wide = std::min(0.25 * wide, 2.0 * median_error(blocks, workspace.sorted))) {
        linearize<Loss>(camera, T, blocks, wide, prior, at);
        descend<Loss>(camera, blocks, wide, prior, 4, 1.0, T, at, result.iterations);
      }
      linearize<Loss>(camera, T, blocks, scale2, prior, at);
    }
  }
  // A third of a standard deviation is near enough to tell inliers from outliers.
  descend<Loss>(camera, blocks, scale2, prior, options.max_iterations, 0.3, T, at, result.iterations);
  linearize<TruncatedLoss>(camera, T, blocks, 1.0, prior, at);
  const bool converged = descend<TruncatedLoss>(camera, blocks, 1.0, prior, options.max_iterations,
                                                options.tolerance, T, at, result.iterations);

  double chi2 = 0.0;
  for (std::size_t i = 0; i < observations.size(); ++i) {
    const PoseBlock& k = blocks[i / 4];
    const Eigen::Index l = static_cast<Eigen::Index>(i % 4);
    inlier[i] = k.chi2[l] <= k.gate[l];
    if (!inlier[i]) continue;
    ++result.inliers;
    result.stereo_inliers += !(observations[i].u_right < 0.0F);
    chi2 += k.chi2[l];
  }
  if (!prior && result.inliers < options.min_inliers) return failed(PoseStatus::too_few);

  // Of the information only what the gate leaves; the prior went through no gate.
  Linearization of_prior{Mat6<double>::Zero(), Vec6<double>::Zero(), 0.0};
  if (prior) add_prior(*prior, T, of_prior);
  const int mono_inliers = result.inliers - result.stereo_inliers;
  const double kept = (mono_inliers * gated_information(false, options.gate * kGateMono) +
                       result.stereo_inliers * gated_information(true, options.gate * kGateStereo)) /
                      std::max(1, result.inliers);
  ScaledCholesky cholesky;
  if (!cholesky.compute(kept * (at.H - of_prior.H) + of_prior.H, 0.0)) return failed(PoseStatus::degenerate);

  result.T_camera_world = T;
  result.covariance = cholesky.inverse();
  result.status = converged ? PoseStatus::converged : PoseStatus::not_converged;
  result.chi2 = chi2 + of_prior.cost;
  return result;
}

}  // namespace sweepkit

#undef SWEEPKIT_INLINE_ALL
