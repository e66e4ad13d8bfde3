// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/floor_plan.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <utility>

#include "scene_solid.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/data/image_file.hpp"

namespace sweepkit {
namespace {

using Vec2d = Vec2<double>;

constexpr double kLowest = 0.012, kHighest = 0.095;  // what a robot bumps into is solid between these [m]
constexpr std::size_t kMostCells = std::size_t{1} << 26;

/// From 0 to 1 over [0, 1] with first and second derivative zero at both ends (Perlin 2002).
double smooth_step(double t) {
  t = std::clamp(t, 0.0, 1.0);
  return t * t * t * (t * (6 * t - 15) + 10);
}

/// Something that a robot drives over.
struct Rise {
  Vec2d centre, axis, half;
  double height, ramp;
  bool sideways;  ///< whether it also comes up at its ends along y
  int object;

  Vec2d local(const Vec2d& p) const {
    const Vec2d d = p - centre;
    return {d.dot(axis), -d.x() * axis.y() + d.y() * axis.x()};
  }
  double at(const Vec2d& p) const {
    const Vec2d q = local(p).cwiseAbs();
    const double x = smooth_step((half.x() - q.x()) / ramp);
    if (x == 0) return 0;
    return height * x * (sideways ? smooth_step((half.y() - q.y()) / ramp) : 1.0);
  }
};

struct Segment {
  Vec2d a, b;
};

struct Opening {
  Vec2d centre, axis;
  double depth, width;
};

}  // namespace

struct FloorPlan::Shapes {
  std::vector<std::vector<Vec2d>> rooms;
  std::vector<Opening> openings;
  std::vector<Segment> walls;
  std::vector<Footprint> obstacles, overhead;
  std::vector<Rise> rises;
  Vec2d low, high;

  bool in_opening(const Vec2d& p) const {
    for (const Opening& o : openings) {
      const Vec2d d = p - o.centre;
      if (std::abs(d.dot(o.axis)) <= o.depth / 2 + 1e-9 &&
          std::abs(-d.x() * o.axis.y() + d.y() * o.axis.x()) < o.width / 2)
        return true;
    }
    return false;
  }
  int room_at(const Vec2d& p) const {
    for (std::size_t i = 0; i < rooms.size(); ++i)
      if (polygon_distance(rooms[i], p) < 0) return static_cast<int>(i);
    return -1;
  }
};

FloorPlan::FloorPlan(const Scene& scene) {
  auto shapes = std::make_unique<Shapes>();
  Shapes& s = *shapes;
  s.low = Vec2d::Constant(std::numeric_limits<double>::infinity());
  s.high = -s.low;
  std::vector<DoorPassage> passages;
  for (const Door& door : scene.doors) {
    const DoorPassage p = door_passage(scene, door);
    passages.push_back(p);
    const Vec2d axis(std::cos(p.yaw), std::sin(p.yaw)), side(-axis.y(), axis.x());
    s.openings.push_back({p.centre, axis, p.depth, p.width});
    for (const double j : {-0.5, 0.5}) {
      const Vec2d middle = p.centre + j * p.width * side;
      s.walls.push_back({middle - 0.5 * p.depth * axis, middle + 0.5 * p.depth * axis});
    }
    // The way over a sill ends where its ramps do, on both sides of the wall.
    if (door.sill > 0)
      s.rises.push_back({p.centre,
                         axis,
                         {p.depth / 2 + door.sill_ramp / 2, p.width / 2},
                         door.sill,
                         door.sill_ramp,
                         false,
                         -1});
  }
  for (const Room& room : scene.rooms) {
    s.rooms.push_back(room.corners);
    const std::size_t n = room.corners.size();
    for (std::size_t i = 0; i < n; ++i) {
      const Vec2d a = room.corners[i], b = room.corners[(i + 1) % n];
      s.low = s.low.cwiseMin(a);
      s.high = s.high.cwiseMax(a);
      const double length = (b - a).norm();
      const Vec2d d = (b - a) / length;
      std::vector<std::pair<double, double>> gaps;
      for (std::size_t k = 0; k < scene.doors.size(); ++k)
        for (const auto& [name, wall] : {std::pair{scene.doors[k].from, passages[k].from_wall},
                                         {scene.doors[k].to, passages[k].to_wall}})
          if (name == room.name && wall == static_cast<int>(i)) {
            const double at = (passages[k].centre - a).dot(d);
            gaps.emplace_back(at - scene.doors[k].width / 2, at + scene.doors[k].width / 2);
          }
      std::sort(gaps.begin(), gaps.end());
      double from = 0;
      for (const auto& [g0, g1] : gaps) {
        s.walls.push_back({a + d * from, a + d * g0});
        from = g1;
      }
      s.walls.push_back({a + d * from, b});
    }
  }
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const SceneObject& object = scene.objects[i];
    if (object.kind == ObjectKind::carpet) {
      const Vec3<double> size = object.size.isZero() ? usual_size(object.kind) : object.size;
      s.rises.push_back({object.centre,
                         {std::cos(object.yaw), std::sin(object.yaw)},
                         {size.x() / 2, size.y() / 2},
                         size.z(),
                         object.ramp,
                         true,
                         static_cast<int>(i)});
      continue;
    }
    if (object.kind == ObjectKind::cable) continue;
    for (const Solid& solid : object_solids(object, static_cast<int>(i))) {
      const Footprint f = footprint(solid);
      if (f.high > kLowest && f.low < kHighest) s.obstacles.push_back(f);
      if (f.high > kHighest) s.overhead.push_back(f);
    }
  }
  shapes_ = std::move(shapes);
}

