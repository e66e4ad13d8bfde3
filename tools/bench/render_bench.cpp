// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Rendering of a furnished flat: one camera of 640x400 px, 4 samples a pixel, from 8 cm above the floor. The
// bound is what casting one ray a sample takes, in the same packets and with nothing done about what is hit:
// depth alone, of as many pixels as there are samples (twice the size in both directions).
#include <benchmark/benchmark.h>

#include <cmath>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/data/flat.hpp"
#include "sweepkit/data/floor_plan.hpp"
#include "sweepkit/data/renderer.hpp"

using namespace sweepkit;

namespace {

Camera make_camera(int scale) {
  const double f = 322.0 * scale;
  return Camera({f, f, 319.5 * scale, 199.5 * scale}, Distortion::radial_tangential,
                {-0.05, 0.01, 0.0005, -0.0003}, 640 * scale, 400 * scale);
}

/// Places in a flat that look into the open.
std::vector<SE3d> places(const Scene& scene) {
  const FloorPlan plan(scene);
  Random random(5);
  std::vector<SE3d> result;
  while (result.size() < 8) {
    const Vec2<double> p =
        plan.low() +
        (plan.high() - plan.low()).cwiseProduct(Vec2<double>(random.uniform(), random.uniform()));
    const double yaw = random.uniform(-3.14, 3.14);
    if (!plan.is_free(p.x(), p.y(), 0.2) || !plan.is_free(p.x() + std::cos(yaw), p.y() + std::sin(yaw), 0.1))
      continue;
    Mat3<double> R;
    R.col(2) = Vec3<double>(std::cos(yaw), std::sin(yaw), -0.05).normalized();
    R.col(0) = Vec3<double>(std::sin(yaw), -std::cos(yaw), 0);
    R.col(1) = R.col(2).cross(R.col(0));
    result.emplace_back(SO3d(R), Vec3<double>(p.x(), p.y(), 0.08));
  }
  return result;
}

struct World {
  Scene scene = generate_flat({});
  Renderer renderer;
  std::vector<SE3d> poses = places(scene);

  explicit World(int threads)
      : renderer(scene, [&] {
          RendererOptions options;
          options.threads = threads;
          return options;
        }()) {}
  static const World& get(int threads) {
    static const World one(1), two(2);
    return threads == 1 ? one : two;
  }
};

void draw(benchmark::State& state, int scale, bool radiance) {
  const World& world = World::get(static_cast<int>(state.range(0)));
  const RayTable rays(make_camera(scale), world.renderer.options().samples);
  RenderedView view;
  ViewRequest request;
  request.radiance = radiance;
  request.depth = !radiance;
  std::size_t n = 0;
  for (auto _ : state) {
    request.T_world_camera = world.poses[n++ % world.poses.size()];
    world.renderer.render(rays, request, view);
    benchmark::DoNotOptimize(view);
  }
  const double samples = 640.0 * 400 * 4;
  state.counters["rays_per_s"] = benchmark::Counter(samples, benchmark::Counter::kIsIterationInvariantRate);
  state.counters["images_per_s"] = benchmark::Counter(1, benchmark::Counter::kIsIterationInvariantRate);
}

void make(benchmark::State& state) {
  const Scene scene = generate_flat({});
  for (auto _ : state) {
    const Renderer renderer(scene);
    benchmark::DoNotOptimize(&renderer);
  }
}

}  // namespace

BENCHMARK_CAPTURE(draw, sweepkit, 1, true)
    ->Name("data/render/sweepkit/640x400")
    ->ArgName("threads")
    ->Arg(1)
    ->Arg(2)
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(draw, bound, 2, false)
    ->Name("data/render/rays_alone/640x400")
    ->ArgName("threads")
    ->Arg(1)
    ->Arg(2)
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK(make)->Name("data/render_prepare/sweepkit/two_rooms")->UseRealTime()->Unit(benchmark::kMillisecond);
