// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "drive_path.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/data/floor_plan.hpp"
#include "sweepkit/data/scene.hpp"

namespace sweepkit {

/// Finds ways for a round robot on a floor plan.
class DrivePlanner {
 public:
  /// @param radius that has to be free around each point of a way
  DrivePlanner(const FloorPlan& plan, double radius);

  /// Whether a straight piece keeps that radius; the first spot where it does not goes to `blocked`.
  bool is_free(const Vec2<double>& a, const Vec2<double>& b, double radius,
               Vec2<double>* blocked = nullptr) const;
  bool is_free(const Vec2<double>& a, const Vec2<double>& b) const { return is_free(a, b, radius_); }

  /// A way from a to b around what stands there (A* on cells of 5 cm, then cut short), both included; nothing
  /// if there is none.
  std::optional<Points> route(const Vec2<double>& a, const Vec2<double>& b) const;

  /// Parts of parallel lines over a room on which the robot fits, in the order of a ploughman.
  /// @param along the longer way of the room if true
  std::vector<Points> lanes(const Room& room, double direction, double spacing, bool along,
                            bool from_far) const;

  /// A way at that distance from the walls, which are to the right, beginning near a point.
  std::optional<Points> along_wall(const Vec2<double>& from, double distance, double length) const;

 private:
  struct Cell {
    int x, y;
  };
  Vec2<double> centre(Cell c) const;
  std::optional<Cell> nearest_free(const Vec2<double>& p) const;
  bool passable(Cell c) const;

  static constexpr double kCell = 0.05;
  const FloorPlan& plan_;
  double radius_;
  Vec2<double> low_;
  int width_, height_;
  std::vector<float> clearance_;
};

}  // namespace sweepkit
