// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <cstdio>

#include "sweepkit/geometry/camera.hpp"
#include "sweepkit/geometry/se3.hpp"

int main() {
  using namespace sweepkit;
  const SE3d T_a_b = SE3d::exp((Eigen::Matrix<double, 6, 1>() << 1.0, 2.0, 3.0, 0.1, 0.2, 0.3).finished());
  const double residual = (T_a_b * T_a_b.inverse()).log().norm();
  std::printf("headers: a motion times its inverse is the identity to %.1e\n", residual);
  return residual < 1e-12 ? 0 : 1;
}
