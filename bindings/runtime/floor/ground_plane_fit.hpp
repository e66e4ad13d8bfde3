// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "sweepkit/geometry/so3.hpp"

namespace sweepkit::impl {

// A plane's disparity is slope . ray with ray = (x, y, 1). Here planes are such slopes [px].

/// Pixels that may show a floor: their rays' x and y, and their disparities [px].
struct FloorSamples {
  std::vector<float> x, y, d;

  std::size_t size() const { return d.size(); }
  void clear() {
    x.clear();
    y.clear();
    d.clear();
  }
  void add(float ray_x, float ray_y, float disparity) {
    x.push_back(ray_x);
    y.push_back(ray_y);
    d.push_back(disparity);
  }
  float residual(std::size_t i, const Vec3<float>& slope) const {
    return d[i] - (slope.x() * x[i] + slope.y() * y[i] + slope.z());
  }
};

/// A plane and what is known of it before.
struct SlopePrior {
  Vec3<double> slope;
  Mat3<double> information;
};

/// A plane fitted to samples.
struct SlopeFit {
  Vec3<double> slope;         ///< of the samples and the prior together
  Mat3<double> information;   ///< of the samples alone
  Vec3<double> weighted_sum;  ///< information * slope of the samples alone
  int inliers = 0;            ///< samples with a weight above zero
  double noise = 0.0;         ///< standard deviation of their residuals [px]
};

/// The plane through three samples that leaves the least sum of min((residual / gate)^2, 1) (MSAC), of
/// `hypotheses` random ones and `guess`. Deterministic.
Vec3<double> consensus_slope(const FloorSamples& samples, double gate, int hypotheses,
                             const Vec3<double>& guess);

/// How many samples lie within `gate` of a plane.
int count_near(const FloorSamples& samples, const Vec3<double>& slope, double gate);

/// Refines a plane by Tukey's biweight; nothing if fewer than three samples remain or they do not fix it.
/// @param sigma standard deviation of a disparity, of which the residuals may show more [px]
/// @param correlation how many samples share one error: so many count as one
std::optional<SlopeFit> refine_slope(const FloorSamples& samples, const Vec3<double>& start, double sigma,
                                     double correlation, const SlopePrior* prior,
                                     std::vector<float>& scratch);

}  // namespace sweepkit::impl
