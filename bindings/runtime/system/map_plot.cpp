// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "../data/svg_panel.hpp"
#include "sweepkit/system/results.hpp"

namespace sweepkit {
namespace {

constexpr double kWidth = 800.0, kHeight = 800.0, kSide = 700.0;
constexpr const char* kPointColor = "#8a8a8a";
constexpr const char* kPathColor = "#1766b0";
constexpr const char* kKeyframeColor = "#c2571a";
constexpr std::size_t kMostMapPoints = 20000;
constexpr int kFewObservations = 3;  // points seen by fewer keyframes are not drawn
constexpr double kOutlyingShare = 0.03;
// Keyframes of two visits to a place, and how many points tie them at least.
constexpr TimeNs kOtherVisit = 20 * kNsPerSecond;
constexpr int kTiePoints = 20;
constexpr const char* kTieColor = "#3a9b4a";
constexpr const char* kBlindColor = "#c2571a";

// The box that leaves out the outermost points of each direction, lest a far one shrinks the rest to nothing.
PositionBox inner_box(const std::vector<Vec3<double>>& points) {
  PositionBox box;
  if (points.empty()) return box;
  std::vector<double> values(points.size());
  const auto quantile = [&](double share) {
    const auto rank = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
    std::nth_element(values.begin(), values.begin() + rank, values.end());
    return values[static_cast<std::size_t>(rank)];
  };
  for (int k = 0; k < 3; ++k) {
    for (std::size_t i = 0; i < points.size(); ++i) values[i] = points[i][k];
    box.low[k] = quantile(kOutlyingShare);
    box.high[k] = quantile(1 - kOutlyingShare);
  }
  return box;
}

// The two coordinates that lie flat, right and forward as seen from above: the first turned towards the
// second goes counter-clockwise about the upward direction, which is the coordinate axis nearest to what the
// cameras take for it.
std::array<int, 2> axes_from_above(const SE3d& T_body_camera, std::span<const StampedPose> path) {
  Vec3<double> up = Vec3<double>::Zero();
  const Vec3<double> up_body = T_body_camera.rotation() * Vec3<double>(0, -1, 0);
  for (const StampedPose& pose : path) up += pose.T_world_body.rotation() * up_body;
  int axis = 2;
  if (!path.empty()) up.cwiseAbs().maxCoeff(&axis);
  std::array<int, 2> axes{(axis + 1) % 3, (axis + 2) % 3};
  if (up[axis] < 0) std::swap(axes[0], axes[1]);
  return axes;
}

// What ties keyframes beyond their order in time: points seen at another visit, and odometry where nothing
// was seen.
template <class Place>
void draw_graph(std::string& svg, const Map& map, const Place& place) {
  std::string ties, blind;
  const auto line = [&](std::string& path, const Keyframe& from, const Keyframe& to) {
    const auto [u0, v0] = place(from);
    const auto [u1, v1] = place(to);
    path += fmt::format("M{:.1f} {:.1f}L{:.1f} {:.1f}", u0, v0, u1, v1);
  };
  for (std::uint32_t k = 0; k < map.keyframe_id_end(); ++k) {
    const Keyframe* keyframe = map.find(KeyframeId{k});
    if (!keyframe) continue;
    for (const Covisible& c : keyframe->covisible) {
      const Keyframe& other = map.keyframe(c.keyframe);
      if (other.t < keyframe->t - kOtherVisit && c.points >= kTiePoints) line(ties, other, *keyframe);
    }
    if (keyframe->odometry && (keyframe->blind() || map.keyframe(keyframe->odometry->from).blind()))
      line(blind, map.keyframe(keyframe->odometry->from), *keyframe);
  }
  svg += fmt::format(R"(<path stroke="{}" stroke-width="0.6" stroke-opacity="0.5" fill="none" d="{}"/>)"
                     "\n",
                     kTieColor, ties);
  svg += fmt::format(R"(<path stroke="{}" stroke-width="1.2" stroke-dasharray="4 3" fill="none" d="{}"/>)"
                     "\n",
                     kBlindColor, blind);
}

}  // namespace

std::string map_svg(const Map& map, const SE3d& T_body_camera, std::span<const StampedPose> path) {
  std::vector<Vec3<double>> points;
  for (std::uint32_t i = 0; i < map.point_id_end(); ++i)
    if (const MapPoint* point = map.find(PointId{i}); point && point->observations.size() >= kFewObservations)
      points.push_back(point->p_world);
  PositionBox path_box;
  for (const StampedPose& pose : path) path_box.add(pose.T_world_body.translation());
  if (path.empty()) path_box.add(Vec3<double>::Zero());
  const auto axes = axes_from_above(T_body_camera, path);
  const int a = axes[0], b = axes[1];
  PositionBox box = inner_box(points);
  box.add(path_box.low);
  box.add(path_box.high);
  const auto [x_axis, y_axis] = square_axes(box, axes);
  const Panel panel(70, 40, kSide, kSide, x_axis, y_axis);

  std::string svg = svg_head(kWidth, kHeight);
  svg += fmt::format(
      R"(<text x="70" y="26" font-size="14">{} points, <tspan fill="{}">path of {:.2f} m</tspan>, <tspan fill="{}">{} keyframes</tspan> (dashed: blind), <tspan fill="{}">ties between visits</tspan></text>)"
      "\n",
      map.point_count(), kPathColor, path_length(path), kKeyframeColor, map.keyframe_count(), kTieColor);
  const char* names = "xyz";
  panel.frame(svg, fmt::format("{} [m]", names[a]), fmt::format("{} [m]", names[b]));

  svg += fmt::format(R"(<path stroke="{}" stroke-width="1.6" stroke-linecap="round" d=")", kPointColor);
  const std::size_t step = points.size() / kMostMapPoints + 1;
  for (std::size_t i = 0; i < points.size(); i += step) {
    const double x = points[i][a], y = points[i][b];
    if (x < x_axis.low || x > x_axis.high || y < y_axis.low || y > y_axis.high) continue;
    svg += fmt::format("M{:.1f} {:.1f}h0", panel.u(x), panel.v(y));
  }
  svg += "\"/>\n";
  panel.polyline(svg, path.size(), kPathColor, 2.0, [&](std::size_t i) {
    const Vec3<double>& p = path[i].T_world_body.translation();
    return std::pair(p[a], p[b]);
  });
  draw_graph(svg, map, [&](const Keyframe& keyframe) {
    const Vec3<double> p = (T_body_camera * keyframe.T_camera_world).inverse().translation();
    return std::pair(panel.u(p[a]), panel.v(p[b]));
  });
  for (std::uint32_t k = 0; k < map.keyframe_id_end(); ++k) {
    const Keyframe* keyframe = map.find(KeyframeId{k});
    if (!keyframe) continue;
    const SE3d T_world_camera = keyframe->T_camera_world.inverse();
    const Vec3<double> p = (T_world_camera * T_body_camera.inverse()).translation();
    // A stroke in the direction of view, of 10 px if it lies flat.
    const Vec3<double> ahead =
        p + T_world_camera.rotation() * Vec3<double>::UnitZ() * (x_axis.span() * 10 / kSide);
    svg += fmt::format(
        R"(<circle cx="{:.1f}" cy="{:.1f}" r="2.2" fill="{}"/><path stroke="{}" d="M{:.1f} {:.1f}L{:.1f} {:.1f}"/>)"
        "\n",
        panel.u(p[a]), panel.v(p[b]), kKeyframeColor, kKeyframeColor, panel.u(p[a]), panel.v(p[b]),
        panel.u(ahead[a]), panel.v(ahead[b]));
  }
  return svg + "</svg>\n";
}

}  // namespace sweepkit
