// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>

namespace sweepkit {

/// From 0 at x <= 0 to 1 at x >= 1 with two continuous derivatives; steepest in the middle, at 1.875.
inline double smooth_step(double x) {
  x = std::clamp(x, 0.0, 1.0);
  return x * x * x * (10.0 + x * (6.0 * x - 15.0));
}

/// Its derivative.
inline double smooth_step_slope(double x) {
  return x <= 0.0 || x >= 1.0 ? 0.0 : 30.0 * x * x * (1.0 - x) * (1.0 - x);
}

/// Its integral from 0: x - 1/2 beyond 1.
inline double smooth_step_integral(double x) {
  if (x <= 0.0) return 0.0;
  if (x >= 1.0) return x - 0.5;
  return x * x * x * x * (2.5 + x * (x - 3.0));
}

inline constexpr double kSmoothStepSteepest = 1.875;

}  // namespace sweepkit
