// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Directions from segments that are given: a seeded view of 300 segments, half of them running anywhere.
// The rival takes the plain way, RANSAC over three-segment samples (two for the first direction, one for the
// second) with as many samples as find three clean segments with 99.9 % certainty, each scored on all
// segments.
#include <benchmark/benchmark.h>

#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/direction/main_direction.hpp"

namespace {

using namespace sweepkit;

constexpr double kDegree = std::numbers::pi / 180;

struct View {
  Camera camera{{400, 400, 320, 200}, Distortion::none, {}, 640, 400};
  SO3d R = SO3d::exp(Vec3<double>(0.05, 0.4, 0.02));
  std::vector<LineSegment> segments;
  std::vector<InterpretationPlane> planes;

  static const View& get() {
    static const View view;
    return view;
  }

 private:
  View() {
    Random random(1);
    while (segments.size() < 300) {
      const Vec3<double> anywhere(random.normal(), random.normal(), random.normal());
      const Vec3<double> d = segments.size() % 2
                                 ? anywhere.normalized()
                                 : Vec3<double>(R.matrix().col(static_cast<int>(random.index(3))));
      const Vec3<double> middle(random.uniform(-3, 3), random.uniform(-2, 2), random.uniform(1, 6));
      const Vec3<double> half = random.uniform(0.1, 0.8) * d;
      const auto a = camera.project(Vec3<double>(middle - half)),
                 b = camera.project(Vec3<double>(middle + half));
      if (!a || !b || (*a - *b).norm() < 18) continue;
      const auto noisy = [&](double x) { return static_cast<float>(x + random.normal(0, 0.4)); };
      segments.push_back({noisy(a->x()), noisy(a->y()), noisy(b->x()), noisy(b->y())});
    }
    interpretation_planes(camera, segments, {}, planes);
  }
};

void count(benchmark::State& state, const std::optional<SO3d>& R) {
  state.counters["segments"] = static_cast<double>(View::get().planes.size());
  state.counters["error_deg"] = R ? manhattan_distance(*R, View::get().R) / kDegree : 90.0;
}

void planes_sweepkit(benchmark::State& state) {
  const View& view = View::get();
  std::vector<InterpretationPlane> planes;
  for (auto _ : state) {
    interpretation_planes(view.camera, view.segments, {}, planes);
    benchmark::DoNotOptimize(planes.data());
  }
}
BENCHMARK(planes_sweepkit)->Name("direction/planes/sweepkit/300");

void manhattan_sweepkit(benchmark::State& state) {
  ManhattanEstimator estimator;
  std::optional<ManhattanFrame> frame;
  for (auto _ : state) benchmark::DoNotOptimize(frame = estimator.estimate(View::get().planes));
  count(state, frame ? std::optional(frame->R_camera_manhattan) : std::nullopt);
  // The hypotheses alone, each against each segment once: what no consensus of this kind can avoid.
  state.counters["bound_evaluations"] =
      static_cast<double>(estimator.options().hypotheses) * static_cast<double>(View::get().planes.size());
}
BENCHMARK(manhattan_sweepkit)->Name("direction/manhattan/sweepkit/300");

void manhattan_with_up(benchmark::State& state) {
  ManhattanEstimator estimator;
  const Vec3<double> up = -View::get().R.matrix().col(1);
  std::optional<ManhattanFrame> frame;
  for (auto _ : state) benchmark::DoNotOptimize(frame = estimator.estimate(View::get().planes, up));
  count(state, frame ? std::optional(frame->R_camera_manhattan) : std::nullopt);
}
BENCHMARK(manhattan_with_up)->Name("direction/manhattan_up/sweepkit/300");

void manhattan_ransac(benchmark::State& state) {
  const auto& planes = View::get().planes;
  const double model = 0.5 * kDegree, reach2 = 9;
  // A third of the clean half runs along each direction: two of one and one of another.
  const double clean = 0.5 * 0.5 * 0.5 * (1.0 / 3) * (2.0 / 3);
  const int samples = static_cast<int>(std::log(1e-3) / std::log1p(-clean));
  std::optional<SO3d> best_frame;
  for (auto _ : state) {
    Random random(1);
    double best = 0;
    for (int k = 0; k < samples; ++k) {
      std::array<int, 3> s{};
      random.sample(planes.size(), std::span<int>(s));
      Mat3<double> D;
      D.col(0) = planes[s[0]].normal.cross(planes[s[1]].normal).normalized();
      D.col(1) = D.col(0).cross(planes[s[2]].normal).normalized();
      D.col(2) = D.col(0).cross(D.col(1));
      if (!D.allFinite()) continue;
      double score = 0;
      for (const InterpretationPlane& p : planes) {
        double z2 = reach2;
        for (int a = 0; a < 3; ++a) {
          const double r = p.normal.dot(D.col(a));
          z2 = std::min(z2, r * r / (p.variance(D.col(a)) + model * model));
        }
        score += 1 - z2 / reach2;
      }
      if (score > best) {
        best = score;
        best_frame = SO3d(D);
      }
    }
    benchmark::DoNotOptimize(best);
  }
  count(state, best_frame);
  state.counters["samples"] = samples;
}
BENCHMARK(manhattan_ransac)->Name("direction/manhattan/ransac/300");

void vanishing_points_sweepkit(benchmark::State& state) {
  VanishingPointFinder finder;
  std::vector<VanishingPoint> points;
  for (auto _ : state) {
    finder.find(View::get().planes, points);
    benchmark::DoNotOptimize(points.data());
  }
  state.counters["points"] = static_cast<double>(points.size());
}
BENCHMARK(vanishing_points_sweepkit)->Name("direction/vanishing_points/sweepkit/300");

/// Consensus over a window of directions; every direction is a hypothesis, so the bound is N^2 comparisons.
void window_sweepkit(benchmark::State& state) {
  MainDirectionOptions options;
  options.window = static_cast<int>(state.range(0));
  Random random(1);
  std::vector<FrameDirection> frames;
  for (int k = 0; k < options.window; ++k) {
    FrameDirection f;
    f.t = k;
    const double angle = k % 5 == 0 ? random.uniform(-0.7, 0.7) : random.normal(0.2, 0.005);
    f.left = f.right = {true, angle, 0.003, 0.99, 20};
    frames.push_back(f);
  }
  for (auto _ : state) {
    auto answer = first_main_direction(frames, options);
    benchmark::DoNotOptimize(answer);
  }
  state.counters["bound_comparisons"] = static_cast<double>(options.window) * options.window;
}
BENCHMARK(window_sweepkit)->Name("direction/window/sweepkit")->Arg(50)->Arg(200);

}  // namespace
