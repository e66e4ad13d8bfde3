// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// grid_accuracy [--every N] [--pictures DIR] [--calibrated] [--3way] [--ramp] RECORDING...: the occupancy
// grid against the truth, from every Nth pair of images at their true poses: disparity, ground plane, scan,
// grid. A recording needs true poses, wheels (where the robot's base is) and floor_occupancy.yaml. Free space
// and walls are counted as `evaluate
// --grid` does; the columns say within which distance of the camera the floor was visible. Left out are
// images that are dark (mean below 12) and those on which the plane was refused. --calibrated takes the
// floor's plane from the calibration instead of estimating it; --3way matches by the quicker kind of SGBM,
// --ramp with the floor's ramp of disparities.

#include <fmt/format.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/data/grid_evaluation.hpp"
#include "sweepkit/data/image_file.hpp"
#include "sweepkit/floor/drivable_area.hpp"
#include "sweepkit/floor/floor_map.hpp"
#include "sweepkit/floor/grid_file.hpp"
#include "sweepkit/floor/ground_plane_estimator.hpp"
#include "sweepkit/image/dense_disparity.hpp"

namespace {

using namespace sweepkit;
namespace fs = std::filesystem;

constexpr double kDark = 12.0;  // mean grey level

double mean_of(GrayView image) {
  double sum = 0.0;
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) sum += image(x, y);
  return sum / (static_cast<double>(image.width) * image.height);
}

double seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// The truth, what was not visible of the floor in light grey, and beside it the grid in the truth's cells.
GrayImage picture(const OccupancyImage& grid, const OccupancyImage& truth, const GrayImage& visible) {
  constexpr int kScale = 3, kGap = 4;
  const int width = truth.cells.width(), height = truth.cells.height();
  GrayImage both((2 * width + kGap) * kScale, height * kScale);
  both.fill(255);
  for (int y = 0; y < height * kScale; ++y)
    for (int x = 0; x < width * kScale; ++x) {
      const int u = x / kScale, v = y / kScale;
      const std::uint8_t is = truth.cells(u, v), said = grid.at(truth.centre_of(u, v));
      both(x, y) = is == OccupancyImage::kFree && !visible(u, v) ? 230 : is;
      both((width + kGap) * kScale + x, y) = said;
    }
  return both;
}

struct Settings {
  int every = 2;
  std::string pictures;
  bool calibrated = false;
  bool quick = false;
  bool ramp = false;
};

