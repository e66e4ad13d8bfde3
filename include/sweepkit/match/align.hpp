// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <optional>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/view.hpp"

namespace sweepkit {

struct AlignOptions {
  int iterations = 10;
  double max_shift = 3.0;
  double min_correlation = 0.8;
  double image_noise = 2.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(iterations, "iterations", "", range(1, 50), "Gauss-Newton steps at most");
    v(max_shift, "max_shift", "px", range(0.1, 20.0),
      "patches that move farther from the prediction do not count");
    v(min_correlation, "min_correlation", "", range(-1.0, 1.0), "patches that correlate less do not count");
    v(image_noise, "image_noise", "", range(0.0, 50.0),
      "least standard deviation of a pixel's grey value to expect");
  }
};

/// Where a patch was found.
struct Alignment {
  Eigen::Vector2f position;    ///< in the current image [px]
  Eigen::Matrix2f covariance;  ///< of the position, from residual and texture [px^2]
  float correlation = 0;       ///< zero-mean normalised, of the patches there
  float residual = 0;          ///< root mean square after gain and offset [grey values]
  int iterations = 0;
};

/// Finds the patch about a point of a reference image in the current one to a part of a pixel:
/// two-dimensional inverse-compositional Lucas-Kanade (Baker and Matthews 2004) with gain and offset on 8x8
/// px. The gradient comes from the reference, read at whole pixels; the current image is read by separable
/// four-point Lagrange interpolation: so the result is not drawn to whole or half pixels.
class PatchAligner {
 public:
  explicit PatchAligner(const AlignOptions& options = {}) : options_(options) { check_options(options_); }
  const AlignOptions& options() const { return options_; }

  /// @param reference, current images, usually levels of pyramids; GrayImage or with 3 readable bytes at the
  /// end
  /// @param point in the reference image [px of it]
  /// @param A_reference_current takes small steps in the current image to steps in the reference image
  /// @param predicted position in the current image, right to about 2 px
  /// Nothing is found near an image's edge, without texture in both directions, or where the patches differ.
  std::optional<Alignment> align(const GrayView& reference, const Eigen::Vector2f& point,
                                 const Eigen::Matrix2f& A_reference_current, const GrayView& current,
                                 const Eigen::Vector2f& predicted) const;

 private:
  AlignOptions options_;
};

}  // namespace sweepkit
