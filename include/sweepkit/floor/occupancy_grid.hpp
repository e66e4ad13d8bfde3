// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/floor/floor_scan.hpp"
#include "sweepkit/floor/planar_pose.hpp"
#include "sweepkit/image/image.hpp"

namespace sweepkit {

struct OccupancyGridOptions {
  double cell = 0.05;
  double free_evidence = 0.6;
  double occupied_evidence = 0.9;
  double footprint_evidence = 4.0;
  double sharp_range = 1.5;
  double free_below = 0.4;
  double occupied_above = 0.65;
  int max_cells = 16000000;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(cell, "cell", "m", range(0.005, 1), "side of a cell");
    v(free_evidence, "free_evidence", "", range(0.01, 20),
      "by which a near ray lowers the log-odds of cells whose floor it sees");
    v(occupied_evidence, "occupied_evidence", "", range(0.01, 20),
      "by which a near ray raises the log-odds of the cell with the obstacle");
    v(footprint_evidence, "footprint_evidence", "", range(0, 20),
      "by which the robot lowers the log-odds of cells that it stands on");
    v(sharp_range, "sharp_range", "m", range(0.05, 60),
      "up to which floor that is seen counts fully; beyond, by the inverse of the distance squared");
    v(free_below, "free_below", "", range(0.01, 0.5), "a cell less likely to be occupied is free");
    v(occupied_above, "occupied_above", "", range(0.5, 0.99), "a cell more likely to be occupied is so");
    v(max_cells, "max_cells", "", range(4096, 1e9),
      "the grid does not grow beyond; what lies outside then is left out and counted");
  }
};

/// A map of the floor seen from above, ready for map_server: row 0 has the highest y.
struct OccupancyImage {
  static constexpr std::uint8_t kFree = 254, kOccupied = 0, kUnknown = 205;

  double cell = 0.05;                          ///< [m]
  Vec2<double> origin = Vec2<double>::Zero();  ///< lower left corner of the lower left cell [m]
  GrayImage cells;

  /// Column and row of the cell around a point; may lie outside.
  Eigen::Vector2i cell_of(const Vec2<double>& p) const {
    const Vec2<double> q = (p - origin) / cell;
    return {static_cast<int>(std::floor(q.x())), cells.height() - 1 - static_cast<int>(std::floor(q.y()))};
  }
  Vec2<double> centre_of(int column, int row) const {
    return origin + cell * Vec2<double>(column + 0.5, cells.height() - 0.5 - row);
  }
  bool contains(const Eigen::Vector2i& c) const {
    return c.x() >= 0 && c.y() >= 0 && c.x() < cells.width() && c.y() < cells.height();
  }
  /// kUnknown outside.
  std::uint8_t at(const Vec2<double>& p) const {
    const Eigen::Vector2i c = cell_of(p);
    return contains(c) ? cells(c.x(), c.y()) : kUnknown;
  }
};

/// Log-odds of the floor's cells being occupied (Moravec and Elfes, High resolution maps from wide angle
/// sonar, 1985; Thrun, Burgard and Fox, Probabilistic Robotics, chapter 9), as sums of what each scan says.
///
/// A scan gives each cell one vote, however many of its rays cross it: the footprint's if the robot stands on
/// it, else that of the nearest obstacle in it, else that of the floor seen in it, weighted by how sharply it
/// is seen. Votes are whole numbers and are added without a limit: scans may come in any order, and taking
/// one out leaves what there would be without it, to the bit. Probabilities are cut only when they are read.
/// Cell (i, j) covers [i, i + 1) x [j, j + 1) times the cell's side in the map's frame. The grid grows in
/// blocks of 64 cells as scans need it. Not thread-safe.
class OccupancyGrid {
 public:
  static constexpr int kOne = 1024;  ///< steps of the whole numbers in which log-odds are kept
  static constexpr int kBlock = 64;  ///< [cells]

  /// @throws Error(option)
  explicit OccupancyGrid(const OccupancyGridOptions& options = {});

  const OccupancyGridOptions& options() const { return options_; }

  void add(const FloorScan& scan, const PlanarPose& pose) { apply(scan, pose, 1); }
  /// Takes back a scan that was added at exactly this pose.
  void remove(const FloorScan& scan, const PlanarPose& pose) { apply(scan, pose, -1); }
  void clear();

  /// Log-odds of the cell around a point, in steps of 1 / kOne; 0 where nothing is known.
  std::int32_t log_odds(const Vec2<double>& p) const;
  /// The same for all cells: element (i - first_x(), j - first_y()), row 0 lowest.
  View2d<const std::int32_t> cells() const { return {cells_.data(), width_, height_}; }
  int first_x() const { return first_x_; }
  int first_y() const { return first_y_; }
  /// Votes that fell outside of a grid that must not grow any more.
  std::int64_t left_out() const { return left_out_; }

  /// Free, occupied and unknown cells: the smallest rectangle around all that is known, and one cell more on
  /// each side.
  OccupancyImage image() const;

 private:
  struct Vote {
    int x, y;  // [cells]
    std::int32_t log_odds;
  };

  void apply(const FloorScan& scan, const PlanarPose& pose, int sign);
  void vote(const FloorScan& scan, const PlanarPose& pose);
  void make_room();

  OccupancyGridOptions options_;
  std::vector<std::int32_t> cells_;
  int first_x_ = 0, first_y_ = 0, width_ = 0, height_ = 0;  // [cells]
  bool full_ = false;
  std::int64_t left_out_ = 0;
  // Of the scan at hand.
  std::vector<Vote> votes_;
  std::vector<std::int32_t> window_;  // its strongest vote for each cell around it
};

}  // namespace sweepkit