void evaluate(const fs::path& folder, const Settings& settings) {
  RecordingOptions selection;
  selection.use_imu = true;  // the body frame is the IMU's
  const auto recording = open_recording(folder, selection);
  if (!recording->rig().wheels) throw Error(ErrorKind::data, folder.string(), "has no wheels");
  const StereoRig rig = recording->rig().stereo();
  const Trajectory truth = read_trajectory(folder);
  const OccupancyImage true_map = read_grid(folder / "floor_occupancy.yaml");
  const SE3d T_base_camera = recording->rig().wheels->T_body_base.inverse() * rig.T_body_camera();

  DisparityOptions matching;
  if (settings.quick) matching.method = DisparityMethod::sgbm_3way;
  StereoDisparity stereo(rig, matching);
  const GroundPlaneSeed seed = GroundPlaneSeed::from_base(T_base_camera);
  GroundPlaneEstimator estimator(stereo.camera(), seed);
  GroundPlane expected = seed.plane;
  FloorScanner scanner;
  FloorMap map;
  const Vec3<double> base_camera = T_base_camera.inverse().translation();
  std::uint32_t frame = 0;
  int used = 0, refused = 0, dark = 0;
  double scan_time = 0.0, grid_time = 0.0;
  std::optional<SE3d> T_world_before;
  TimeNs before = 0;
  Vec2<double> last = Vec2<double>::Zero();
  while (const auto sample = recording->next()) {
    const auto* image = std::get_if<StereoImage>(&*sample);
    if (!image || image->left.empty() || image->right.empty() ||
        frame++ % static_cast<unsigned>(settings.every))
      continue;
    const auto T_world_body = interpolate(truth, image->t);
    if (!T_world_body) continue;
    if (mean_of(image->left.view) < kDark) {
      ++dark;
      continue;
    }
    const SE3d T_world_camera = *T_world_body * rig.T_body_camera();
    GroundPlaneStep step;
    if (T_world_before) {
      step.seconds = to_seconds(image->t - before);
      step.motion = GroundPlaneStep::Motion{T_world_camera.inverse() * *T_world_before,
                                            1e-6 * Mat6<double>::Identity()};
    }
    T_world_before = T_world_camera;
    before = image->t;
    DisparityRamp ramp;
    if (settings.ramp) ramp = expected.disparity(stereo.camera()).ramp(stereo.camera().cx);
    const DisparityView disparity = stereo.match(image->left.view, image->right.view, ramp);
    GroundPlaneResult plane;
    plane.plane = seed.plane;
    if (!settings.calibrated) plane = estimator.estimate(disparity, step);
    expected = plane.plane;
    if (plane.state == GroundPlaneState::refused) {
      ++refused;
      continue;
    }
    FloorScan scan;
    double start = seconds();
    scanner.scan(disparity, stereo.camera(), plane.plane, base_camera, scan);
    scan_time += seconds() - start;
    map.add({frame}, camera_from_scan(plane.plane), std::move(scan));
    map.set_pose({frame}, T_world_camera);
    start = seconds();
    map.update();
    grid_time += seconds() - start;
    last = (T_world_camera * base_camera).head<2>();
    ++used;
  }
  const OccupancyImage grid = map.image();
  const std::vector<FloorView> views = floor_views(*recording, truth);
  fmt::print("{}: {} scans of {:.1f} kB, {} refused, {} dark; {:.2f} ms a scan, {:.2f} ms to draw it\n",
             folder.filename().string(), used, 1e-3 * static_cast<double>(map.bytes()) / std::max(used, 1),
             refused, dark, 1e3 * scan_time / std::max(used, 1), 1e3 * grid_time / std::max(used, 1));
  fmt::print("{:>10}{:>8}{:>9}{:>11}{:>14}{:>14}\n", "within", "IoU", "recall", "precision", "walls right",
             "walls found");
  for (const double range : {1.5, 2.0, 2.5, 3.0}) {
    GridEvaluationOptions options;
    options.max_range = range;
    const GridEvaluation e = evaluate_grid(grid, true_map, {}, views, options);
    fmt::print("{:>8.1f} m{:>8.3f}{:>9.3f}{:>11.3f}{:>14.3f}{:>14.3f}\n", range, e.iou(), e.recall(),
               e.precision(), e.right_wall_share(), e.found_wall_share());
  }
  const DrivableArea drivable = drivable_area(grid, last, 0.17), truly = drivable_area(true_map, last, 0.17);
  fmt::print("a robot of 0.17 m can sweep {:.2f} m2 by the grid, {:.2f} m2 by the whole truth\n\n",
             drivable.covered_m2, truly.covered_m2);
  if (!settings.pictures.empty())
    write_png(fs::path(settings.pictures) / ("grid_" + folder.filename().string() + ".png"),
              picture(grid, true_map, visible_floor(true_map, views)));
}

}  // namespace

int main(int argc, char** argv) {
  Settings settings;
  std::vector<std::string> recordings;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    if (word == "--every" && i + 1 < argc)
      settings.every = std::max(1, std::atoi(argv[++i]));
    else if (word == "--pictures" && i + 1 < argc)
      settings.pictures = argv[++i];
    else if (word == "--calibrated")
      settings.calibrated = true;
    else if (word == "--3way")
      settings.quick = true;
    else if (word == "--ramp")
      settings.ramp = true;
    else
      recordings.push_back(word);
  }
  if (recordings.empty()) {
    fmt::print(
        stderr,
        "usage: grid_accuracy [--every N] [--pictures DIR] [--calibrated] [--3way] [--ramp] RECORDING...\n");
    return 2;
  }
  try {
    for (const std::string& recording : recordings) evaluate(recording, settings);
  } catch (const Error& error) {
    fmt::print(stderr, "grid_accuracy: {}\n", error.what());
    return 3;
  }
}