FloorPlan::~FloorPlan() = default;
FloorPlan::FloorPlan(FloorPlan&&) noexcept = default;
FloorPlan& FloorPlan::operator=(FloorPlan&&) noexcept = default;

double FloorPlan::height(double x, double y) const {
  // Rises do not overlap but for their ramps at most: their sum stays as smooth as each.
  double sum = 0;
  for (const Rise& rise : shapes_->rises) sum += rise.at({x, y});
  return sum;
}

double FloorPlan::clearance(double x, double y) const {
  const Vec2d p(x, y);
  double nearest = std::numeric_limits<double>::infinity();
  for (const Segment& wall : shapes_->walls) nearest = std::min(nearest, segment_distance(wall.a, wall.b, p));
  if (shapes_->room_at(p) < 0 && !shapes_->in_opening(p)) return -nearest;
  for (const Footprint& f : shapes_->obstacles) {
    if ((f.centre - p).squaredNorm() > std::pow(nearest + f.half.norm(), 2)) continue;
    nearest = std::min(nearest, f.distance(p));
  }
  return nearest;
}

bool FloorPlan::open_above(double x, double y, double radius) const {
  return std::none_of(shapes_->overhead.begin(), shapes_->overhead.end(), [&](const Footprint& f) {
    return f.distance({x, y}) < radius;
  });
}

int FloorPlan::room_at(double x, double y) const { return shapes_->room_at({x, y}); }

int FloorPlan::carpet_at(double x, double y) const {
  for (const Rise& rise : shapes_->rises) {
    if (rise.object < 0) continue;
    const Vec2d q = rise.local({x, y}).cwiseAbs();
    if (q.x() <= rise.half.x() && q.y() <= rise.half.y()) return rise.object;
  }
  return -1;
}

Vec2d FloorPlan::low() const { return shapes_->low; }
Vec2d FloorPlan::high() const { return shapes_->high; }

TrueOccupancy true_occupancy(const Scene& scene, const Vec2d& start, double cell) {
  require(cell >= 0.005 && cell <= 1.0, "true_occupancy cell", "must lie in 0.005 .. 1 m", cell);
  const FloorPlan plan(scene);
  constexpr double kMargin = 0.3;
  TrueOccupancy result;
  result.cell = cell;
  result.origin = plan.low() - Vec2d::Constant(kMargin);
  const int width = static_cast<int>(std::ceil((plan.high().x() + kMargin - result.origin.x()) / cell));
  const int height = static_cast<int>(std::ceil((plan.high().y() + kMargin - result.origin.y()) / cell));
  if (static_cast<std::size_t>(width) * static_cast<std::size_t>(height) > kMostCells)
    throw Error(ErrorKind::argument, "true_occupancy cell", "makes too many cells",
                fmt::format("{:g}", cell));
  constexpr std::uint8_t kFree = 254, kOccupied = 0, kUnknown = 205, kOpen = 1;
  GrayImage& image = result.cells;
  image.resize(width, height);
  const auto centre = [&](int x, int y) {
    return Vec2d(result.origin.x() + (x + 0.5) * cell, result.origin.y() + (height - 1 - y + 0.5) * cell);
  };
  // A cell is taken where something solid comes closer to its centre than half its side. The skin of what is
  // solid is shown, thick enough to have no gaps; what is deeper inside cannot be known.
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const Vec2d p = centre(x, y);
      const double clearance = plan.clearance(p.x(), p.y());
      image(x, y) = clearance >= cell / 2 ? kOpen : clearance > -0.75 * cell ? kOccupied : kUnknown;
    }
  const int sx = static_cast<int>((start.x() - result.origin.x()) / cell);
  const int sy = height - 1 - static_cast<int>((start.y() - result.origin.y()) / cell);
  require(sx >= 0 && sy >= 0 && sx < width && sy < height &&
              image(std::clamp(sx, 0, width - 1), std::clamp(sy, 0, height - 1)) == kOpen,
          "true_occupancy start", "must lie on free floor",
          fmt::format("[{:.3f}, {:.3f}]", start.x(), start.y()));
  std::vector<std::pair<int, int>> stack{{sx, sy}};
  image(sx, sy) = kFree;
  while (!stack.empty()) {
    const auto [x, y] = stack.back();
    stack.pop_back();
    for (const auto& [dx, dy] : {std::pair{1, 0}, {-1, 0}, {0, 1}, {0, -1}}) {
      const int u = x + dx, v = y + dy;
      if (u < 0 || v < 0 || u >= width || v >= height || image(u, v) != kOpen) continue;
      image(u, v) = kFree;
      stack.emplace_back(u, v);
    }
  }
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      if (image(x, y) == kOpen) image(x, y) = kUnknown;
  return result;
}

void write_occupancy(const TrueOccupancy& occupancy, const std::filesystem::path& folder,
                     const std::string& name) {
  write_png(folder / (name + ".png"), occupancy.cells);
  const std::filesystem::path file = folder / (name + ".yaml");
  std::ofstream out(file);
  out << fmt::format(
      "image: {}.png\nresolution: {:.6f}\norigin: [{:.6f}, {:.6f}, 0.0]\nnegate: 0\noccupied_thresh: "
      "0.65\nfree_thresh: 0.196\n",
      name, occupancy.cell, occupancy.origin.x(), occupancy.origin.y());
  out.flush();
  if (!out) throw Error(ErrorKind::io, file.string(), "cannot be written");
}

}  // namespace sweepkit
