// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/floor/occupancy_grid.hpp"
#include "sweepkit/floor/planar_pose.hpp"

namespace sweepkit {

/// From where a camera looked over the floor.
struct FloorView {
  PlanarPose pose;     ///< of the point below the camera in the truth's frame; yaw along what it looks at
  double right = 0.0;  ///< its field of view, as angles from the yaw, counter-clockwise [rad]
  double left = 0.0;
  double near = 0.0;  ///< floor that is nearer lies below the image [m]
};

/// Where the left camera of a recording stood, every 0.1 s between the first and the last image. Left out is
/// while it was dark or the robot was lifted: `dark` and `lifted` among the events of a `truth.yaml` beside
/// the sensors, and when the camera is more than 3 cm off its median height. The field of view is that of the
/// rectified image.
/// @param truth true poses in the frame of the true occupancy, z up
/// @throws Error(io, data, calibration)
std::vector<FloorView> floor_views(const Recording& recording, const Trajectory& truth);

struct GridEvaluationOptions {
  double max_range = 2.0;
  double ray_step = 0.2;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(max_range, "max_range", "m", range(0.1, 100),
      "floor that never came nearer to the camera was not visible");
    v(ray_step, "ray_step", "deg", range(0.01, 5), "between the rays that tell what was visible");
  }
};

/// How far an occupancy grid is from the truth. All counts are of the truth's cells, for each of which the
/// grid's cell around its centre speaks.
///
/// Visible: cells that a ray from a view reaches within its field of view and max_range, over free cells of
/// the truth, and of those that stop it, the occupied ones; a thing on the floor however low stops it.
/// Without views all cells are visible.
struct GridEvaluation {
  GridEvaluationOptions options;
  double cell = 0.0;               ///< of the truth [m]
  std::size_t views = 0;           ///< from how many places the floor was seen
  std::size_t visible = 0;         ///< truly free and visible
  std::size_t found = 0;           ///< of these, free in the grid
  std::size_t missed_as_wall = 0;  ///< of these, occupied in the grid; the rest is unknown there
  std::size_t false_free = 0;      ///< free in the grid but not in truth, wherever
  std::size_t free = 0;            ///< free in the grid
  std::size_t grid_walls = 0;      ///< occupied cells of the grid
  std::size_t right_walls =
      0;  ///< of these, with the centre at most one cell from an occupied cell of the truth
  std::size_t true_walls = 0;  ///< visible occupied cells of the truth
  std::size_t found_walls =
      0;  ///< of these, with the centre at most one cell from an occupied cell of the grid

  /// found / (visible + false_free): intersection over union of the free space that was visible, false free
  /// space counting wherever it lies; 0 if there is none.
  double iou() const;
  double precision() const;  ///< share of the grid's free cells that are truly free
  double recall() const;     ///< share of the visible free cells that the grid knows
  double right_wall_share() const;
  double found_wall_share() const;
};

/// @param T_truth_grid where the grid's frame is in the truth's
/// @param views none: everything counts as visible
GridEvaluation evaluate_grid(const OccupancyImage& grid, const OccupancyImage& truth,
                             const PlanarPose& T_truth_grid, std::span<const FloorView> views,
                             const GridEvaluationOptions& options = {});

/// The cells of the truth that could be seen: 255, else 0.
GrayImage visible_floor(const OccupancyImage& truth, std::span<const FloorView> views,
                        const GridEvaluationOptions& options = {});

/// The figures as lines for people, and the content of evaluation.json.
std::string to_table(const GridEvaluation& evaluation);
std::string to_json(const GridEvaluation& evaluation);

}  // namespace sweepkit
