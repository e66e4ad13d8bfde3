// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// The ground plane of a 640x400 disparity image: a floor with boxes on it, noise of 0.4 px, a tenth of the
// pixels unknown. Rivals on the same pixels of the same image: RANSAC on the points in space (200 planes
// through three points, a gate of 5 mm, least squares on the inliers), and least squares on the disparities
// of all pixels below the horizon by cv::solve, which boxes pull away.
//
// The counter bound_ms holds what scoring the hypotheses for one surface costs at least: 129 planes on 768
// pixels, 8 operations each, at 16 operations a cycle (two SSE units of four) and 4 GHz; and reading the rows
// that are looked at, 64 bytes a cycle.
#include <benchmark/benchmark.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/floor/ground_plane_estimator.hpp"

namespace {

using namespace sweepkit;

constexpr int kWidth = 640, kHeight = 400, kStepU = 8, kStepV = 4;
const RectifiedCamera kCamera{350, 320, 200, 0.06};

struct FloorScene {
  GroundPlane plane{Vec3<double>(0.01, 1, 0.05).normalized(), 0.08};
  std::vector<std::int16_t> sixteenths;

  FloorScene() {
    const FloorDisparity floor = plane.disparity(kCamera);
    Random random(1);
    for (int v = 0; v < kHeight; ++v)
      for (int u = 0; u < kWidth; ++u) {
        const bool box = (u / 50 + v / 60) % 3 == 0;
        double d = std::max(floor(u, v), 8.0) + (box ? 20 : 0) + random.normal(0, 0.4);
        if (d > 128 || random.index(10) == 0) d = 0;
        sixteenths.push_back(static_cast<std::int16_t>(std::lround(16 * d)));
      }
  }
  static const FloorScene& get() {
    static const FloorScene scene;
    return scene;
  }
  View2d<const std::int16_t> view() const { return {sixteenths.data(), kWidth, kHeight}; }
};

void report(benchmark::State& state, const GroundPlane& found) {
  const GroundPlane& truth = FloorScene::get().plane;
  state.counters["pitch_error_deg"] = (pitch_down(found) - pitch_down(truth)) * 57.29578;
  state.counters["height_error_mm"] = 1e3 * (found.height - truth.height);
}

void sweepkit_plane(benchmark::State& state) {
  const FloorScene& scene = FloorScene::get();
  GroundPlaneEstimator estimator(kCamera, GroundPlaneSeed::from_height({0, 1, 0.045}, 0.0805));
  GroundPlaneResult result;
  for (auto _ : state) {
    result = estimator.estimate(scene.view());
    benchmark::DoNotOptimize(result);
  }
  report(state, result.plane);
  const double cycles = 129 * 768 * 8 / 16.0 + kWidth * 2.0 * kHeight / kStepV / 64;
  state.counters["bound_ms"] = cycles / 4e6;
}
BENCHMARK(sweepkit_plane)->Name("floor/ground_plane/sweepkit/640x400")->Unit(benchmark::kMillisecond);

void ransac_on_points(benchmark::State& state) {
  const FloorScene& scene = FloorScene::get();
  std::vector<Vec3<double>> points, inliers;
  GroundPlane found;
  for (auto _ : state) {
    points.clear();
    for (int v = kStepV / 2; v < kHeight; v += kStepV)
      for (int u = kStepU / 2; u < kWidth; u += kStepU) {
        const double d = scene.view()(u, v) / 16.0;
        if (d <= 0) continue;
        const double z = kCamera.depth(d);
        points.emplace_back(z * (u - kCamera.cx) / kCamera.focal, z * (v - kCamera.cy) / kCamera.focal, z);
      }
    Random random(1);
    int most = 0;
    for (int k = 0; k < 200; ++k) {
      const Vec3<double>&a = points[random.index(points.size())], &b = points[random.index(points.size())],
            &c = points[random.index(points.size())];
      Vec3<double> n = (b - a).cross(c - a);
      if (n.norm() < 1e-9) continue;
      n.normalize();
      if (n.y() < 0) n = -n;
      int count = 0;
      for (const auto& p : points) count += std::abs(n.dot(p - a)) < 0.005;
      if (count > most) {
        most = count;
        found = {n, n.dot(a)};
      }
    }
    Vec3<double> mean = Vec3<double>::Zero();
    inliers.clear();
    for (const auto& p : points)
      if (std::abs(found.height_of(p)) < 0.005) {
        inliers.push_back(p);
        mean += p;
      }
    mean /= static_cast<double>(inliers.size());
    Mat3<double> scatter = Mat3<double>::Zero();
    for (const auto& p : inliers) scatter += (p - mean) * (p - mean).transpose();
    Vec3<double> n = Eigen::SelfAdjointEigenSolver<Mat3<double>>(scatter).eigenvectors().col(0);
    if (n.y() < 0) n = -n;
    found = {n, n.dot(mean)};
    benchmark::DoNotOptimize(found);
  }
  report(state, found);
}
BENCHMARK(ransac_on_points)
    ->Name("floor/ground_plane/ransac_on_points/640x400")
    ->Unit(benchmark::kMillisecond);

void opencv_least_squares(benchmark::State& state) {
  cv::setNumThreads(1);
  const FloorScene& scene = FloorScene::get();
  GroundPlane found;
  for (auto _ : state) {
    cv::Mat rows(0, 3, CV_64F), values(0, 1, CV_64F);
    for (int v = 220; v < kHeight; v += kStepV)
      for (int u = kStepU / 2; u < kWidth; u += kStepU) {
        const double d = scene.view()(u, v) / 16.0;
        if (d <= 0) continue;
        rows.push_back(cv::Mat(cv::Matx13d(u, v, 1)));
        values.push_back(d);
      }
    cv::Mat x;
    cv::solve(rows, values, x, cv::DECOMP_SVD);
    found = GroundPlane::of({x.at<double>(2), x.at<double>(0), x.at<double>(1)}, kCamera);
    benchmark::DoNotOptimize(found);
  }
  report(state, found);
}
BENCHMARK(opencv_least_squares)
    ->Name("floor/ground_plane/opencv_least_squares/640x400")
    ->Unit(benchmark::kMillisecond);

}  // namespace
