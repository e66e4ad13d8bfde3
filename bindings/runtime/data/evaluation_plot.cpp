// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "sweepkit/data/evaluation.hpp"

namespace sweepkit {
namespace {

constexpr double kWidth = 1120.0, kHeight = 520.0;
constexpr const char* kTruthColor = "#888888";
constexpr const char* kEstimateColor = "#1766b0";
constexpr const char* kRotationColor = "#c2571a";
constexpr std::size_t kMostPoints = 4000;  // of a line: more cannot be seen

/// A span of values with room around it.
struct Axis {
  double low = 0.0, high = 1.0;

  static Axis around(double low, double high, double room) {
    const double span = std::max(high - low, 1e-6);
    return {low - room * span, high + room * span};
  }
  double span() const { return high - low; }
  /// A round distance between ticks so that there are about `count`.
  double step(double count) const {
    const double rough = span() / count;
    const double power = std::pow(10.0, std::floor(std::log10(rough)));
    for (const double factor : {1.0, 2.0, 5.0})
      if (factor * power >= rough) return factor * power;
    return 10.0 * power;
  }
};

/// A frame with axes on the drawing; y grows upwards.
class Panel {
 public:
  Panel(double left, double top, double width, double height, Axis x, Axis y)
      : left_(left), top_(top), width_(width), height_(height), x_(x), y_(y) {}

  double u(double x) const { return left_ + (x - x_.low) / x_.span() * width_; }
  double v(double y) const { return top_ + height_ - (y - y_.low) / y_.span() * height_; }

  void frame(std::string& svg, const std::string& x_label, const std::string& y_label) const {
    svg += fmt::format(
        R"(<rect x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}" fill="#fff" stroke="#444"/>)"
        "\n",
        left_, top_, width_, height_);
    const double x_step = x_.step(6), y_step = y_.step(5);
    for (double x = std::ceil(x_.low / x_step) * x_step; x <= x_.high; x += x_step) {
      line(svg, u(x), top_, u(x), top_ + height_);
      text(svg, u(x), top_ + height_ + 16, "middle", label(x, x_step));
    }
    for (double y = std::ceil(y_.low / y_step) * y_step; y <= y_.high; y += y_step) {
      line(svg, left_, v(y), left_ + width_, v(y));
      text(svg, left_ - 6, v(y) + 4, "end", label(y, y_step));
    }
    text(svg, left_ + width_ / 2, top_ + height_ + 34, "middle", x_label);
    svg += fmt::format(
        R"svg(<text transform="translate({:.1f} {:.1f}) rotate(-90)" text-anchor="middle">{}</text>)svg"
        "\n",
        left_ - 46, top_ + height_ / 2, y_label);
  }

  template <class Points>
  void polyline(std::string& svg, std::size_t count, const char* color, double stroke, Points&& point) const {
    svg +=
        fmt::format(R"(<polyline fill="none" stroke="{}" stroke-width="{}" stroke-linejoin="round" points=")",
                    color, stroke);
    const std::size_t step = (count + kMostPoints - 1) / kMostPoints;
    for (std::size_t i = 0; i < count; i += step) {
      const auto [x, y] = point(i);
      svg += fmt::format("{:.1f},{:.1f} ", u(x), v(y));
    }
    svg += "\"/>\n";
  }

 private:
  static std::string label(double value, double step) {
    const int decimals = std::max(0, static_cast<int>(std::ceil(-std::log10(step) - 1e-9)));
    return fmt::format("{:.{}f}", std::abs(value) < 1e-9 * step ? 0.0 : value, decimals);
  }
  static void line(std::string& svg, double x1, double y1, double x2, double y2) {
    svg += fmt::format(R"(<line x1="{:.1f}" y1="{:.1f}" x2="{:.1f}" y2="{:.1f}" stroke="#e4e4e4"/>)"
                       "\n",
                       x1, y1, x2, y2);
  }
  static void text(std::string& svg, double x, double y, const char* anchor, const std::string& content) {
    svg += fmt::format(R"(<text x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>)"
                       "\n",
                       x, y, anchor, content);
  }

  double left_, top_, width_, height_;
  Axis x_, y_;
};

/// The two coordinates to draw: x and y, unless the path lies in another plane (KITTI: x and z).
std::array<int, 2> drawn_axes(const std::vector<PosePair>& pairs) {
  Vec3<double> low = pairs.front().truth.translation(), high = low;
  for (const PosePair& pair : pairs) {
    low = low.cwiseMin(pair.truth.translation());
    high = high.cwiseMax(pair.truth.translation());
  }
  const Vec3<double> span = high - low;
  if (span.z() <= std::min(span.x(), span.y()) || span.maxCoeff() <= 0) return {0, 1};
  return span.x() >= span.y() ? std::array{0, 2} : std::array{1, 2};
}

}  // namespace

std::string to_svg(const Evaluation& evaluation) {
  const auto& pairs = evaluation.pairs;
  const auto [a, b] = drawn_axes(pairs);
  std::array<double, 2> low{1e300, 1e300}, high{-1e300, -1e300};
  for (const PosePair& pair : pairs)
    for (const SE3d* T : {&pair.truth, &pair.estimate}) {
      const std::array<double, 2> p{T->translation()[a], T->translation()[b]};
      for (int i = 0; i < 2; ++i) {
        low[i] = std::min(low[i], p[i]);
        high[i] = std::max(high[i], p[i]);
      }
    }
  // Both axes of the map have one scale.
  constexpr double kSide = 420.0;
  const double half = 0.55 * std::max({high[0] - low[0], high[1] - low[1], 1e-6});
  const auto centered = [&](int i) {
    const double middle = 0.5 * (low[i] + high[i]);
    return Axis{middle - half, middle + half};
  };
  const Panel map(70, 50, kSide, kSide, centered(0), centered(1));

  constexpr double kDegrees = 180.0 / std::numbers::pi;
  const auto seconds = [&](std::size_t i) { return to_seconds(pairs[i].t - pairs.front().t); };
  const Axis time = Axis::around(0.0, std::max(seconds(pairs.size() - 1), 1e-3), 0.0);
  const Panel position(600, 50, 490, 180, time, {0.0, std::max(1.1 * evaluation.ape_m.max, 1e-6)});
  const Panel rotation(600, 290, 490, 180, time, {0.0, std::max(1.1 * evaluation.rotation_deg.max, 1e-6)});

  std::string svg = fmt::format(
      R"(<svg xmlns="http://www.w3.org/2000/svg" width="{0}" height="{1}" viewBox="0 0 {0} {1}" font-family="sans-serif" font-size="12" fill="#222">)"
      "\n"
      R"(<rect width="{0}" height="{1}" fill="#fafafa"/>)"
      "\n",
      kWidth, kHeight);
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
