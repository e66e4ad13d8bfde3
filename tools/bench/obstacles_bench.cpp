// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// From a mask to things. The scene: a floor with a wall at 1.5 m and twelve boxes, 640x400, noise of 0.2 px.
// The rival labels the same pixels by connectedness in the image alone (cv::connectedComponentsWithStats, 8
// neighbours): no depth, no size in metres, no boxes on the floor. Bound: disparities, mask and regions once
// through memory at 10 GB/s.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "sweepkit/core/random.hpp"
#include "sweepkit/floor/obstacle_mask.hpp"
#include "sweepkit/floor/obstacle_tracker.hpp"
#include "sweepkit/floor/obstacles.hpp"
#include "sweepkit/image/image.hpp"

namespace {

using namespace sweepkit;

struct Things {
  RectifiedCamera camera{347, 319.5, 199.5, 0.06};
  GroundPlane plane{Vec3<double>(0, std::cos(0.05), std::sin(0.05)), 0.08};
  Image<float> disparity{640, 400};
  GrayImage mask{640, 400};

  Things() {
    Random random(1);
    const FloorDisparity floor = plane.disparity(camera);
    for (int v = 0; v < 400; ++v)
      for (int u = 0; u < 640; ++u) {
        double d = std::max(floor(u, v), camera.disparity(1.5));
        for (int k = 0; k < 12; ++k) {
          const double z = 0.35 + 0.08 * k, left = (k % 4 - 1.5) * 0.2 * z / 0.5;
          const double x = z * (u - camera.cx) / camera.focal, y = z * (v - camera.cy) / camera.focal;
          const double height = plane.height_of({x, y, z});
          if (std::abs(x - left) < 0.03 && height > 0 && height < 0.02 + 0.01 * k)
            d = std::max(d, camera.disparity(z));
        }
        disparity(u, v) = static_cast<float>(d + 0.2 * random.normal());
      }
    obstacle_mask(std::as_const(disparity).view(), floor, FloorTolerance::of({}, plane, camera), mask.view());
  }
  static const Things& get() {
    static const Things things;
    return things;
  }
};

void count(benchmark::State& state, std::size_t things) {
  state.counters["things"] = static_cast<double>(things);
  constexpr double kBytes = 640.0 * 400 * (4 + 1 + 2);
  state.counters["bound_us"] = kBytes / 10e9 * 1e6;
}

void find_things(benchmark::State& state) {
  const Things& s = Things::get();
  ObstacleFinder finder;
  std::size_t things = 0;
  for (auto _ : state) things = finder.find(s.disparity.view(), s.mask.view(), s.camera, s.plane).size();
  count(state, things);
}

void connected_components(benchmark::State& state) {
  const Things& s = Things::get();
  const cv::Mat mask(400, 640, CV_8UC1, const_cast<std::uint8_t*>(s.mask.view().data),
                     static_cast<std::size_t>(s.mask.stride()));
  cv::Mat obstacles, labels, stats, centroids;
  cv::setNumThreads(1);
  int things = 0;
  for (auto _ : state) {
    cv::compare(mask, cv::Scalar(2), obstacles, cv::CMP_EQ);
    things = cv::connectedComponentsWithStats(obstacles, labels, stats, centroids, 8) - 1;
  }
  count(state, static_cast<std::size_t>(things));
}

void track(benchmark::State& state) {
  const Things& s = Things::get();
  ObstacleFinder finder;
  const auto things = finder.find(s.disparity.view(), s.mask.view(), s.camera, s.plane);
  const SE3d T_world_camera = floor_frame(s.plane);
  ObstacleTracker tracker;
  TimeNs t = 0;
  for (auto _ : state)
    tracker.update(t += 100'000'000, things, s.disparity.view(), s.camera, s.plane, T_world_camera);
  state.counters["things"] = static_cast<double>(tracker.tracked().size());
}

BENCHMARK(find_things)->Name("floor/obstacles/sweepkit")->Unit(benchmark::kMicrosecond);
BENCHMARK(connected_components)->Name("floor/obstacles/opencv_components")->Unit(benchmark::kMicrosecond);
BENCHMARK(track)->Name("floor/obstacle_tracking/sweepkit")->Unit(benchmark::kMicrosecond);

}  // namespace
