// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <filesystem>
#include <mutex>
#include <optional>
#include <span>

#include "sweepkit/core/options.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/floor/floor_map.hpp"
#include "sweepkit/floor/floor_scan.hpp"
#include "sweepkit/map/map.hpp"

namespace sweepkit {

struct GridStageOptions {
  double every_distance = 0.05;
  double every_turn = 5.0;
  FloorScanOptions scan;
  FloorMapOptions map;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(every_distance, "every_distance", "m", range(0, 10),
      "an image is made a scan when the camera has moved by so much since the last one");
    v(every_turn, "every_turn", "deg", range(0, 180), "or turned by so much");
    v.group(scan, "scan", "the floor as one image shows it");
    v.group(map, "map", "the floor as all images show it");
  }
};

/// Where an image was taken, as tracking tells it (TrackedImage).
struct GridView {
  KeyframeId reference;     ///< its scan hangs on this keyframe
  SE3d T_camera_reference;  ///< from that keyframe's camera to the image's
  SE3d T_smooth_camera;     ///< in a frame without jumps (odom): tells how far the camera has moved
};

/// Keeps the floor's grid of a run: makes scans of disparity images and hangs them on keyframes. Thread-safe:
/// one thread may add while another asks for the grid.
class GridStage {
 public:
  /// @param base_camera the robot's centre on the floor, in the frame of the rectified left camera [m]
  /// @throws Error(option)
  GridStage(const RectifiedCamera& camera, const Vec3<double>& base_camera,
            const GridStageOptions& options = {});

  /// Whether the camera has moved enough since the last scan for another one to tell something new.
  bool is_due(const GridView& view) const;
  /// Makes a scan and keeps it, if one is due. To be called only with a plane that was measured or
  /// predicted, not with a refused one nor while the robot is lifted.
  /// @param disparity of the rectified left image
  /// @return whether a scan was kept
  bool add(DisparityView disparity, const GroundPlane& plane, const GridView& view);

  /// The grid at the keyframes' present poses, in the map's frame; only what belongs to that map of the
  /// atlas.
  OccupancyImage image(const Map& map, MapId shown);

  std::size_t scans() const;
  std::size_t bytes() const;  ///< memory of the scans

 private:
  RectifiedCamera camera_;
  Vec3<double> base_camera_;
  GridStageOptions options_;
  mutable std::mutex mutex_;
  FloorScanner scanner_;
  FloorMap floor_;
  std::optional<SE3d> T_smooth_last_;
};

/// Draws a grid, with the path of the body over it, as PNG: free white, occupied black, unknown grey; the
/// path blue, its end red. Cells are drawn as squares of several pixels in small maps.
/// @throws Error(io)
void write_grid_picture(const std::filesystem::path& file, const OccupancyImage& map,
                        std::span<const StampedPose> path);

/// Writes grid.yaml, grid.pgm and grid.png. @throws Error(io)
void write_grid_results(const std::filesystem::path& folder, const OccupancyImage& map,
                        std::span<const StampedPose> path);

}  // namespace sweepkit
