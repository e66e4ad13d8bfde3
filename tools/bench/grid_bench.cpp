// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// A scan of the floor and what it draws. The input is a level camera before a wall with boxes, without noise.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "sweepkit/floor/distance_transform.hpp"
#include "sweepkit/floor/floor_scan.hpp"
#include "sweepkit/floor/occupancy_grid.hpp"
#include "sweepkit/image/image.hpp"

namespace {

using namespace sweepkit;

constexpr int kWidth = 640, kHeight = 400;
const RectifiedCamera kCamera{320.0, 319.5, 199.5, 0.06};
const GroundPlane kPlane{Vec3<double>(0, 1, 0), 0.08};
const Vec3<double> kBase(0, 0.08, -0.1);

Image<std::int16_t> disparities() {
  Image<std::int16_t> image(kWidth, kHeight);
  const FloorDisparity floor = kPlane.disparity(kCamera);
  for (int v = 0; v < kHeight; ++v)
    for (int u = 0; u < kWidth; ++u) {
      double d = std::max(floor(u, v), kCamera.disparity(2.2));
      if (u / 80 % 3 == 1 && v > 190) d = std::max(d, kCamera.disparity(1.0 + 0.1 * (u / 80)));
      image(u, v) = static_cast<std::int16_t>(std::lround(16 * d));
    }
  return image;
}

FloorScan example_scan() {
  const Image<std::int16_t> image = disparities();
  FloorScanner scanner;
  FloorScan scan;
  scanner.scan(View2d<const std::int16_t>(image), kCamera, kPlane, kBase, scan);
  return scan;
}

// The bound: disparities that a scan looks at (one a row of each ray), each read once from the cache.
void BM_scan_sweepkit(benchmark::State& state) {
  const Image<std::int16_t> image = disparities();
  FloorScanner scanner;
  FloorScan scan;
  for (auto _ : state) {
    scanner.scan(View2d<const std::int16_t>(image), kCamera, kPlane, kBase, scan);
    benchmark::DoNotOptimize(scan.stretches.data());
  }
  state.counters["bytes"] = static_cast<double>(scan.bytes());
  state.counters["disparities"] = static_cast<double>(scan.bearings) * kHeight * 0.55;
}
BENCHMARK(BM_scan_sweepkit)->Name("floor/scan/sweepkit")->Unit(benchmark::kMicrosecond);

/// The plain way: every pixel that shows an obstacle or floor draws a line of cells by Bresenham (cv::line
/// draws the same cells; its own sums are of no use, so cells are counted by hand).
void draw_line(int x1, int y1, std::vector<std::int32_t>& cells, int side, std::int32_t free) {
  int x = side / 2, y = side / 2;
  const int dx = std::abs(x1 - x), dy = -std::abs(y1 - y), sx = x < x1 ? 1 : -1, sy = y < y1 ? 1 : -1;
  int error = dx + dy;
  while (x != x1 || y != y1) {
    if (x >= 0 && y >= 0 && x < side && y < side) cells[static_cast<std::size_t>(y) * side + x] += free;
    const int twice = 2 * error;
    if (twice >= dy) {
      error += dy;
      x += sx;
    }
    if (twice <= dx) {
      error += dx;
      y += sy;
    }
  }
}

// Disparities to cells in one go, with a line for each pixel.
void BM_grid_from_pixels(benchmark::State& state) {
  const Image<std::int16_t> image = disparities();
  constexpr int kSide = 160;
  constexpr double kCell = 0.05;
  std::vector<std::int32_t> cells(kSide * kSide);
  for (auto _ : state) {
    for (int v = 0; v < kHeight; ++v)
      for (int u = 0; u < kWidth; ++u) {
        const double d = image(u, v) / 16.0;
        if (d <= 0) continue;
        const double z = kCamera.depth(d), x = (u - kCamera.cx) / kCamera.focal * z;
        const double height = kPlane.height - (v - kCamera.cy) / kCamera.focal * z;
        if (z > 3 || height > 0.1) continue;
        const int cx = kSide / 2 + static_cast<int>(std::floor(x / kCell)),
                  cy = kSide / 2 + static_cast<int>(std::floor(z / kCell));
        draw_line(cx, cy, cells, kSide, -1);
        if (height > 0.016 && cx >= 0 && cy >= 0 && cx < kSide && cy < kSide)
          cells[static_cast<std::size_t>(cy) * kSide + cx] += 3;
      }
    benchmark::DoNotOptimize(cells.data());
  }
}
BENCHMARK(BM_grid_from_pixels)->Name("floor/grid/bresenham_per_pixel")->Unit(benchmark::kMicrosecond);

// From disparities, as the rival.
void BM_grid_sweepkit(benchmark::State& state) {
  const Image<std::int16_t> image = disparities();
  FloorScanner scanner;
  FloorScan scan;
  OccupancyGrid grid;
  const PlanarPose pose{0.013, 0.021, 0.4};
  for (auto _ : state) {
    scanner.scan(View2d<const std::int16_t>(image), kCamera, kPlane, kBase, scan);
    grid.add(scan, pose);
    benchmark::DoNotOptimize(grid.cells().data);
  }
}
BENCHMARK(BM_grid_sweepkit)->Name("floor/grid/sweepkit")->Unit(benchmark::kMicrosecond);

// Drawing a scan that is kept, as after a correction of the map. The bound: cells that its rays cross, each
// voted for once.
void BM_draw_sweepkit(benchmark::State& state) {
  const FloorScan scan = example_scan();
  OccupancyGrid grid;
  const PlanarPose pose{0.013, 0.021, 0.4};
  for (auto _ : state) {
    grid.add(scan, pose);
    grid.remove(scan, pose);
    benchmark::DoNotOptimize(grid.cells().data);
  }
  grid.add(scan, pose);
  const auto view = grid.cells();
  state.counters["cells"] = static_cast<double>(
      view.width * view.height - std::count(view.data, view.data + view.width * view.height, 0));
}
BENCHMARK(BM_draw_sweepkit)->Name("floor/grid_redraw/sweepkit")->Unit(benchmark::kMicrosecond);

GrayImage walls(int side) {
  GrayImage image(side, side);
  for (int y = 0; y < side; ++y)
    for (int x = 0; x < side; ++x) image(x, y) = x % 97 == 0 || y % 83 == 0;
  return image;
}

void BM_distance_sweepkit(benchmark::State& state) {
  const GrayImage marked = walls(static_cast<int>(state.range(0)));
  Image<std::int64_t> squared;
  for (auto _ : state) {
    distance_transform(marked, squared);
    benchmark::DoNotOptimize(squared.row(0));
  }
}
BENCHMARK(BM_distance_sweepkit)->Name("floor/distance/sweepkit")->Arg(400)->Unit(benchmark::kMicrosecond);

// DIST_MASK_PRECISE is exact as well, in float.
void BM_distance_opencv(benchmark::State& state) {
  const int side = static_cast<int>(state.range(0));
  const GrayImage marked = walls(side);
  cv::Mat open(side, side, CV_8U), distance;
  for (int y = 0; y < side; ++y)
    for (int x = 0; x < side; ++x) open.at<std::uint8_t>(y, x) = marked(x, y) ? 0 : 1;
  cv::setNumThreads(1);
  for (auto _ : state) {
    cv::distanceTransform(open, distance, cv::DIST_L2, cv::DIST_MASK_PRECISE);
    benchmark::DoNotOptimize(distance.data);
  }
}
BENCHMARK(BM_distance_opencv)->Name("floor/distance/opencv")->Arg(400)->Unit(benchmark::kMicrosecond);

}  // namespace
