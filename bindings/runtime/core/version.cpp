// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/core/version.hpp"

#include <ceres/version.h>
#include <fmt/format.h>

#include <Eigen/Core>
#include <opencv2/core/version.hpp>

namespace sweepkit {

std::string version() { return SWEEPKIT_VERSION; }

std::vector<std::pair<std::string, std::string>> library_versions() {
  return {{"eigen", fmt::format("{}.{}.{}", EIGEN_WORLD_VERSION, EIGEN_MAJOR_VERSION, EIGEN_MINOR_VERSION)},
          {"opencv", CV_VERSION},
          {"ceres", CERES_VERSION_STRING},
          {"compiler", __VERSION__}};
}

}  // namespace sweepkit
