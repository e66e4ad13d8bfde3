// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <algorithm>
#include <numbers>

#include "svg_panel.hpp"
#include "sweepkit/data/evaluation.hpp"

namespace sweepkit {
namespace {

constexpr double kWidth = 1120.0, kHeight = 520.0;
constexpr const char* kTruthColor = "#888888";
constexpr const char* kEstimateColor = "#1766b0";
constexpr const char* kRotationColor = "#c2571a";

}  // namespace

std::string to_svg(const Evaluation& evaluation) {
  const auto& pairs = evaluation.pairs;
  PositionBox truth, both;
  for (const PosePair& pair : pairs) {
    truth.add(pair.truth.translation());
    both.add(pair.truth.translation());
    both.add(pair.estimate.translation());
  }
  const auto axes = drawn_axes(truth);
  const int a = axes[0], b = axes[1];
  const auto [x_axis, y_axis] = square_axes(both, axes);
  constexpr double kSide = 420.0;
  const Panel map(70, 50, kSide, kSide, x_axis, y_axis);

  constexpr double kDegrees = 180.0 / std::numbers::pi;
  const auto seconds = [&](std::size_t i) { return to_seconds(pairs[i].t - pairs.front().t); };
  const Axis time = Axis::around(0.0, std::max(seconds(pairs.size() - 1), 1e-3), 0.0);
  const Panel position(600, 50, 490, 180, time, {0.0, std::max(1.1 * evaluation.ape_m.max, 1e-6)});
  const Panel rotation(600, 290, 490, 180, time, {0.0, std::max(1.1 * evaluation.rotation_deg.max, 1e-6)});

  std::string svg = svg_head(kWidth, kHeight);
  svg +=
      fmt::format(R"(<text x="70" y="28" font-size="14">APE rmse {:.4f} m over {:.2f} m, alignment {}</text>)"
                  "\n",
                  evaluation.ape_m.rmse, evaluation.path_m, evaluation.alignment);
  const char* names = "xyz";
  map.frame(svg, fmt::format("{} [m]", names[a]), fmt::format("{} [m]", names[b]));
  svg += fmt::format(
      R"(<text x="80" y="68"><tspan fill="{}">truth</tspan>  <tspan fill="{}" dx="12">estimate</tspan></text>)"
      "\n",
      kTruthColor, kEstimateColor);
  const auto place = [&](const SE3d& T) { return std::pair(T.translation()[a], T.translation()[b]); };
  map.polyline(svg, pairs.size(), kTruthColor, 3.0, [&](std::size_t i) { return place(pairs[i].truth); });
  map.polyline(svg, pairs.size(), kEstimateColor, 1.5,
               [&](std::size_t i) { return place(pairs[i].estimate); });
  const auto [x0, y0] = place(pairs.front().truth);
  svg += fmt::format(R"(<circle cx="{:.1f}" cy="{:.1f}" r="4" fill="none" stroke="#222"/>)"
                     "\n",
                     map.u(x0), map.v(y0));
  position.frame(svg, "time [s]", "position error [m]");
  position.polyline(svg, pairs.size(), kEstimateColor, 1.5,
                    [&](std::size_t i) { return std::pair(seconds(i), pairs[i].position_error); });
  rotation.frame(svg, "time [s]", "rotation error [deg]");
  rotation.polyline(svg, pairs.size(), kRotationColor, 1.5,
                    [&](std::size_t i) { return std::pair(seconds(i), kDegrees * pairs[i].rotation_error); });
  return svg + "</svg>\n";
}

}  // namespace sweepkit
