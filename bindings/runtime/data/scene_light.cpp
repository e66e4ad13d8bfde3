// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "scene_light.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/parallel.hpp"

namespace sweepkit {
namespace {

using Vec3d = Vec3<double>;

constexpr double kPi = std::numbers::pi;
constexpr float kLift = 4e-4f;       // rays start so far above their surface [m]
constexpr double kFaintest = 0.003;  // irradiance below which a source is left out
constexpr std::size_t kMostTexels = std::size_t{1} << 26;
constexpr int kCoarse = 4;          // light by way of other surfaces is worked out at every 4th texel
constexpr double kLampReach = 0.5;  // closer than its root lamps are no brighter: they have shades [m^2]
constexpr float kBrightest =
    4.0f;  // a surface hands on no more light than of this irradiance: spots of light
           // smaller than the angle between two directions would come out as stains
constexpr double kSunRadius = 0.012;  // half of the sun's disc, with haze [rad]

/// Shadow rays in waiting, each with what it brings if it arrives.
class ShadowRays {
 public:
  explicit ShadowRays(const RayCaster& caster) : caster_(caster) { rays_.near = 0; }

  void add(const Vec3d& from, const Vec3d& to_light, float far, float* sum, float value) {
    rays_.ox[count_] = static_cast<float>(from.x());
    rays_.oy[count_] = static_cast<float>(from.y());
    rays_.oz[count_] = static_cast<float>(from.z());
    rays_.dx[count_] = static_cast<float>(to_light.x());
    rays_.dy[count_] = static_cast<float>(to_light.y());
    rays_.dz[count_] = static_cast<float>(to_light.z());
    rays_.far[count_] = far;
    rays_.valid[count_] = -1;
    sum_[count_] = sum;
    value_[count_] = value;
    if (++count_ == RayCaster::kPacket) flush();
  }
  void flush() {
    if (count_ == 0) return;
    caster_.occlude(rays_, true);
    for (int i = 0; i < count_; ++i)
      if (rays_.far[i] >= 0) *sum_[i] += value_[i];
    std::fill_n(rays_.valid, RayCaster::kPacket, 0);
    count_ = 0;
  }

