// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// Cameras, rectification of points and motions. One iteration of a rectify benchmark treats as many points on
// both sides of EuRoC's rig; `per_point` is the time of one point.
#include <benchmark/benchmark.h>

#include <opencv2/calib3d.hpp>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/geometry/sim3.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"

namespace sweepkit {
namespace {

struct Position {
  float x, y;
};

const StereoRig& euroc() {
  static const StereoRig rig = [] {
    Eigen::Matrix4d T_body_left, T_body_right;
    T_body_left << 0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975,  //
        0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768,                 //
        -0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949,             //
        0.0, 0.0, 0.0, 1.0;
    T_body_right << 0.0125552670891, -0.999755099723, 0.0182237714554, -0.0198435579556,  //
        0.999598781151, 0.0130119051815, 0.0251588363115, 0.0453689425024,                //
        -0.0253898008918, 0.0179005838253, 0.999517347078, 0.00786212447038,              //
        0.0, 0.0, 0.0, 1.0;
    return StereoRig(Camera({458.654, 457.296, 367.215, 248.375}, Distortion::radial_tangential,
                            {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05}, 752, 480),
                     Camera({457.587, 456.134, 379.999, 255.238}, Distortion::radial_tangential,
                            {-0.28368365, 0.07451284, -0.00010473, -3.55590700e-05}, 752, 480),
                     T_body_left, T_body_right);
  }();
  return rig;
}

std::vector<Position> pixels(std::size_t count) {
  Random random(1);
  std::vector<Position> result(count);
  for (Position& p : result)
    p = {static_cast<float>(random.uniform(0, 751)), static_cast<float>(random.uniform(0, 479))};
  return result;
}

void per_point(benchmark::State& state, double points) {
  state.counters["per_point"] =
      benchmark::Counter(points, benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

void rectify(benchmark::State& state) {
  const StereoRig& rig = euroc();
  const std::vector<Position> points = pixels(state.range(0));
  std::vector<Vec2<float>> rectified(points.size());
  std::vector<std::uint8_t> valid(points.size());
  for (auto _ : state) {
    for (const Side side : {Side::left, Side::right}) {
      benchmark::DoNotOptimize(rig.rectify(side, points, rectified, valid));
      benchmark::ClobberMemory();
    }
  }
  per_point(state, 2.0 * points.size());
  double worst = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto exact = rig.rectify(Side::right, Vec2<double>(points[i].x, points[i].y));
    worst = std::max(worst, (rectified[i].cast<double>() - *exact).norm());
  }
  state.counters["worst_error_px"] = worst;
  // Two cubics in two variables by Horner's rule are 18 multiplications and 18 additions; one of each a cycle
  // at 2.6 GHz makes 7 ns.
  state.counters["bound_ns_per_point"] = 7;
}
BENCHMARK(rectify)->Name("geometry/rectify/sweepkit")->Arg(1000);

void rectify_exact(benchmark::State& state) {
  const StereoRig& rig = euroc();
  const std::vector<Position> points = pixels(state.range(0));
  for (auto _ : state)
    for (const Side side : {Side::left, Side::right})
      for (const Position& p : points) benchmark::DoNotOptimize(rig.rectify(side, Vec2<double>(p.x, p.y)));
  per_point(state, 2.0 * points.size());
}
BENCHMARK(rectify_exact)->Name("geometry/rectify/sweepkit_exact")->Arg(1000);

// With five fixed-point steps, its default: what others call undistorting key points.
void rectify_opencv(benchmark::State& state) {
  const StereoRig& rig = euroc();
  const std::vector<Position> points = pixels(state.range(0));
  std::vector<cv::Point2f> input, output;
  for (const Position& p : points) input.emplace_back(p.x, p.y);
  cv::Matx33d K[2], R[2];
  const cv::Matx33d P(rig.focal(), 0, rig.center().x(), 0, rig.focal(), rig.center().y(), 0, 0, 1);
  for (const Side side : {Side::left, Side::right}) {
    const int s = static_cast<int>(side);
    const Camera& c = rig.camera(side);
    K[s] = {c.fx(), 0, c.cx(), 0, c.fy(), c.cy(), 0, 0, 1};
    for (int i = 0; i < 9; ++i) R[s](i / 3, i % 3) = rig.R_camera_raw(side)(i / 3, i % 3);
  }
  for (auto _ : state) {
    for (const Side side : {Side::left, Side::right}) {
      const int s = static_cast<int>(side);
      cv::undistortPoints(input, output, K[s], rig.camera(side).coefficients(), R[s], P);
      benchmark::ClobberMemory();
    }
  }
  per_point(state, 2.0 * points.size());
  double worst = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto exact = rig.rectify(Side::right, Vec2<double>(points[i].x, points[i].y));
    worst = std::max(worst, (Vec2<double>(output[i].x, output[i].y) - *exact).norm());
  }
  state.counters["worst_error_px"] = worst;
}
BENCHMARK(rectify_opencv)->Name("geometry/rectify/opencv")->Arg(1000);

void unrectify(benchmark::State& state) {
  const StereoRig& rig = euroc();
  const std::vector<Position> points = pixels(state.range(0));
  for (auto _ : state)
    for (const Side side : {Side::left, Side::right})
      for (const Position& p : points)
        benchmark::DoNotOptimize(rig.unrectify_fast(side, Vec2<float>(p.x, p.y)));
  per_point(state, 2.0 * points.size());
}
BENCHMARK(unrectify)->Name("geometry/unrectify/sweepkit")->Arg(1000);

void make_rig(benchmark::State& state) {
  const StereoRig& rig = euroc();
  for (auto _ : state)
    benchmark::DoNotOptimize(StereoRig(rig.camera(Side::left), rig.camera(Side::right),
                                       rig.T_body_raw(Side::left), rig.T_body_raw(Side::right)));
  state.counters["table_bytes"] =
      static_cast<double>(rig.table(Side::left).bytes() + rig.table(Side::right).bytes());
}
BENCHMARK(make_rig)->Name("geometry/make_rig/sweepkit")->Unit(benchmark::kMillisecond);

std::vector<Vec3<double>> rays(std::size_t count) {
  std::vector<Vec3<double>> result;
  for (const Position& p : pixels(count))
    result.push_back(3.0 * *euroc().camera(Side::left).unproject(Vec2<double>(p.x, p.y)));
  return result;
}

void project(benchmark::State& state) {
  const Camera& camera = euroc().camera(Side::left);
  const std::vector<Vec3<double>> points = rays(state.range(0));
  Eigen::Matrix<double, 2, 3> J;
  for (auto _ : state)
    for (const Vec3<double>& p : points) {
      benchmark::DoNotOptimize(camera.project(p, &J));
      benchmark::DoNotOptimize(J);
    }
  per_point(state, static_cast<double>(points.size()));
}
BENCHMARK(project)->Name("geometry/project_with_jacobian/sweepkit")->Arg(1000);

void project_opencv(benchmark::State& state) {
  const Camera& camera = euroc().camera(Side::left);
  std::vector<cv::Point3d> points;
  for (const Vec3<double>& p : rays(state.range(0))) points.emplace_back(p.x(), p.y(), p.z());
  std::vector<cv::Point2d> output;
  cv::Mat J;
  const cv::Matx33d K(camera.fx(), 0, camera.cx(), 0, camera.fy(), camera.cy(), 0, 0, 1);
  const cv::Vec3d zero(0, 0, 0);
  for (auto _ : state) {
    cv::projectPoints(points, zero, zero, K, camera.coefficients(), output, J);
    benchmark::ClobberMemory();
  }
  per_point(state, static_cast<double>(points.size()));
}
BENCHMARK(project_opencv)->Name("geometry/project_with_jacobian/opencv")->Arg(1000);

void se3_exp_log(benchmark::State& state) {
  Vec6<double> xi;
  xi << 1, 2, 3, 0.4, -0.5, 0.6;
  for (auto _ : state) {
    benchmark::DoNotOptimize(xi);
    benchmark::DoNotOptimize(SE3d::exp(xi).log());
  }
}
BENCHMARK(se3_exp_log)->Name("geometry/se3_exp_log/sweepkit");

void sim3_left_jacobian(benchmark::State& state) {
  Vec7<double> xi;
  xi << 1, 2, 3, 0.4, -0.5, 0.6, 0.1;
  for (auto _ : state) {
    benchmark::DoNotOptimize(xi);
    benchmark::DoNotOptimize(Sim3d::left_jacobian(xi));
  }
}
BENCHMARK(sim3_left_jacobian)->Name("geometry/sim3_left_jacobian/sweepkit");

}  // namespace
}  // namespace sweepkit
