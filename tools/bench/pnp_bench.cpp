// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0

// Poses from points: P3P on random triangles, PnP on 300 matches with outliers, against OpenCV in the same
// run on the same input. `poses` counts the solutions of a call, `bad` the share of calls whose best pose is
// off (P3P: by more than 1e-6; PnP: by more than 2 cm or 0.3 degrees). Small random samples decide how long a
// search takes, so PnP goes round 64 problems.
#include <benchmark/benchmark.h>

#include <array>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/core/utility.hpp>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/geometry/p3p.hpp"
#include "sweepkit/geometry/pnp.hpp"

namespace {

using sweepkit::Random;
using sweepkit::SE3d;
using sweepkit::SO3d;
using Vec2d = sweepkit::Vec2<double>;
using Vec3d = sweepkit::Vec3<double>;

constexpr double kFocal = 400.0;

struct Triangle {
  SE3d T_camera_world;
  std::array<Vec3d, 3> points, bearings;
  std::vector<cv::Point3d> cv_points;
  std::vector<cv::Point2d> cv_rays;
};

const std::vector<Triangle>& triangles() {
  static const std::vector<Triangle> all = [] {
    std::vector<Triangle> made(1000);
    Random random(1);
    for (auto& triangle : made) {
      const Eigen::Quaterniond q(random.normal(), random.normal(), random.normal(), random.normal());
      triangle.T_camera_world = SE3d(SO3d(q), Vec3d(random.normal(), random.normal(), random.normal()));
      for (std::size_t i = 0; i < 3; ++i) {
        const Vec3d ray(random.uniform(-1, 1), random.uniform(-1, 1), 1.0);
        const Vec3d p = triangle.T_camera_world.inverse() * Vec3d(random.uniform(0.1, 10.0) * ray);
        triangle.points[i] = p;
        triangle.bearings[i] = ray.normalized();
        triangle.cv_points.emplace_back(p.x(), p.y(), p.z());
        triangle.cv_rays.emplace_back(ray.x(), ray.y());
      }
    }
    return made;
  }();
  return all;
}

double error_of(const SE3d& truth, const SE3d& T) {
  const SE3d error = truth * T.inverse();
  return error.rotation().angle() + error.translation().norm();
}

SE3d from_opencv(const cv::Mat& rotation_vector, const cv::Mat& translation) {
  const auto vector_of = [](const cv::Mat& m) {
    return Vec3d(m.at<double>(0), m.at<double>(1), m.at<double>(2));
  };
  return {SO3d::exp(vector_of(rotation_vector)), vector_of(translation)};
}

void p3p_sweepkit(benchmark::State& state) {
  const auto& all = triangles();
  std::size_t i = 0;
  std::int64_t poses = 0;
  std::array<SE3d, 4> found;
  for (auto _ : state) {
    const auto& triangle = all[i++ % all.size()];
    poses += sweepkit::solve_p3p(triangle.points, triangle.bearings, found);
    benchmark::DoNotOptimize(found);
  }
  int bad = 0;
  for (const auto& triangle : all) {
    const int count = sweepkit::solve_p3p(triangle.points, triangle.bearings, found);
    bool good = false;
    for (int k = 0; k < count; ++k)
      good = good || error_of(triangle.T_camera_world, found[static_cast<std::size_t>(k)]) < 1e-6;
    bad += !good;
  }
  state.counters["poses"] = static_cast<double>(poses) / static_cast<double>(state.iterations());
  state.counters["bad"] = bad / static_cast<double>(all.size());
}

void p3p_opencv(benchmark::State& state, int method) {
  const auto& all = triangles();
  std::size_t i = 0;
  std::int64_t poses = 0;
  const cv::Mat K = cv::Mat::eye(3, 3, CV_64F);
  std::vector<cv::Mat> rotations, translations;
  for (auto _ : state) {
    const auto& triangle = all[i++ % all.size()];
    poses +=
        cv::solveP3P(triangle.cv_points, triangle.cv_rays, K, cv::noArray(), rotations, translations, method);
    benchmark::DoNotOptimize(rotations);
  }
  int bad = 0;
  for (const auto& triangle : all) {
    const int count =
        cv::solveP3P(triangle.cv_points, triangle.cv_rays, K, cv::noArray(), rotations, translations, method);
    bool good = false;
    for (std::size_t k = 0; k < static_cast<std::size_t>(count); ++k)
      good = good || error_of(triangle.T_camera_world, from_opencv(rotations[k], translations[k])) < 1e-6;
    bad += !good;
  }
  state.counters["poses"] = static_cast<double>(poses) / static_cast<double>(state.iterations());
  state.counters["bad"] = bad / static_cast<double>(all.size());
}

struct View {
  SE3d T_world_camera;
  std::vector<Vec3d> points;
  std::vector<Vec2d> rays;
  std::vector<cv::Point3d> cv_points;
  std::vector<cv::Point2d> cv_pixels;
};

/// 64 views of 300 points with noise of half a pixel.
std::vector<View> make_views(double outlier_share) {
  std::vector<View> views(64);
  Random random(2);
  for (auto& view : views) {
    const Vec3d phi(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    view.T_world_camera = SE3d(SO3d::exp(phi), Vec3d(random.normal(), random.normal(), random.normal()));
    for (int i = 0; i < 300; ++i) {
      const Vec2d ray(random.uniform(-0.8, 0.8), random.uniform(-0.5, 0.5));
      const Vec3d p = view.T_world_camera * Vec3d(random.uniform(1.0, 8.0) * ray.homogeneous());
      const Vec2d seen = random.uniform() < outlier_share
                             ? Vec2d(random.uniform(-0.8, 0.8), random.uniform(-0.5, 0.5))
                             : Vec2d(ray + 0.5 / kFocal * Vec2d(random.normal(), random.normal()));
      view.points.push_back(p);
      view.rays.push_back(seen);
      view.cv_points.emplace_back(p.x(), p.y(), p.z());
      view.cv_pixels.emplace_back(kFocal * seen.x() + 320.0, kFocal * seen.y() + 200.0);
    }
  }
  return views;
}

bool is_bad(const View& view, const SE3d& T_world_camera) {
  const SE3d error = view.T_world_camera.inverse() * T_world_camera;
  return error.translation().norm() > 0.02 || error.rotation().angle() > 0.005;
}

void pnp_sweepkit(benchmark::State& state) {
  const auto views = make_views(static_cast<double>(state.range(0)) / 100.0);
  const auto solve = [](const View& view) {
    sweepkit::PnpMatches matches;
    matches.points = view.points;
    matches.rays = view.rays;
    matches.focal = kFocal;
    return sweepkit::solve_pnp(matches);
  };
  std::size_t i = 0;
  for (auto _ : state) benchmark::DoNotOptimize(solve(views[i++ % views.size()]));
  int bad = 0;
  std::size_t inliers = 0, samples = 0;
  for (const auto& view : views) {
    const auto found = solve(view);
    bad += !found || is_bad(view, found->T_world_camera);
    if (found) {
      inliers += found->inliers.size();
      samples += static_cast<std::size_t>(found->iterations);
    }
  }
  state.counters["bad"] = bad / static_cast<double>(views.size());
  state.counters["inliers"] = static_cast<double>(inliers) / static_cast<double>(views.size());
  state.counters["samples"] = static_cast<double>(samples) / static_cast<double>(views.size());
}

constexpr int kUsac = -1;

/// One thread, the same threshold and confidence; `method` is the solver of the samples and of the end, or
/// kUsac for OpenCV's newer search.
void pnp_opencv(benchmark::State& state, int method) {
  cv::setNumThreads(1);
  const auto views = make_views(static_cast<double>(state.range(0)) / 100.0);
  const cv::Mat K = (cv::Mat_<double>(3, 3) << kFocal, 0, 320, 0, kFocal, 200, 0, 0, 1);
  cv::Mat rotation, translation;
  std::vector<int> chosen;
  cv::UsacParams usac;
  usac.confidence = 0.999;
  usac.maxIterations = 500;
  usac.threshold = 2.5;
  const auto solve = [&](const View& view) {
    if (method == kUsac) {
      cv::Mat own_K = K;  // an output too
      return cv::solvePnPRansac(view.cv_points, view.cv_pixels, own_K, cv::noArray(), rotation, translation,
                                chosen, usac);
    }
    return cv::solvePnPRansac(view.cv_points, view.cv_pixels, K, cv::noArray(), rotation, translation, false,
                              500, 2.5f, 0.999, chosen, method);
  };
  std::size_t i = 0;
  for (auto _ : state) benchmark::DoNotOptimize(solve(views[i++ % views.size()]));
  int bad = 0;
  std::size_t inliers = 0;
  for (const auto& view : views) {
    const bool found = solve(view);
    bad += !found || is_bad(view, from_opencv(rotation, translation).inverse());
    inliers += chosen.size();
  }
  state.counters["bad"] = bad / static_cast<double>(views.size());
  state.counters["inliers"] = static_cast<double>(inliers) / static_cast<double>(views.size());
}

BENCHMARK(p3p_sweepkit)->Name("geometry/p3p/sweepkit");
BENCHMARK_CAPTURE(p3p_opencv, gao, cv::SOLVEPNP_P3P)->Name("geometry/p3p/opencv");
BENCHMARK_CAPTURE(p3p_opencv, ke, cv::SOLVEPNP_AP3P)->Name("geometry/p3p/opencv_ap3p");
BENCHMARK(pnp_sweepkit)
    ->Name("geometry/pnp_300_matches/sweepkit")
    ->Arg(30)
    ->Arg(50)
    ->Arg(70)
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(pnp_opencv, p3p, cv::SOLVEPNP_P3P)
    ->Name("geometry/pnp_300_matches/opencv_p3p")
    ->Arg(30)
    ->Arg(50)
    ->Arg(70)
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(pnp_opencv, ap3p, cv::SOLVEPNP_AP3P)
    ->Name("geometry/pnp_300_matches/opencv_ap3p")
    ->Arg(30)
    ->Arg(50)
    ->Arg(70)
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(pnp_opencv, usac, kUsac)
    ->Name("geometry/pnp_300_matches/opencv_usac")
    ->Arg(30)
    ->Arg(50)
    ->Arg(70)
    ->Unit(benchmark::kMicrosecond);

}  // namespace