 private:
  const RayCaster& caster_;
  RayCaster::Rays rays_;
  float* sum_[RayCaster::kPacket] = {};
  float value_[RayCaster::kPacket] = {};
  int count_ = 0;
};

struct Sources {
  struct Point {
    Vec3d position;
    double power, radius;
  };
  struct Pane {
    std::array<Vec3d, 4> points;
    Vec3d normal;
    double area, radiance;
  };
  std::vector<Point> lamps;
  std::vector<Pane> panes;
  std::array<Vec3d, 4> sun;
  double sun_power = 0;
};

Sources collect(const Scene& scene, const SurfaceMesh& mesh) {
  Sources sources;
  for (const Light& light : scene.lights)
    if (light.power > 0) sources.lamps.push_back({light.position, light.power, light.radius});
  for (const std::uint32_t index : mesh.windows) {
    const Patch& patch = mesh.patches[index];
    Sources::Pane pane;
    // In front of frame and mullion, which would else cut the light of single points off.
    constexpr std::array<std::array<double, 2>, 4> kSpots{
        {{0.125, 0.375}, {0.375, 0.875}, {0.625, 0.125}, {0.875, 0.625}}};
    for (std::size_t i = 0; i < 4; ++i) {
      patch.at(patch.extent_s * kSpots[i][0], patch.extent_t * kSpots[i][1], pane.points[i], pane.normal);
      pane.points[i] += 0.16 * pane.normal;
    }
    pane.area = static_cast<double>(patch.extent_s) * patch.extent_t;
    pane.radiance = patch.emission;
    sources.panes.push_back(pane);
  }
  const Daylight& day = scene.daylight;
  sources.sun_power = scene.windows.empty() ? 0.0 : day.sun;
  const Vec3d to_sun(std::cos(day.elevation) * std::cos(day.azimuth),
                     std::cos(day.elevation) * std::sin(day.azimuth), std::sin(day.elevation));
  const Vec3d side = to_sun.unitOrthogonal(), other = to_sun.cross(side);
  for (int i = 0; i < 4; ++i) {
    const double a = kPi / 4 + i * kPi / 2;
    sources.sun[static_cast<std::size_t>(i)] =
        (to_sun + 0.7 * kSunRadius * (std::cos(a) * side + std::sin(a) * other)).normalized();
  }
  return sources;
}

/// Light straight from the sources onto a point.
void add_direct(const Sources& sources, const Vec3d& point, const Vec3d& n, ShadowRays& rays,
                Irradiance& sum) {
  const Vec3d from = point + n * kLift;
  for (const auto& lamp : sources.lamps) {
    const Vec3d d = lamp.position - from;
    const double r2 = std::max(d.squaredNorm(), kLampReach), r = d.norm(), cosine = n.dot(d) / r;
    if (cosine <= 0 || lamp.power * cosine / r2 < kFaintest) continue;
    // Four points of the lamp's disc as seen from here.
    const Vec3d side = (d / r).unitOrthogonal(), other = (d / r).cross(side);
    for (int i = 0; i < 4; ++i) {
      const double a = kPi / 4 + i * kPi / 2;
      const Vec3d target = d + 0.7 * lamp.radius * (std::cos(a) * side + std::sin(a) * other);
      rays.add(from, target, 1.0f, &sum.lamps, static_cast<float>(0.25 * lamp.power * cosine / r2));
    }
  }
  for (const auto& pane : sources.panes)
    for (const Vec3d& p : pane.points) {
      const Vec3d d = p - from;
      const double r2 = std::max(d.squaredNorm(), 0.01), r = std::sqrt(r2);
      const double cosine = n.dot(d) / r, away = -pane.normal.dot(d) / r;
      if (cosine <= 0 || away <= 0) continue;
      const double value = 0.25 * pane.radiance * pane.area * cosine * away / (kPi * r2 + pane.area);
      if (value < 0.25 * kFaintest) continue;
      rays.add(from, d, 0.999f, &sum.day, static_cast<float>(value));
    }
  if (sources.sun_power > 0)
    for (const Vec3d& d : sources.sun) {
      const double cosine = n.dot(d);
      if (cosine > 0)
        rays.add(from, d, 100.0f, &sum.day, static_cast<float>(0.25 * sources.sun_power * cosine));
    }
}

}  // namespace

LightTable::LightTable(const Scene& scene, SurfaceMesh& mesh, const RayCaster& caster, int ray_count,
                       int threads) {
  std::size_t total = 0;
  for (Patch& patch : mesh.patches) {
    patch.light_width = std::clamp(static_cast<int>(std::ceil(patch.extent_s / patch.texel)), 2, 4096);
    patch.light_height = std::clamp(static_cast<int>(std::ceil(patch.extent_t / patch.texel)), 2, 4096);
    patch.light = static_cast<std::uint32_t>(total);
    total += static_cast<std::size_t>(patch.light_width) * static_cast<std::size_t>(patch.light_height);
    if (total > kMostTexels)
      throw Error(ErrorKind::option, "light_texel", "is too small for a scene of this size");
  }
  texels_.resize(total);
  const Sources sources = collect(scene, mesh);

  const auto texel_point = [](const Patch& patch, int x, int y, Vec3d& point, Vec3d& n) {
    patch.at(patch.extent_s * (x + 0.5) / patch.light_width, patch.extent_t * (y + 0.5) / patch.light_height,
             point, n);
  };
  // Patches differ much in size: their rows are dealt out in turn.
  const auto for_rows = [&](auto&& body) {
    const auto workers = static_cast<std::size_t>(thread_count(threads));
    parallel_blocks(workers, static_cast<int>(workers),
                    [&](std::size_t first, std::size_t last, std::size_t) {
                      for (std::size_t block = first; block < last; ++block) {
                        std::size_t row = 0;
                        for (const Patch& patch : mesh.patches)
                          for (int y = 0; y < patch.light_height; ++y, ++row)
                            if (row % workers == block) body(patch, y);
                      }
                    });
  };

  for_rows([&](const Patch& patch, int y) {
    if (patch.emission > 0) return;
    ShadowRays rays(caster);
    Irradiance* out = texels_.data() + patch.light +
                      static_cast<std::size_t>(y) * static_cast<std::size_t>(patch.light_width);
    for (int x = 0; x < patch.light_width; ++x) {
      Vec3d point, n;
      texel_point(patch, x, y, point, n);
      add_direct(sources, point, n, rays, out[x]);
    }
    rays.flush();
  });

  // Light by way of one other surface, and what that surface has from all the others taken to be even: a
  // share of the mean. Gathered at coarse points from directions that all points have in common, which shows
  // as no noise; blended in between.
  std::vector<Vec3d> directions;
  for (int i = 0; i < ray_count; ++i) {
    // Points of a Fibonacci spiral on the disc, lifted to the hemisphere: even for a cosine's weight.
    const double r = std::sqrt((i + 0.5) / ray_count), a = i * kPi * (3 - std::sqrt(5.0));
    directions.emplace_back(r * std::cos(a), r * std::sin(a), std::sqrt(1 - r * r));
  }
  double lamps = 0, day = 0, weight = 0;
  for (const Patch& patch : mesh.patches) {
    const auto n = static_cast<std::size_t>(patch.light_width) * static_cast<std::size_t>(patch.light_height);
    const double area = static_cast<double>(patch.extent_s) * patch.extent_t / static_cast<double>(n);
    for (std::size_t i = 0; i < n; ++i) {
      lamps += area * texels_[patch.light + i].lamps;
      day += area * texels_[patch.light + i].day;
    }
    weight += area * static_cast<double>(n);
  }
  constexpr float kMeanAlbedo = 0.4f;
  const auto even_lamps = static_cast<float>(kMeanAlbedo * lamps / weight),
             even_day = static_cast<float>(kMeanAlbedo * day / weight);

  std::vector<std::vector<Irradiance>> coarse(mesh.patches.size());
  const auto coarse_size = [](int n) { return std::max(2, (n + kCoarse - 1) / kCoarse); };
  for (std::size_t p = 0; p < mesh.patches.size(); ++p)
    coarse[p].resize(static_cast<std::size_t>(coarse_size(mesh.patches[p].light_width)) *
                     static_cast<std::size_t>(coarse_size(mesh.patches[p].light_height)));
  for_rows([&](const Patch& patch, int y) {
    const int height = coarse_size(patch.light_height), width = coarse_size(patch.light_width);
    if (y >= height || patch.emission > 0) return;
    const auto index = static_cast<std::size_t>(&patch - mesh.patches.data());
    for (int x = 0; x < width; ++x) {
      Vec3d point, n;
      patch.at(patch.extent_s * (x + 0.5) / width, patch.extent_t * (y + 0.5) / height, point, n);
      const Vec3d from = point + n * kLift;
      const Vec3d side = n.unitOrthogonal(), other = n.cross(side);
      Irradiance sum;
      RayCaster::Rays rays;
      rays.near = 0;
      for (int first = 0; first < ray_count; first += RayCaster::kPacket) {
        const int count = std::min(RayCaster::kPacket, ray_count - first);
        for (int i = 0; i < RayCaster::kPacket; ++i) {
          rays.valid[i] = i < count ? -1 : 0;
          const Vec3d& c = directions[static_cast<std::size_t>(first + std::min(i, count - 1))];
          const Vec3d d = side * c.x() + other * c.y() + n * c.z();
          rays.ox[i] = static_cast<float>(from.x());
          rays.oy[i] = static_cast<float>(from.y());
          rays.oz[i] = static_cast<float>(from.z());
          rays.dx[i] = static_cast<float>(d.x());
          rays.dy[i] = static_cast<float>(d.y());
          rays.dz[i] = static_cast<float>(d.z());
          rays.far[i] = 100.0f;
        }
        caster.intersect(rays, false);
        for (int i = 0; i < count; ++i) {
          if (rays.triangle[i] == RayCaster::kNone) continue;
          const auto& t = mesh.triangles[rays.triangle[i]];
          const Patch& other_patch = mesh.patches[t.patch];
          if (other_patch.emission > 0) continue;  // counted as a source
          const float px = rays.ox[i] + rays.far[i] * rays.dx[i], py = rays.oy[i] + rays.far[i] * rays.dy[i],
                      pz = rays.oz[i] + rays.far[i] * rays.dz[i];
          const Irradiance e = at(other_patch, t.grad_s[0] * px + t.grad_s[1] * py + t.grad_s[2] * pz + t.s0,
                                  t.grad_t[0] * px + t.grad_t[1] * py + t.grad_t[2] * pz + t.t0);
          const float albedo = other_patch.texture->mean();
          sum.lamps += albedo * (std::min(e.lamps, kBrightest) + even_lamps);
          sum.day += albedo * (std::min(e.day, kBrightest) + even_day);
        }
      }
      coarse[index][static_cast<std::size_t>(y * width + x)] = {sum.lamps / static_cast<float>(ray_count),
                                                                sum.day / static_cast<float>(ray_count)};
    }
  });
  double floor_lamps = 0, floor_day = 0, floor_count = 0;
  for (std::size_t p = 0; p < mesh.patches.size(); ++p) {
    const Patch& patch = mesh.patches[p];
    const int width = coarse_size(patch.light_width), height = coarse_size(patch.light_height);
    for (int y = 0; y < patch.light_height; ++y)
      for (int x = 0; x < patch.light_width; ++x) {
        const float u = std::clamp((static_cast<float>(x) + 0.5f) * static_cast<float>(width) /
                                           static_cast<float>(patch.light_width) -
                                       0.5f,
                                   0.0f, static_cast<float>(width - 1));
        const float v = std::clamp((static_cast<float>(y) + 0.5f) * static_cast<float>(height) /
                                           static_cast<float>(patch.light_height) -
                                       0.5f,
                                   0.0f, static_cast<float>(height - 1));
        const int i = std::min(static_cast<int>(u), width - 2), j = std::min(static_cast<int>(v), height - 2);
        const float a = u - static_cast<float>(i), b = v - static_cast<float>(j);
        const auto c = [&](int k, int l) {
          return coarse[p][static_cast<std::size_t>((j + l) * width + i + k)];
        };
        Irradiance& out = texels_[patch.light + static_cast<std::size_t>(y * patch.light_width + x)];
        out.lamps += (1 - b) * ((1 - a) * c(0, 0).lamps + a * c(1, 0).lamps) +
                     b * ((1 - a) * c(0, 1).lamps + a * c(1, 1).lamps);
        out.day += (1 - b) * ((1 - a) * c(0, 0).day + a * c(1, 0).day) +
                   b * ((1 - a) * c(0, 1).day + a * c(1, 1).day);
        if (patch.label == SceneLabel::floor) {
          floor_lamps += out.lamps;
          floor_day += out.day;
          floor_count += 1;
        }
      }
  }
  if (floor_count > 0)
    mean_ = {static_cast<float>(floor_lamps / floor_count), static_cast<float>(floor_day / floor_count)};
}

}  // namespace sweepkit
