// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/grid_stage.hpp"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <filesystem>
#include <memory>
#include <utility>
#include <vector>

#include "scratch_folder.hpp"
#include "sweepkit/data/image_file.hpp"
#include "sweepkit/floor/grid_file.hpp"
#include "sweepkit/image/image.hpp"

using namespace sweepkit;

namespace {

const RectifiedCamera kCamera{320.0, 319.5, 199.5, 0.06};
const GroundPlane kPlane{Vec3<double>(0, 1, 0), 0.08};

/// A wall across, 1 m ahead.
Image<std::int16_t> disparities() {
  Image<std::int16_t> image(640, 400);
  const FloorDisparity floor = kPlane.disparity(kCamera);
  for (int v = 0; v < 400; ++v)
    for (int u = 0; u < 640; ++u)
      image(u, v) =
          static_cast<std::int16_t>(std::lround(16 * std::max(floor(u, v), kCamera.disparity(1.0))));
  return image;
}

/// A level camera 8 cm over the floor that looks along the map's x axis.
SE3d camera_at(double x, double y) {
  Mat3<double> R;
  R << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  return {SO3d(R), Vec3<double>(x, y, 0.08)};
}

Keyframe keyframe(const SE3d& T_map_camera, MapId map) {
  Keyframe k;
  k.map = map;
  k.T_camera_world = T_map_camera.inverse();
  return k;
}

}  // namespace

TEST_CASE("scans of a run follow the keyframes of its map") {
  Map map;
  const MapId first = map.add_map(), second = map.add_map();
  const KeyframeId a = map.add_keyframe(keyframe(camera_at(0, 0), first)),
                   b = map.add_keyframe(keyframe(camera_at(0, 3), second));
  GridStage stage(kCamera, Vec3<double>(0, 0.08, -0.1));
  const Image<std::int16_t> image = disparities();
  GridView view{a, SE3d(), camera_at(0, 0)};
  CHECK(stage.is_due(view));
  CHECK(stage.add(image, kPlane, view));
  CHECK_FALSE(stage.add(image, kPlane, view));  // it has not moved
  view.T_smooth_camera = camera_at(0.06, 0);
  CHECK(stage.add(image, kPlane, view));
  view = {b, SE3d(), camera_at(0, 3)};
  CHECK(stage.add(image, kPlane, view));
  CHECK_FALSE(stage.add(image, kPlane, {KeyframeId(), SE3d(), camera_at(9, 9)}));
  CHECK(stage.scans() == 3);
  CHECK(stage.bytes() < 30000);

  OccupancyImage grid = stage.image(map, first);
  CHECK(grid.at({0.6, 0}) == OccupancyImage::kFree);
  CHECK(grid.at({1.01, 0}) == OccupancyImage::kOccupied);
  CHECK(grid.at({0.6, 3}) == OccupancyImage::kUnknown);  // of another map
  CHECK(stage.image(map, second).at({0.6, 3}) == OccupancyImage::kFree);
  // A correction of the map.
  map.set_pose(a, camera_at(-5, 1).inverse());
  grid = stage.image(map, first);
  CHECK(grid.at({0.6, 0}) == OccupancyImage::kUnknown);
  CHECK(grid.at({-4.4, 1}) == OccupancyImage::kFree);

  SECTION("its files are those that map_server takes, with a picture") {
    ScratchFolder folder;
    std::vector<StampedPose> path{{0, SE3d(SO3d(), {-5, 1, 0})}, {1, SE3d(SO3d(), {-4.5, 1, 0})}};
    write_grid_results(folder.path(), grid, path);
    const OccupancyImage back = read_grid(folder / "grid.yaml");
    CHECK(back.at({-4.4, 1}) == OccupancyImage::kFree);
    CHECK(read_gray(folder / "grid.png").view.width >= 8 * back.cells.width());
    write_grid_results(folder.path(), OccupancyImage(), {});
    CHECK(std::filesystem::exists(folder / "grid.png"));
  }
}
