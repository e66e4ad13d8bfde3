// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sweepkit/geometry/so3.hpp"

namespace sweepkit::impl {

// A plane's disparity is slope . ray with ray = (x, y, 1). Here planes are such slopes [px].

/// Pixels that may show a floor: their rays' x and y, their disparities [px], and the cell of the image that
/// they lie in. Errors of pixels of one cell may go together.
struct FloorSamples {
  static constexpr int kCells = 32;

  std::vector<float> x, y, d;
  std::vector<std::uint8_t> cell;

  std::size_t size() const { return d.size(); }
  void clear() {
    x.clear();
    y.clear();
    d.clear();
    cell.clear();
  }
  void add(float ray_x, float ray_y, float disparity, std::uint8_t in_cell) {
    x.push_back(ray_x);
    y.push_back(ray_y);
    d.push_back(disparity);
    cell.push_back(in_cell);
  }
  float residual(std::size_t i, const Vec3<float>& slope) const {
    return d[i] - (slope.x() * x[i] + slope.y() * y[i] + slope.z());
  }
};

/// What is known of the planes before.
struct SlopePrior {
  Vec3<double> slope;
  Mat3<double> information;
};

struct SurfaceSearch {
  double sigma;     ///< standard deviation of a disparity [px]
  int hypotheses;   ///< planes tried for each surface
  int min_samples;  ///< on a surface
  int max_surfaces;
};

/// A plane fitted to samples.
struct Surface {
  Vec3<double> slope;  ///< of the samples and the prior together
  /// Of the samples alone, and its covariance as the scatter of the cells tells it. Only if `determined`.
  Vec3<double> seen;
  Mat3<double> covariance;
  bool determined = false;
  int inliers = 0;         ///< samples with a weight above zero
  double disparity = 0.0;  ///< their weighted mean [px]: how near the surface is seen
  double noise = 0.0;      ///< standard deviation of their residuals [px]
};

/// Finds planes one after another, each on what the ones before left over. Each begins as the best by MSAC
/// (Torr and Zisserman 2000) of planes through three samples, planes parallel to the prior through one and
/// the prior itself, and is refined by Tukey's biweight. Covariances are robust against errors that samples
/// of a cell share (Liang and Zeger 1986). Keeps its buffers; deterministic.
class SurfaceFinder {
 public:
  const std::vector<Surface>& find(const FloorSamples& samples, const SlopePrior& prior,
                                   const SurfaceSearch& search);

 private:
  Vec3<double> consensus(const SlopePrior& prior, const SurfaceSearch& search);
  void find_covariance(Surface& surface, const Mat3<double>& normal, const Vec3<double>& sum, double sigma);
  bool refine(Surface& surface, const SlopePrior& prior, const SurfaceSearch& search);

  FloorSamples left_;    // that no surface has taken yet
  FloorSamples scored_;  // some of them, which score hypotheses
  std::vector<float> sizes_;
  std::vector<Surface> surfaces_;
};

}  // namespace sweepkit::impl
