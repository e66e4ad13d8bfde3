// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "sweepkit/data/scene.hpp"
#include "sweepkit/image/image.hpp"

namespace sweepkit {

/// The floor of a flat seen from above: how high it is and where a robot fits. Obstacles are walls and what
/// is solid between 1.2 and 9.5 cm above the floor; carpets, sills and cables are none. Immutable; any
/// number of threads may ask. A query costs about a microsecond.
class FloorPlan {
 public:
  /// Takes a scene that has passed check().
  explicit FloorPlan(const Scene& scene);
  ~FloorPlan();
  FloorPlan(FloorPlan&&) noexcept;
  FloorPlan& operator=(FloorPlan&&) noexcept;

  /// Height above the bare floor on which a wheel stands: sills and carpets, each with a ramp of its own
  /// length at its edges (the way that a wheel takes, longer than the edge itself). Twice continuously
  /// differentiable.
  double height(double x, double y) const;
  /// Distance to the nearest wall or obstacle; negative inside of one and outside of the flat.
  double clearance(double x, double y) const;
  bool is_free(double x, double y, double radius) const { return clearance(x, y) >= radius; }
  /// Whether nothing is overhead so far around, neither table nor bed: a hand can put the robot down there.
  bool open_above(double x, double y, double radius) const;
  /// Index of the room around a point; -1 in doors and outside.
  int room_at(double x, double y) const;
  /// Whether a point lies on a carpet, and which object that is; -1 on none.
  int carpet_at(double x, double y) const;
  /// The box around all rooms.
  Vec2<double> low() const;
  Vec2<double> high() const;

 private:
  struct Shapes;
  std::unique_ptr<const Shapes> shapes_;
};

/// True occupancy of the floor in map_server's form.
struct TrueOccupancy {
  double cell = 0.05;   ///< [m]
  Vec2<double> origin;  ///< lower left corner of the lower left cell, in the world
  GrayImage cells;      ///< row 0 has the highest y; 254 free, 0 occupied, 205 unknown
};

/// Cells of the floor that can be reached from `start` are free (254), cells that an obstacle touches are
/// occupied (0), all others, outside or within furniture, are unknown (205). Reached is what connects to
/// `start` by free cells.
TrueOccupancy true_occupancy(const Scene& scene, const Vec2<double>& start, double cell = 0.05);

/// Writes NAME.png and NAME.yaml (map_server). @throws Error(io)
void write_occupancy(const TrueOccupancy& occupancy, const std::filesystem::path& folder,
                     const std::string& name = "floor_occupancy");

}  // namespace sweepkit
