// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "ground_plane_fit.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include "sweepkit/core/random.hpp"

namespace sweepkit::impl {

namespace {

constexpr double kTukey = 4.685;  // 95 % efficient for normal errors
constexpr double kGate = 3.0;     // of MSAC, and within which samples belong to a surface [sigma]
constexpr double kMadToSigma = 1.4826;
constexpr int kRounds = 8;
constexpr std::size_t kScored = 768;  // samples that score a hypothesis
constexpr std::size_t kLanes = 8;

// Sum of min((residual / gate)^2, 1), in lanes that a compiler can vectorise. The size is a multiple of them.
float score(const FloorSamples& samples, const Vec3<float>& slope, float inverse_gate) {
  std::array<float, kLanes> sums{};
  const float *x = samples.x.data(), *y = samples.y.data(), *d = samples.d.data();
  for (std::size_t i = 0; i < samples.size(); i += kLanes)
    for (std::size_t k = 0; k < kLanes; ++k) {
      const float r = (d[i + k] - slope.x() * x[i + k] - slope.y() * y[i + k] - slope.z()) * inverse_gate;
      sums[k] += std::min(r * r, 1.0f);
    }
  float sum = 0.0f;
  for (const float lane : sums) sum += lane;
  return sum;
}

}  // namespace

Vec3<double> SurfaceFinder::consensus(const SlopePrior& prior, const SurfaceSearch& search) {
  const std::size_t n = left_.size();
  scored_.clear();
  const std::size_t count = std::min(n, kScored);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t j = i * n / count;
    scored_.add(left_.x[j], left_.y[j], left_.d[j], left_.cell[j]);
  }
  while (scored_.size() % kLanes != 0) scored_.add(scored_.x[0], scored_.y[0], scored_.d[0], 0);

  const auto inverse_gate = static_cast<float>(1.0 / (kGate * search.sigma));
  Vec3<double> best = prior.slope;
  float best_score = score(scored_, best.cast<float>(), inverse_gate);
  const auto attempt = [&](const Vec3<double>& slope) {
    const float s = score(scored_, slope.cast<float>(), inverse_gate);
    if (s < best_score) {
      best_score = s;
      best = slope;
    }
  };
  Random random(1);
  std::array<std::size_t, 3> chosen;
  for (int k = 0; k < search.hypotheses; ++k) {
    random.sample(n, std::span<std::size_t>(chosen));
    Mat3<double> rays;
    Vec3<double> d;
    for (int i = 0; i < 3; ++i) {
      const std::size_t j = chosen[static_cast<std::size_t>(i)];
      rays.row(i) << left_.x[j], left_.y[j], 1.0;
      d[i] = left_.d[j];
    }
    attempt(prior.slope * (d[0] / prior.slope.dot(Vec3<double>(rays.row(0)))));
    if (std::abs(rays.determinant()) > 1e-4) attempt(rays.inverse() * d);
  }
  return best;
}

