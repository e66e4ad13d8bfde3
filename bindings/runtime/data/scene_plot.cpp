// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/scene_plot.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "scene_solid.hpp"
#include "svg_panel.hpp"
#include "sweepkit/core/error.hpp"

namespace sweepkit {
namespace {

using Vec2d = Vec2<double>;

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '<')
      out += "&lt;";
    else if (c == '>')
      out += "&gt;";
    else if (c == '&')
      out += "&amp;";
    else if (c == '"')
      out += "&quot;";
    else
      out += c;
  }
  return out;
}

const char* fill_of(SceneLabel label) {
  switch (label) {
    case SceneLabel::carpet:
      return "#e9dcc9";
    case SceneLabel::furniture:
      return "#c9c2b8";
    case SceneLabel::shuttlecock:
      return "#1f9ed1";
    case SceneLabel::mahjong:
      return "#2ca02c";
    case SceneLabel::pet_waste:
      return "#8c564b";
    case SceneLabel::cable:
      return "#444";
    default:
      return "#9467bd";
  }
}

}  // namespace

std::string scene_to_svg(const Scene& scene, const std::vector<PlanPath>& paths,
                         const std::vector<PlanMark>& marks, double width) {
  require(width >= 100 && width <= 20000, "scene_to_svg width", "must lie in 100 .. 20000 px", width);
  Vec2d low = Vec2d::Constant(std::numeric_limits<double>::infinity()), high = -low;
  for (const Room& room : scene.rooms)
    for (const Vec2d& corner : room.corners) {
      low = low.cwiseMin(scene.from_world(corner));
      high = high.cwiseMax(scene.from_world(corner));
    }
  require(!scene.rooms.empty(), "scene_to_svg scene", "must have rooms", scene.rooms.size());
  constexpr double kMargin = 0.35;  // [m]
  low.array() -= kMargin;
  high.array() += kMargin;
  const double scale = width / (high.x() - low.x());
  const double legend =
      24 + 18.0 * static_cast<double>(std::count_if(paths.begin(), paths.end(),
                                                    [](const PlanPath& p) { return !p.name.empty(); }));
  const double height = (high.y() - low.y()) * scale;
  const auto at = [&](const Vec2d& p_world) {
    const Vec2d p = scene.from_world(p_world);
    return Vec2d((p.x() - low.x()) * scale, height - (p.y() - low.y()) * scale);
  };
  const auto points = [&](const std::vector<Vec2d>& corners) {
    std::string text;
    for (const Vec2d& c : corners) {
      const Vec2d p = at(c);
      text += fmt::format("{:.1f},{:.1f} ", p.x(), p.y());
    }
    return text;
  };
  std::string svg = svg_head(width, height + legend);
  for (const Room& room : scene.rooms)
    svg += fmt::format("<polygon points=\"{}\" fill=\"#fff\" stroke=\"#333\" stroke-width=\"3\"/>\n",
                       points(room.corners));
  for (const Door& door : scene.doors) {
    const DoorPassage p = door_passage(scene, door);
    const Vec2d x(std::cos(p.yaw), std::sin(p.yaw)), y(-x.y(), x.x());
    // A little longer than the wall is thick, to cut through the lines of both rooms.
    const double d = p.depth / 2 + 2.5 / scale, w = p.width / 2;
    svg += fmt::format("<polygon points=\"{}\" fill=\"{}\"/>\n",
                       points({p.centre - d * x - w * y, p.centre + d * x - w * y, p.centre + d * x + w * y,
                               p.centre - d * x + w * y}),
                       door.sill > 0 ? "#d8b98a" : "#fff");
  }
  for (const Window& window : scene.windows)
    if (const Room* room = scene.find_room(window.room)) {
      const std::size_t n = room->corners.size(), i = static_cast<std::size_t>(window.wall) % n;
      const Vec2d a = room->corners[i], d = (room->corners[(i + 1) % n] - a).normalized();
      const Vec2d p = at(a + d * (window.along - window.width / 2)),
                  q = at(a + d * (window.along + window.width / 2));
      svg += fmt::format(
          "<line x1=\"{:.1f}\" y1=\"{:.1f}\" x2=\"{:.1f}\" y2=\"{:.1f}\" stroke=\"#6baed6\" "
          "stroke-width=\"5\"/>\n",
          p.x(), p.y(), q.x(), q.y());
    }
  // Carpets below all else.
  for (const bool carpets : {true, false})
    for (std::size_t i = 0; i < scene.objects.size(); ++i) {
      const SceneObject& object = scene.objects[i];
      if ((object.kind == ObjectKind::carpet) != carpets) continue;
      std::string shapes;
      SceneLabel label = SceneLabel::furniture;
      for (const Solid& solid : object_solids(object, static_cast<int>(i))) {
        const Footprint f = footprint(solid);
        label = solid.label;
        shapes += fmt::format("<polygon points=\"{}\"/>", points(f.corners()));
      }
      svg += fmt::format(
          "<g fill=\"{}\" fill-opacity=\"0.75\" stroke=\"#777\" "
          "stroke-width=\"0.6\">{}<title>{}</title></g>\n",
          fill_of(label), shapes,
          escaped(object.name.empty() ? std::string(to_string(object.kind)) : object.name));
    }
  for (const Room& room : scene.rooms) {
    Vec2d middle = Vec2d::Zero();
    for (const Vec2d& c : room.corners) middle += at(c) / static_cast<double>(room.corners.size());
    svg += fmt::format("<text x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"middle\" fill=\"#999\">{}</text>\n",
                       middle.x(), middle.y(), escaped(room.name));
  }
  double line = height + 16;
  for (const PlanPath& path : paths) {
    std::string text;
    const std::size_t step = (path.points.size() + kMostPoints - 1) / kMostPoints;
    for (std::size_t i = 0; i < path.points.size(); i += std::max<std::size_t>(step, 1)) {
      const Vec2d p = at(path.points[i]);
      text += fmt::format("{:.1f},{:.1f} ", p.x(), p.y());
    }
    svg += fmt::format(
        "<polyline fill=\"none\" stroke=\"{}\" stroke-width=\"1.8\" stroke-linejoin=\"round\" "
        "points=\"{}\"/>\n",
        escaped(path.color), text);
    if (path.name.empty()) continue;
    svg += fmt::format(
        "<line x1=\"10\" y1=\"{0:.1f}\" x2=\"40\" y2=\"{0:.1f}\" stroke=\"{1}\" stroke-width=\"2\"/><text "
        "x=\"48\" y=\"{2:.1f}\">{3}</text>\n",
        line - 4, escaped(path.color), line, escaped(path.name));
    line += 18;
  }
  for (const PlanMark& mark : marks) {
    const Vec2d p = at(mark.point);
    svg += fmt::format(
        "<circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"4\" fill=\"{}\"/><text x=\"{:.1f}\" "
        "y=\"{:.1f}\">{}</text>\n",
        p.x(), p.y(), escaped(mark.color), p.x() + 6, p.y() - 5, escaped(mark.text));
  }
  // A metre.
  svg += fmt::format(
      "<line x1=\"{0:.1f}\" y1=\"{2:.1f}\" x2=\"{1:.1f}\" y2=\"{2:.1f}\" stroke=\"#222\" "
      "stroke-width=\"2\"/><text x=\"{3:.1f}\" y=\"{4:.1f}\" text-anchor=\"middle\">1 m</text>\n",
      width - 20 - scale, width - 20.0, height + 6, width - 20 - scale / 2, height + 20);
  return svg + "</svg>\n";
}

}  // namespace sweepkit
