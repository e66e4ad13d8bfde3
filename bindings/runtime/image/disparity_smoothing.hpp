// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "sweepkit/image/dense_disparity.hpp"

namespace sweepkit {

/// Weighted least squares: the disparities off the ramp that stay near the matched ones and change little
/// between neighbours that look alike, weighted by exp(-difference / sigma). Solved row by row and column by
/// column in turn: Min, Choi, Lu, Ham, Sohn, Do, Fast Global Image Smoothing Based on Weighted Least Squares,
/// IEEE Transactions on Image Processing 23 (2014), with three rounds. What was not matched has no weight.
class DisparitySmoother {
 public:
  /// @param disparity in sixteenths, 0 where unknown; smoothed in place
  void smooth(GrayView guide, const DisparitySmoothing& options, const DisparityRamp& ramp,
              View2d<std::int16_t> disparity);

 private:
  void rows(GrayView guide, float lambda);
  void columns(GrayView guide, float lambda);

  float weight_[256] = {};                   // of neighbours that differ by so much
  std::vector<float> sum_, known_, upward_;  // weighted disparities, weights, and the solver's own
};

}  // namespace sweepkit
