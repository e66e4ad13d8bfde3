// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "drive_planner.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <queue>
#include <tuple>

namespace sweepkit {
namespace {

// The points of a chain that matter: none of those left out lies farther than `tolerance` from what remains
// (Douglas and Peucker 1973).
Points simplified(const Points& points, double tolerance) {
  std::vector<bool> keep(points.size(), false);
  keep.front() = keep.back() = true;
  std::vector<std::pair<std::size_t, std::size_t>> open = {{0, points.size() - 1}};
  while (!open.empty()) {
    const auto [a, b] = open.back();
    open.pop_back();
    const Vec2<double> d = points[b] - points[a];
    double worst = tolerance;
    std::size_t at = a;
    for (std::size_t i = a + 1; i < b; ++i) {
      const Vec2<double> e = points[i] - points[a];
      const double off = d.norm() > 1e-9 ? std::abs(d.x() * e.y() - d.y() * e.x()) / d.norm() : e.norm();
      if (off > worst) worst = off, at = i;
    }
    if (at == a) continue;
    keep[at] = true;
    open.push_back({a, at});
    open.push_back({at, b});
  }
  Points kept;
  for (std::size_t i = 0; i < points.size(); ++i)
    if (keep[i]) kept.push_back(points[i]);
  return kept;
}

}  // namespace

DrivePlanner::DrivePlanner(const FloorPlan& plan, double radius)
    : plan_(plan), radius_(radius), low_(plan.low()) {
  const Vec2<double> size = plan.high() - plan.low();
  width_ = std::max(1, static_cast<int>(std::ceil(size.x() / kCell)));
  height_ = std::max(1, static_cast<int>(std::ceil(size.y() / kCell)));
  clearance_.reserve(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_));
  for (int y = 0; y < height_; ++y)
    for (int x = 0; x < width_; ++x) {
      const Vec2<double> p = centre({x, y});
      clearance_.push_back(static_cast<float>(plan.clearance(p.x(), p.y())));
    }
}

Vec2<double> DrivePlanner::centre(Cell c) const { return low_ + kCell * Vec2<double>(c.x + 0.5, c.y + 0.5); }

bool DrivePlanner::passable(Cell c) const {
  if (c.x < 0 || c.y < 0 || c.x >= width_ || c.y >= height_) return false;
  return clearance_[static_cast<std::size_t>(c.y) * static_cast<std::size_t>(width_) +
                    static_cast<std::size_t>(c.x)] >= static_cast<float>(radius_);
}

std::optional<DrivePlanner::Cell> DrivePlanner::nearest_free(const Vec2<double>& p) const {
  const Vec2<double> at = (p - low_) / kCell;
  const Cell middle{static_cast<int>(std::floor(at.x())), static_cast<int>(std::floor(at.y()))};
  std::optional<Cell> best;
  double nearest = std::numeric_limits<double>::infinity();
  constexpr int kReach = 4;
  for (int y = middle.y - kReach; y <= middle.y + kReach; ++y)
    for (int x = middle.x - kReach; x <= middle.x + kReach; ++x) {
      const double d = (centre({x, y}) - p).norm();
      if (d < nearest && passable({x, y})) nearest = d, best = Cell{x, y};
    }
  return best;
}

bool DrivePlanner::is_free(const Vec2<double>& a, const Vec2<double>& b, double radius,
                           Vec2<double>* blocked) const {
  const double length = (b - a).norm();
  for (double s = 0.0;;) {
    const Vec2<double> p = length > 0.0 ? Vec2<double>(a + s / length * (b - a)) : a;
    const double spare = plan_.clearance(p.x(), p.y()) - radius;
    if (spare < 0.0) {
      if (blocked) *blocked = p;
      return false;
    }
    if (s >= length) return true;
    // Clearance changes by no more than the way.
    s = std::min(length, s + std::max(spare, 0.005));
  }
}

std::optional<Points> DrivePlanner::route(const Vec2<double>& a, const Vec2<double>& b) const {
  if (is_free(a, b)) return Points{a, b};
  const auto start = nearest_free(a), goal = nearest_free(b);
  if (!start || !goal) return std::nullopt;
  const auto index = [&](Cell c) {
    return static_cast<std::size_t>(c.y) * static_cast<std::size_t>(width_) + static_cast<std::size_t>(c.x);
  };
  const std::size_t cells = clearance_.size();
  std::vector<float> cost(cells, std::numeric_limits<float>::infinity());
  std::vector<std::int32_t> from(cells, -1);
  using Entry = std::tuple<float, std::int32_t>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> open;
  const auto rest = [&](Cell c) { return static_cast<float>(std::hypot(c.x - goal->x, c.y - goal->y)); };
  cost[index(*start)] = 0.0f;
  open.push({rest(*start), static_cast<std::int32_t>(index(*start))});
  while (!open.empty()) {
    const auto at = static_cast<std::size_t>(std::get<1>(open.top()));
    const float estimate = std::get<0>(open.top());
    open.pop();
    const Cell c{static_cast<int>(at % static_cast<std::size_t>(width_)),
                 static_cast<int>(at / static_cast<std::size_t>(width_))};
    if (estimate > cost[at] + rest(c) + 1e-3f) continue;
    if (at == index(*goal)) break;
    for (int dy = -1; dy <= 1; ++dy)
      for (int dx = -1; dx <= 1; ++dx) {
        const Cell next{c.x + dx, c.y + dy};
        if ((dx == 0 && dy == 0) || !passable(next)) continue;
        // Ways with room to spare are preferred.
        const float spare = clearance_[index(next)] - static_cast<float>(radius_);
        const float price = (dx != 0 && dy != 0 ? 1.41421356f : 1.0f) * (1.0f + 0.05f / (0.05f + spare));
        if (cost[at] + price < cost[index(next)]) {
          cost[index(next)] = cost[at] + price;
          from[index(next)] = static_cast<std::int32_t>(at);
          open.push({cost[index(next)] + rest(next), static_cast<std::int32_t>(index(next))});
        }
      }
  }
  if (from[index(*goal)] < 0 && index(*goal) != index(*start)) return std::nullopt;
  Points cells_back = {b};
  for (auto at = static_cast<std::int32_t>(index(*goal)); at >= 0; at = from[static_cast<std::size_t>(at)])
    cells_back.push_back(centre({at % width_, at / width_}));
  cells_back.push_back(a);
  const Points way(cells_back.rbegin(), cells_back.rend());
  // From each point to the farthest that is seen from it.
  Points cut = {way.front()};
  for (std::size_t i = 0; i + 1 < way.size();) {
    std::size_t j = way.size() - 1;
    while (j > i + 1 && !is_free(way[i], way[j])) --j;
    cut.push_back(way[j]);
    i = j;
  }
  return cut;
}

