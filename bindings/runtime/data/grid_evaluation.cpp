// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/grid_evaluation.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

#include "sweepkit/core/error.hpp"
#include "sweepkit/floor/impl/cell_walk.hpp"
#include "yaml_node.hpp"

namespace sweepkit {
namespace {

constexpr double kViewEvery = 0.1;  // [s]
constexpr double kLifted = 0.03;    // [m]

double share(std::size_t part, std::size_t whole) {
  return whole ? static_cast<double>(part) / static_cast<double>(whole) : 0.0;
}

/// Whether an occupied cell of the map comes within one cell of a point.
bool wall_near(const OccupancyImage& map, const Vec2<double>& p) {
  const Eigen::Vector2i c = map.cell_of(p);
  for (int y = c.y() - 1; y <= c.y() + 1; ++y)
    for (int x = c.x() - 1; x <= c.x() + 1; ++x) {
      if (!map.contains({x, y}) || map.cells(x, y) != OccupancyImage::kOccupied) continue;
      const Vec2<double> beyond = (p - map.centre_of(x, y)).cwiseAbs() - Vec2<double>::Constant(map.cell / 2);
      if (beyond.cwiseMax(0.0).norm() <= map.cell * (1 + 1e-9)) return true;
    }
  return false;
}

struct Span {
  TimeNs begin, end;
};

/// When there was nothing to see of the floor, as truth.yaml tells.
std::vector<Span> blind_spans(const std::filesystem::path& sensors) {
  std::vector<Span> spans;
  for (const std::filesystem::path& folder : {sensors, sensors.parent_path()}) {
    const std::filesystem::path file = folder / "truth.yaml";
    if (!std::filesystem::exists(file)) continue;
    const YamlNode root = YamlNode::load(file.string());
    if (!root.is_map() || !root.has("events")) break;
    for (const YamlNode& event : root.at("events").items()) {
      const std::string kind = event.at("kind").text();
      if (kind != "dark" && kind != "lifted") continue;
      const double start = root.at("start_time_ns").number();
      spans.push_back({static_cast<TimeNs>(start) + from_seconds(event.at("t_start").number()),
                       static_cast<TimeNs>(start) + from_seconds(event.at("t_end").number())});
    }
    break;
  }
  return spans;
}

}  // namespace

double GridEvaluation::iou() const { return share(found, visible + false_free); }
double GridEvaluation::precision() const { return free ? 1.0 - share(false_free, free) : 0.0; }
double GridEvaluation::recall() const { return share(found, visible); }
double GridEvaluation::right_wall_share() const { return share(right_walls, grid_walls); }
double GridEvaluation::found_wall_share() const { return share(found_walls, true_walls); }

std::vector<FloorView> floor_views(const Recording& recording, const Trajectory& truth) {
  const StereoRig rig = recording.rig().stereo();
  const std::vector<Span> blind = blind_spans(recording.info().path);
  std::vector<SE3d> poses;
  std::vector<double> heights;
  TimeNs last = 0;
  for (const StampedPose& pose : truth) {
    if (pose.t < recording.info().begin || pose.t > recording.info().end) continue;
    if (!poses.empty() && pose.t - last < from_seconds(kViewEvery)) continue;
    if (std::any_of(blind.begin(), blind.end(),
                    [&](const Span& s) { return pose.t >= s.begin && pose.t <= s.end; }))
      continue;
    last = pose.t;
    poses.push_back(pose.T_world_body * rig.T_body_camera());
    heights.push_back(poses.back().translation().z());
  }
  std::vector<FloorView> views;
  if (poses.empty()) return views;
  std::vector<double> sorted = heights;
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  const Camera& left = rig.camera(Side::left);
  const double f = rig.focal();
  for (std::size_t i = 0; i < poses.size(); ++i) {
    if (std::abs(heights[i] - *middle) > kLifted) continue;
    const Mat3<double> R = poses[i].rotation().matrix();
    const Vec3<double>& t = poses[i].translation();
    FloorView view;
    view.pose = {t.x(), t.y(), std::atan2(R(1, 2), R(0, 2))};
    view.left = std::atan(rig.center().x() / f);
    view.right = -std::atan((left.width() - 1 - rig.center().x()) / f);
    // The ray through the middle of the lower edge.
    const Vec3<double> low = R * Vec3<double>(0, (left.height() - 1 - rig.center().y()) / f, 1);
    view.near = low.z() < -1e-6 ? heights[i] * std::hypot(low.x(), low.y()) / -low.z() : 0.0;
    views.push_back(view);
  }
  return views;
}

GrayImage visible_floor(const OccupancyImage& truth, std::span<const FloorView> views,
                        const GridEvaluationOptions& options) {
  check_options(options);
  const int width = truth.cells.width(), height = truth.cells.height();
  GrayImage visible(width, height);
  visible.fill(views.empty() ? 255 : 0);
  const double step = options.ray_step * std::numbers::pi / 180, cell = truth.cell;
  for (const FloorView& view : views) {
    const int rays = std::max(1, static_cast<int>(std::ceil((view.left - view.right) / step)));
    const Vec2<double> at = (Vec2<double>(view.pose.x, view.pose.y) - truth.origin) / cell;
    if (!(at.cwiseAbs().maxCoeff() < 1e6)) continue;
    for (int i = 0; i <= rays; ++i) {
      const double a = view.pose.yaw + view.right + (view.left - view.right) * i / rays;
      const double reach = options.max_range / cell;
      bool open = true;
      walk_cells(at.x(), at.y(), at.x() + reach * std::cos(a), at.y() + reach * std::sin(a),
                 [&](int x, int row, double s) {
                   const int y = height - 1 - row;
                   if (!open || x < 0 || y < 0 || x >= width || y >= height) return;
                   if (s * options.max_range >= view.near) visible(x, y) = 255;
                   open = truth.cells(x, y) == OccupancyImage::kFree;
                 });
    }
  }
  return visible;
}

GridEvaluation evaluate_grid(const OccupancyImage& grid, const OccupancyImage& truth,
                             const PlanarPose& T_truth_grid, std::span<const FloorView> views,
                             const GridEvaluationOptions& options) {
  const GrayImage visible = visible_floor(truth, views, options);
  GridEvaluation e;
  e.options = options;
  e.cell = truth.cell;
  e.views = views.size();
  const double c = std::cos(T_truth_grid.yaw), s = std::sin(T_truth_grid.yaw);
  const Vec2<double> t(T_truth_grid.x, T_truth_grid.y);
  const auto to_grid = [&](const Vec2<double>& p) {
    const Vec2<double> d = p - t;
    return Vec2<double>(c * d.x() + s * d.y(), -s * d.x() + c * d.y());
  };
  const auto to_truth = [&](const Vec2<double>& p) {
    return Vec2<double>(c * p.x() - s * p.y() + t.x(), s * p.x() + c * p.y() + t.y());
  };
  for (int y = 0; y < truth.cells.height(); ++y)
    for (int x = 0; x < truth.cells.width(); ++x) {
      const Vec2<double> p = to_grid(truth.centre_of(x, y));
      const std::uint8_t is = truth.cells(x, y), said = grid.at(p);
      const bool seen = visible(x, y) != 0;
      if (said == OccupancyImage::kFree) {
        ++e.free;
        e.false_free += is != OccupancyImage::kFree;
      }
      if (is == OccupancyImage::kFree && seen) {
        ++e.visible;
        e.found += said == OccupancyImage::kFree;
        e.missed_as_wall += said == OccupancyImage::kOccupied;
      }
      if (is == OccupancyImage::kOccupied && seen) {
        ++e.true_walls;
        e.found_walls += wall_near(grid, p);
      }
    }
  for (int y = 0; y < grid.cells.height(); ++y)
    for (int x = 0; x < grid.cells.width(); ++x) {
      const Vec2<double> p = to_truth(grid.centre_of(x, y));
      if (grid.cells(x, y) == OccupancyImage::kOccupied) {
        ++e.grid_walls;
        e.right_walls += wall_near(truth, p);
      } else if (grid.cells(x, y) == OccupancyImage::kFree && !truth.contains(truth.cell_of(p))) {
        // Free space outside of all that the truth shows.
        ++e.free;
        ++e.false_free;
      }
    }
  return e;
}

std::string to_table(const GridEvaluation& e) {
  const double area = e.cell * e.cell;
  std::string text;
  const auto line = [&](const std::string& name, const std::string& value) {
    text += fmt::format("{:<20}{}\n", name, value);
  };
  line("visible", e.views ? fmt::format("within {:g} m, from {} places", e.options.max_range, e.views)
                          : std::string("taken to be everything"));
  line("free space IoU", fmt::format("{:.4f}", e.iou()));
  line("visible and free",
       fmt::format("{:.2f} m2: {:.2f} % free in the grid, {:.2f} % occupied, {:.2f} % unknown",
                   area * static_cast<double>(e.visible), 100 * e.recall(),
                   100 * share(e.missed_as_wall, e.visible),
                   100 * share(e.visible - e.found - e.missed_as_wall, e.visible)));
  line("free in the grid", fmt::format("{:.2f} m2: {:.2f} % truly free", area * static_cast<double>(e.free),
                                       100 * e.precision()));
  line("walls in the grid", fmt::format("{} cells: {:.2f} % within one cell of a true one", e.grid_walls,
                                        100 * e.right_wall_share()));
  line("visible true walls", fmt::format("{} cells: {:.2f} % within one cell of one in the grid",
                                         e.true_walls, 100 * e.found_wall_share()));
  return text;
}

std::string to_json(const GridEvaluation& e) {
  nlohmann::ordered_json json;
  json["grid_iou"] = e.iou();
  json["grid_recall"] = e.recall();
  json["grid_precision"] = e.precision();
  json["grid_walls_right"] = e.right_wall_share();
  json["true_walls_found"] = e.found_wall_share();
  json["max_range_m"] = e.options.max_range;
  json["cell_m"] = e.cell;
  json["views"] = e.views;
  json["cells"] = {{"visible", e.visible},
                   {"found", e.found},
                   {"missed_as_wall", e.missed_as_wall},
                   {"free", e.free},
                   {"false_free", e.false_free},
                   {"grid_walls", e.grid_walls},
                   {"right_walls", e.right_walls},
                   {"true_walls", e.true_walls},
                   {"found_walls", e.found_walls}};
  return json.dump(2) + "\n";
}

}  // namespace sweepkit