bool SurfaceFinder::refine(Surface& surface, const SlopePrior& prior, const SurfaceSearch& search) {
  // Not adapted to the residuals: a wider window would take two surfaces of a few millimetres' difference for
  // one.
  const auto limit = static_cast<float>(kTukey * search.sigma);
  const float inverse = 1.0f / (limit * limit);
  const double weight = 1.0 / (search.sigma * search.sigma);
  Mat3<double> normal;
  Vec3<double> sum;
  for (int round = 0; round < kRounds; ++round) {
    const Vec3<float> s = surface.slope.cast<float>();
    double xx = 0, xy = 0, yy = 0, x1 = 0, y1 = 0, w1 = 0, xd = 0, yd = 0, d1 = 0;
    sizes_.clear();
    for (std::size_t i = 0; i < left_.size(); ++i) {
      const float r = left_.residual(i, s);
      const float q = 1.0f - r * r * inverse;
      if (!(q > 0.0f)) continue;
      sizes_.push_back(std::abs(r));
      const double w = static_cast<double>(q) * q;
      const double x = left_.x[i], y = left_.y[i], d = left_.d[i], wx = w * x, wy = w * y;
      xx += wx * x;
      xy += wx * y;
      yy += wy * y;
      x1 += wx;
      y1 += wy;
      w1 += w;
      xd += wx * d;
      yd += wy * d;
      d1 += w * d;
    }
    surface.inliers = static_cast<int>(sizes_.size());
    if (surface.inliers < search.min_samples) return false;
    const auto middle = sizes_.begin() + static_cast<std::ptrdiff_t>(sizes_.size() / 2);
    std::nth_element(sizes_.begin(), middle, sizes_.end());
    surface.noise = kMadToSigma * *middle;

    surface.disparity = d1 / w1;
    normal << xx, xy, x1, xy, yy, y1, x1, y1, w1;
    normal *= weight;
    sum = weight * Vec3<double>(xd, yd, d1);
    const Eigen::LDLT<Mat3<double>> solver(normal + prior.information);
    const Vec3<double> next = solver.solve(sum + prior.information * prior.slope);
    if (!std::isfinite(next.sum())) return false;
    const double moved = (next - surface.slope).cwiseAbs().maxCoeff();
    surface.slope = next;
    if (moved < 1e-3) break;
  }
  find_covariance(surface, normal, sum, search.sigma);
  return true;
}

void SurfaceFinder::find_covariance(Surface& surface, const Mat3<double>& normal, const Vec3<double>& sum,
                                    double sigma) {
  const Eigen::LDLT<Mat3<double>> solver(normal);
  surface.determined = solver.rcond() > 1e-9;
  if (!surface.determined) return;
  surface.seen = solver.solve(sum);
  const Vec3<float> s = surface.seen.cast<float>();
  const auto limit = static_cast<float>(kTukey * sigma);
  const float inverse = 1.0f / (limit * limit);
  std::array<Vec3<double>, FloorSamples::kCells> pulls;
  pulls.fill(Vec3<double>::Zero());
  for (std::size_t i = 0; i < left_.size(); ++i) {
    const float r = left_.residual(i, s);
    const float q = 1.0f - r * r * inverse;
    if (!(q > 0.0f)) continue;
    pulls[left_.cell[i]] += static_cast<double>(q * q * r) * Vec3<double>(left_.x[i], left_.y[i], 1.0);
  }
  Mat3<double> scatter = Mat3<double>::Zero();
  for (const Vec3<double>& pull : pulls) scatter += pull * pull.transpose();
  scatter /= sigma * sigma * sigma * sigma;
  // At least what independent samples would leave.
  surface.covariance = solver.solve(Mat3<double>(solver.solve(scatter).transpose()));
  surface.covariance += solver.solve(Mat3<double>::Identity());
}

const std::vector<Surface>& SurfaceFinder::find(const FloorSamples& samples, const SlopePrior& prior,
                                                const SurfaceSearch& search) {
  surfaces_.clear();
  left_ = samples;
  while (static_cast<int>(left_.size()) >= std::max(search.min_samples, 3) &&
         static_cast<int>(surfaces_.size()) < search.max_surfaces) {
    Surface surface;
    surface.slope = consensus(prior, search);
    if (!refine(surface, prior, search)) break;
    surfaces_.push_back(surface);
    const Vec3<float> s = surface.slope.cast<float>();
    const auto gate = static_cast<float>(kGate * search.sigma);
    std::size_t kept = 0;
    for (std::size_t i = 0; i < left_.size(); ++i) {
      if (!(std::abs(left_.residual(i, s)) > gate)) continue;
      left_.x[kept] = left_.x[i];
      left_.y[kept] = left_.y[i];
      left_.d[kept] = left_.d[i];
      left_.cell[kept] = left_.cell[i];
      ++kept;
    }
    left_.x.resize(kept);
    left_.y.resize(kept);
    left_.d.resize(kept);
    left_.cell.resize(kept);
  }
  return surfaces_;
}

}  // namespace sweepkit::impl
