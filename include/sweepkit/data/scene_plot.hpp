// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "sweepkit/data/scene.hpp"

namespace sweepkit {

/// A line to draw into a plan.
struct PlanPath {
  std::vector<Vec2<double>> points;  ///< in the world
  std::string color = "#d62728";
  std::string name;  ///< for the legend; empty: none
};

/// A spot to mark in a plan.
struct PlanMark {
  Vec2<double> point;
  std::string text;
  std::string color = "#1f77b4";
};

/// The flat from above as one SVG, drawn in the frame of its file (walls upright on the page), with paths and
/// marks on top.
/// @param width of the drawing [px]
std::string scene_to_svg(const Scene& scene, const std::vector<PlanPath>& paths = {},
                         const std::vector<PlanMark>& marks = {}, double width = 900);

}  // namespace sweepkit
