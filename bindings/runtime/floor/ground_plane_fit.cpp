// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "ground_plane_fit.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

#include "sweepkit/core/random.hpp"

namespace sweepkit::impl {

namespace {

constexpr double kTukey = 4.685;  // 95 % efficient for normal errors
constexpr double kMadToSigma = 1.4826;
constexpr int kRounds = 8;
constexpr std::size_t kScored = 768;  // samples that score a hypothesis
constexpr int kLanes = 8;

// Sum of min((residual / gate)^2, 1) over every stride-th sample, in lanes that a compiler can vectorise.
float score(const FloorSamples& samples, const Vec3<float>& slope, float inverse_gate) {
  std::array<float, kLanes> sums{};
  const std::size_t n = samples.size() / kLanes * kLanes;
  const float *x = samples.x.data(), *y = samples.y.data(), *d = samples.d.data();
  for (std::size_t i = 0; i < n; i += kLanes)
    for (int k = 0; k < kLanes; ++k) {
      const float r = (d[i + k] - slope.x() * x[i + k] - slope.y() * y[i + k] - slope.z()) * inverse_gate;
      sums[k] += std::min(r * r, 1.0f);
    }
  float sum = 0.0f;
  for (const float lane : sums) sum += lane;
  return sum;
}

}  // namespace

Vec3<double> consensus_slope(const FloorSamples& samples, double gate, int hypotheses,
                             const Vec3<double>& guess) {
  const std::size_t n = samples.size();
  if (n < 3) return guess;
  FloorSamples scored;
  const std::size_t count = std::min(n, kScored);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t j = i * n / count;
    scored.add(samples.x[j], samples.y[j], samples.d[j]);
  }
  // Whole lanes: what is missing repeats the first.
  while (scored.size() % kLanes != 0) scored.add(scored.x[0], scored.y[0], scored.d[0]);

  const auto inverse_gate = static_cast<float>(1.0 / gate);
  Vec3<double> best = guess;
  float best_score = score(scored, guess.cast<float>(), inverse_gate);
  Random random(1);
  std::array<std::size_t, 3> chosen;
  for (int k = 0; k < hypotheses; ++k) {
    random.sample(n, std::span<std::size_t>(chosen));
    Mat3<double> rays;
    Vec3<double> d;
    for (int i = 0; i < 3; ++i) {
      rays.row(i) << samples.x[chosen[i]], samples.y[chosen[i]], 1.0;
      d[i] = samples.d[chosen[i]];
    }
    const double area = rays.determinant();
    if (!(std::abs(area) > 1e-4)) continue;
    const Vec3<double> slope = rays.inverse() * d;
    const float s = score(scored, slope.cast<float>(), inverse_gate);
    if (s < best_score) {
      best_score = s;
      best = slope;
    }
  }
  return best;
}

int count_near(const FloorSamples& samples, const Vec3<double>& slope, double gate) {
  const Vec3<float> s = slope.cast<float>();
  const auto limit = static_cast<float>(gate);
  int count = 0;
  for (std::size_t i = 0; i < samples.size(); ++i) count += std::abs(samples.residual(i, s)) < limit;
  return count;
}

std::optional<SlopeFit> refine_slope(const FloorSamples& samples, const Vec3<double>& start, double sigma,
                                     double correlation, const SlopePrior* prior,
                                     std::vector<float>& scratch) {
  SlopeFit fit;
  fit.slope = start;
  double spread = sigma;
  for (int round = 0; round < kRounds; ++round) {
    const Vec3<float> s = fit.slope.cast<float>();
    const auto limit = static_cast<float>(kTukey * spread);
    const float inverse = 1.0f / (limit * limit);
    double xx = 0, xy = 0, yy = 0, x1 = 0, y1 = 0, w1 = 0, xd = 0, yd = 0, d1 = 0;
    scratch.clear();
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const float r = samples.residual(i, s);
      const float q = 1.0f - r * r * inverse;
      if (!(q > 0.0f)) continue;
      scratch.push_back(std::abs(r));
      const double w = static_cast<double>(q) * q;
      const double x = samples.x[i], y = samples.y[i], wx = w * x, wy = w * y;
      xx += wx * x;
      xy += wx * y;
      yy += wy * y;
      x1 += wx;
      y1 += wy;
      w1 += w;
      xd += wx * samples.d[i];
      yd += wy * samples.d[i];
      d1 += w * samples.d[i];
    }
    fit.inliers = static_cast<int>(scratch.size());
    if (fit.inliers < 3) return std::nullopt;
    const auto middle = scratch.begin() + static_cast<std::ptrdiff_t>(scratch.size() / 2);
    std::nth_element(scratch.begin(), middle, scratch.end());
    fit.noise = kMadToSigma * *middle;

    const double weight = 1.0 / (correlation * spread * spread);
    fit.information << xx, xy, x1, xy, yy, y1, x1, y1, w1;
    fit.information *= weight;
    fit.weighted_sum = weight * Vec3<double>(xd, yd, d1);
    Mat3<double> normal = fit.information;
    Vec3<double> sum = fit.weighted_sum;
    if (prior) {
      normal += prior->information;
      sum += prior->information * prior->slope;
    }
    const Eigen::LDLT<Mat3<double>> solver(normal);
    if (!(solver.rcond() > 1e-12)) return std::nullopt;
    const Vec3<double> next = solver.solve(sum);
    const double moved = (next - fit.slope).cwiseAbs().maxCoeff();
    fit.slope = next;
    spread = std::clamp(fit.noise, sigma, 2.0 * sigma);
    if (moved < 1e-3) break;
  }
  return fit;
}

}  // namespace sweepkit::impl
