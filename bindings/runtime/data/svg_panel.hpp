// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>

#include "sweepkit/geometry/so3.hpp"

namespace sweepkit {

inline constexpr std::size_t kMostPoints = 4000;  // of a line: more cannot be seen

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
        left_ - 54, top_ + height_ / 2, y_label);
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

/// The box around positions.
struct PositionBox {
  Vec3<double> low = Vec3<double>::Constant(std::numeric_limits<double>::infinity());
  Vec3<double> high = -low;

  void add(const Vec3<double>& p) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
};

/// The two coordinates to draw of a path: x and y, unless it lies in another plane (KITTI: x and z).
inline std::array<int, 2> drawn_axes(const PositionBox& path) {
  const Vec3<double> span = path.high - path.low;
  if (!(span.maxCoeff() > 0) || span.z() <= std::min(span.x(), span.y())) return {0, 1};
  return span.x() >= span.y() ? std::array{0, 2} : std::array{1, 2};
}

/// Axes of one scale for a square map that shows the whole box.
inline std::array<Axis, 2> square_axes(const PositionBox& box, const std::array<int, 2>& axes) {
  const Vec3<double> span = box.high - box.low;
  const double half = 0.55 * std::max({span[axes[0]], span[axes[1]], 1e-6});
  std::array<Axis, 2> result;
  for (int i = 0; i < 2; ++i) {
    const double middle = 0.5 * (box.low[axes[i]] + box.high[axes[i]]);
    result[i] = {middle - half, middle + half};
  }
  return result;
}

/// The head of a drawing, up to its background.
inline std::string svg_head(double width, double height) {
  return fmt::format(
      R"(<svg xmlns="http://www.w3.org/2000/svg" width="{0}" height="{1}" viewBox="0 0 {0} {1}" font-family="sans-serif" font-size="12" fill="#222">)"
      "\n"
      R"(<rect width="{0}" height="{1}" fill="#fafafa"/>)"
      "\n",
      width, height);
}

}  // namespace sweepkit
