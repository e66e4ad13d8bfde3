// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <filesystem>
#include <numbers>
#include <string>
#include <vector>

#include "sweepkit/core/option_text.hpp"
#include "sweepkit/floor/obstacle_detector.hpp"

/// The parts of real_floor.
namespace real_floor {

using namespace sweepkit;

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kRobotHeight = 0.08;  // of the cameras for which the defaults were made [m]

struct Settings {
  std::vector<std::string> options;
  std::filesystem::path pictures;  // empty: none
  bool poses = false;

  ObstacleDetectorOptions detector(const std::vector<std::string>& own) const {
    ObstacleDetectorOptions made;
    for (const std::string& setting : own) set_option(list_options(made), setting);
    for (const std::string& setting : options) set_option(list_options(made), setting);
    return made;
  }
};

inline double median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// The mask over the image: floor green, obstacle red, hole blue; yellow boxes: obstacles; white: holes.
void draw(const Settings& settings, const std::string& name, const ObstacleFrame& frame);

/// The pairs with true disparities in a folder.
void middlebury(const std::filesystem::path& folder, const Settings& settings);

}  // namespace real_floor