std::vector<Points> DrivePlanner::lanes(const Room& room, double direction, double spacing, bool along,
                                        bool from_far) const {
  // The room's extent in axes along and across the lanes.
  const auto axes = [&](double angle) { return Vec2<double>(std::cos(angle), std::sin(angle)); };
  Vec2<double> u = axes(direction), v(-u.y(), u.x());
  const auto extent = [&](const Vec2<double>& axis) {
    double low = 1e30, high = -1e30;
    for (const auto& corner : room.corners)
      low = std::min(low, axis.dot(corner)), high = std::max(high, axis.dot(corner));
    return std::pair(low, high);
  };
  const auto length = [&](const Vec2<double>& axis) { return extent(axis).second - extent(axis).first; };
  if ((length(u) >= length(v)) != along) std::swap(u, v);
  const auto [u_low, u_high] = extent(u);
  const auto [v_low, v_high] = extent(v);

  constexpr double kStep = 0.02, kShortest = 0.4;
  const double first = v_low + radius_, last = v_high - radius_;
  if (last < first) return {};
  const int count = 1 + static_cast<int>((last - first) / spacing);
  std::vector<Points> lanes;
  for (int i = 0; i < count; ++i) {
    const double offset = from_far ? last - i * spacing : first + i * spacing;
    std::vector<Points> parts;
    double begin = 0.0;
    bool inside = false;
    for (double s = u_low; s <= u_high + kStep; s += kStep) {
      const Vec2<double> p = s * u + offset * v;
      const bool fits = s <= u_high && plan_.clearance(p.x(), p.y()) >= radius_;
      if (fits && !inside) begin = s;
      // The last point before the obstacle may touch what lies between two steps.
      if (!fits && inside && s - 2 * kStep - begin >= kShortest)
        parts.push_back({(begin + kStep) * u + offset * v, (s - 2 * kStep) * u + offset * v});
      inside = fits;
    }
    if (i % 2 == 1) {
      std::reverse(parts.begin(), parts.end());
      for (Points& part : parts) std::reverse(part.begin(), part.end());
    }
    for (Points& part : parts)
      if (is_free(part[0], part[1])) lanes.push_back(std::move(part));
  }
  return lanes;
}

std::optional<Points> DrivePlanner::along_wall(const Vec2<double>& from, double distance,
                                               double length) const {
  const auto clearance = [&](const Vec2<double>& p) { return plan_.clearance(p.x(), p.y()); };
  const auto slope = [&](const Vec2<double>& p) {
    constexpr double kH = 1e-3;
    const Vec2<double> g(clearance(p + Vec2<double>(kH, 0)) - clearance(p - Vec2<double>(kH, 0)),
                         clearance(p + Vec2<double>(0, kH)) - clearance(p - Vec2<double>(0, kH)));
    return g.norm() > 1e-9 ? Vec2<double>(g / g.norm()) : Vec2<double>(1, 0);
  };
  const auto settle = [&](Vec2<double> p) {
    for (int i = 0; i < 60 && std::abs(clearance(p) - distance) > 1e-3; ++i)
      p += std::clamp(distance - clearance(p), -0.05, 0.05) * slope(p);
    return p;
  };
  constexpr double kStep = 0.03;
  Vec2<double> p = settle(from);
  if (std::abs(clearance(p) - distance) > 0.01) return std::nullopt;
  Points line = {p};
  double gone = 0.0;
  while (gone < length) {
    const Vec2<double> away = slope(p);
    const Vec2<double> next = settle(p + kStep * Vec2<double>(away.y(), -away.x()));
    const double way = (next - p).norm();
    // In a nook the line may turn on itself; that is where it ends.
    if (way < 1e-4 || clearance(next) < distance - 0.02) break;
    gone += way;
    p = next;
    line.push_back(p);
    if (gone > 1.0 && (p - line.front()).norm() < kStep) break;
  }
  if (gone < 0.3) return std::nullopt;
  return simplified(line, 0.01);
}

}  // namespace sweepkit
