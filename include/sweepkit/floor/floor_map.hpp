// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <vector>

#include "sweepkit/core/ids.hpp"
#include "sweepkit/core/options.hpp"
#include "sweepkit/floor/floor_scan.hpp"
#include "sweepkit/floor/occupancy_grid.hpp"
#include "sweepkit/floor/planar_pose.hpp"

namespace sweepkit {

struct FloorMapOptions {
  double max_tilt = 4.0;
  double move = 0.01;
  double turn = 0.3;
  OccupancyGridOptions grid;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(max_tilt, "max_tilt", "deg", range(0.1, 45),
      "a scan whose floor is tilted by more against the map's horizontal is not drawn");
    v(move, "move", "m", range(0, 1), "a scan that a correction moves by no more stays where it is drawn");
    v(turn, "turn", "deg", range(0, 45), "or turns by no more");
    v.group(grid, "grid", "cells and evidence");
  }
};

/// The floor as all scans show it, each hung on a keyframe: when the map is corrected the scans follow, and
/// the grid with them, without the images. A scan takes about 4 kB; a thousand of them are 4 MB.
///
/// The grid holds the scans of keyframes that have a pose. After update() it equals, to the bit, a grid to
/// which the same scans were added at the poses at which they are drawn; with `move` and `turn` zero these
/// are the keyframes' present ones. Deterministic; not thread-safe.
class FloorMap {
 public:
  /// @throws Error(option)
  explicit FloorMap(const FloorMapOptions& options = {});

  const FloorMapOptions& options() const { return options_; }

  /// Hangs a scan on a keyframe, which may not have a pose yet. Drawn by the next update().
  /// @param T_keyframe_scan from the scan's frame (see FloorScan) to the keyframe's camera
  void add(KeyframeId keyframe, const SE3d& T_keyframe_scan, FloorScan scan);
  /// Says where a keyframe's camera is in the map, whose z points up; nothing takes its scans off the grid
  /// (a keyframe of another map). Keyframes without scans are left alone.
  void set_pose(KeyframeId keyframe, const std::optional<SE3d>& T_map_keyframe);
  /// Hangs the scans of a keyframe that is removed on another one.
  void rehang(KeyframeId from, KeyframeId to, const SE3d& T_to_from);
  /// Forgets a keyframe and its scans.
  void erase(KeyframeId keyframe);

  /// Draws what is new, and what moved by more than the options say again. Returns the number of scans
  /// drawn.
  std::size_t update();
  /// Draws everything anew at the present poses.
  void rebuild();

  const OccupancyGrid& grid() const { return grid_; }
  /// The grid's cells as a map, without what lies behind walls by error: see keep_reachable, the places being
  /// those at which the robot stood when it saw the scans, and the floor that it then saw right before it.
  OccupancyImage image() const;
  /// The keyframes that scans hang on, in order.
  std::vector<KeyframeId> keyframes() const;
  std::size_t scans() const;
  std::size_t drawn() const;
  /// Memory of the scans.
  std::size_t bytes() const;

 private:
  struct Scan {
    SE3d T_keyframe_scan;
    FloorScan scan;
    std::optional<PlanarPose> drawn;
  };
  struct Keyframe {
    std::optional<SE3d> T_map_keyframe;
    std::vector<Scan> scans;
  };

  void undraw(Scan& scan);

  FloorMapOptions options_;
  OccupancyGrid grid_;
  std::map<KeyframeId, Keyframe> keyframes_;
};

}  // namespace sweepkit
