// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/renderer.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "ray_caster.hpp"
#include "scene_light.hpp"
#include "scene_surface.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/core/parallel.hpp"

namespace sweepkit {
namespace {

using Vec3d = Vec3<double>;
using Vec3f = Vec3<float>;
using Mat3f = Mat3<float>;

constexpr float kFar = 200.0f;
constexpr int kMostProbes = 6;  // texture lookups along a long footprint

/// Well mixed bits of a pixel's place.
std::uint32_t pixel_bits(int x, int y) {
  std::uint32_t h = static_cast<std::uint32_t>(x) * 0x9e3779b1u ^ static_cast<std::uint32_t>(y) * 0x85ebca77u;
  h ^= h >> 15;
  h *= 0x2c1b3c6du;
  h ^= h >> 12;
  h *= 0x297a2d39u;
  return h ^ (h >> 15);
}

/// Van der Corput's number: the bits of i mirrored about the point.
double mirrored(std::uint32_t i) {
  double value = 0, weight = 0.5;
  for (; i; i >>= 1, weight /= 2)
    if (i & 1) value += weight;
  return value;
}

/// Where the sample k of n lies in a pixel, from its centre: a Hammersley set, in which no two share a row or
/// column, turned by the pixel's own bits.
std::array<double, 2> sample_offset(int k, int n, std::uint32_t bits) {
  double x = (k + 0.5) / n - 0.5, y = mirrored(static_cast<std::uint32_t>(k)) + 0.5 / n - 0.5;
  if (n & (n - 1)) y = mirrored(static_cast<std::uint32_t>(k)) - 0.5 + 0.25 / n;
  if (bits & 1) x = -x;
  if (bits & 2) y = -y;
  if (bits & 4) std::swap(x, y);
  return {x, y};
}

/// The base-2 logarithm to 0.01, of a positive number.
float fast_log2(float x) {
  const auto bits = std::bit_cast<std::uint32_t>(x);
  const float exponent = static_cast<float>(static_cast<int>(bits >> 23) - 127);
  const float m = std::bit_cast<float>((bits & 0x007fffffu) | 0x3f800000u);
  return exponent + (m - 1.0f) * (1.34f - 0.34f * (m - 1.0f));
}

/// The nearest hit of a ray with a capsule beyond 0; the ray need not have unit length.
/// @return its parameter, or infinity
float hit_capsule(const Vec3f& o, const Vec3f& d, const Vec3f& a, const Vec3f& b, float radius,
                  Vec3f& normal) {
  constexpr float kNone = std::numeric_limits<float>::infinity();
  const Vec3f ba = b - a, oa = o - a;
  const float dd = d.dot(d), baba = ba.dot(ba), bad = ba.dot(d), baoa = ba.dot(oa), doa = d.dot(oa),
              oaoa = oa.dot(oa);
  float best = kNone;
  // The round side.
  const float qa = baba * dd - bad * bad, qb = baba * doa - baoa * bad,
              qc = baba * oaoa - baoa * baoa - radius * radius * baba;
  const float disc = qb * qb - qa * qc;
  if (qa > 1e-12f && disc >= 0) {
    const float t = (-qb - std::sqrt(disc)) / qa, y = baoa + t * bad;
    if (t > 0 && y > 0 && y < baba) {
      best = t;
      normal = (oa + d * t - ba * (y / baba)) / radius;
    }
  }
  // The ends.
  for (const Vec3f& c : {a, b}) {
    const Vec3f oc = o - c;
    const float h = d.dot(oc), e = h * h - dd * (oc.dot(oc) - radius * radius);
    if (e < 0) continue;
    const float t = (-h - std::sqrt(e)) / dd;
    if (t > 0 && t < best) {
      best = t;
      normal = (oc + d * t) / radius;
    }
  }
  return best;
}

/// The capsules of all moving things, in the world.
struct MovingBodies {
  struct Body {
    Vec3f a, b;
    float radius, albedo;
  };
  std::vector<Body> bodies;
  Vec3f centre = Vec3f::Zero();
  float reach = 0;

  explicit MovingBodies(const std::vector<MovingThing>& things) {
    for (const MovingThing& thing : things)
      for (const Capsule& c : thing.parts) {
        require(c.radius > 0 && std::isfinite(c.radius), "ViewRequest::moving",
                "a capsule needs a radius above zero", c.radius);
        bodies.push_back({(thing.T_world_thing * c.a).cast<float>(),
                          (thing.T_world_thing * c.b).cast<float>(), static_cast<float>(c.radius),
                          static_cast<float>(c.albedo)});
      }
    if (bodies.empty()) return;
    for (const Body& b : bodies) centre += (b.a + b.b) / (2.0f * static_cast<float>(bodies.size()));
    for (const Body& b : bodies)
      reach = std::max(reach, std::max((b.a - centre).norm(), (b.b - centre).norm()) + b.radius);
  }

  /// The nearest body closer than `far`; null if there is none.
  const Body* hit(const Vec3f& o, const Vec3f& d, float& far, Vec3f& normal) const {
    if (bodies.empty()) return nullptr;
    const Vec3f oc = o - centre;
    const float h = d.dot(oc), dd = d.dot(d);
    if (h * h < dd * (oc.dot(oc) - reach * reach)) return nullptr;
    const Body* best = nullptr;
    for (const Body& b : bodies) {
      Vec3f n = Vec3f::Zero();
      const float t = hit_capsule(o, d, b.a, b.b, b.radius, n);
      if (t < far) {
        far = t;
        normal = n;
        best = &b;
      }
    }
    return best;
  }

  /// How much of the light from above bodies leave at a point: their shadow, blurred.
  float light_left(const Vec3f& p) const {
    if (bodies.empty() || (p - centre).squaredNorm() > 4 * reach * reach) return 1;
    float left = 1;
    for (const Body& b : bodies) {
      const Vec3f ba = b.b - b.a;
      const float y = std::clamp((p - b.a).dot(ba) / std::max(ba.squaredNorm(), 1e-9f), 0.0f, 1.0f);
      const float squared = (p - b.a - ba * y).squaredNorm();
      if (squared > 49 * b.radius * b.radius) continue;
      const float distance = std::max(std::sqrt(squared) - b.radius, 0.0f);
      left *= 1 - 0.45f * std::exp(-distance / (1.5f * b.radius));
    }
    return left;
  }
};

}  // namespace

struct RayTable::Rays {
  int width, height, samples;
  std::vector<float> m;         ///< x/z, y/z of each sample; NaN where the model sees nothing
  std::vector<float> centres;   ///< of each pixel
  std::vector<float> jacobian;  ///< of x/z, y/z by the pixel, row by row
};

RayTable::RayTable(const Camera& camera, int samples) {
  require(samples >= 1 && samples <= 64, "RayTable samples", "must lie in 1 .. 64", samples);
  auto rays = std::make_unique<Rays>();
  rays->width = camera.width();
  rays->height = camera.height();
  rays->samples = samples;
  const std::size_t pixels =
      static_cast<std::size_t>(camera.width()) * static_cast<std::size_t>(camera.height());
  rays->m.resize(2 * pixels * static_cast<std::size_t>(samples));
  rays->centres.resize(2 * pixels);
  rays->jacobian.resize(4 * pixels);
  constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
  std::vector<char> seen(pixels);
  parallel_for(static_cast<std::size_t>(camera.height()), 0, [&](std::size_t row) {
    for (int x = 0; x < camera.width(); ++x) {
      const int y = static_cast<int>(row);
      const std::size_t i = row * static_cast<std::size_t>(camera.width()) + static_cast<std::size_t>(x);
      Eigen::Matrix<double, 3, 2> J;
      const auto centre = camera.unproject({x, y}, &J);
      seen[i] = centre.has_value();
      rays->centres[2 * i] = centre ? static_cast<float>(centre->x()) : kNaN;
      rays->centres[2 * i + 1] = centre ? static_cast<float>(centre->y()) : kNaN;
      for (int k = 0; k < 4; ++k)
        rays->jacobian[4 * i + static_cast<std::size_t>(k)] =
            centre ? static_cast<float>(J(k / 2, k % 2)) : 0.0f;
      const std::uint32_t bits = pixel_bits(x, y);
      for (int k = 0; k < samples; ++k) {
        const auto offset = sample_offset(k, samples, bits);
        // Within a pixel a second-order step from its centre is exact to 1e-6 px, but for the edge of the
        // domain.
        const auto ray = centre ? camera.unproject({x + offset[0], y + offset[1]}) : std::nullopt;
        float* m = rays->m.data() + 2 * (i * static_cast<std::size_t>(samples) + static_cast<std::size_t>(k));
        m[0] = ray ? static_cast<float>(ray->x()) : kNaN;
        m[1] = ray ? static_cast<float>(ray->y()) : kNaN;
      }
    }
  });
  const auto blind = static_cast<std::size_t>(std::count(seen.begin(), seen.end(), 0));
  if (2 * blind >= pixels)
    throw Error(ErrorKind::calibration, "camera", "its model sees nothing in half of its pixels or more",
                std::to_string(blind) + " of " + std::to_string(pixels));
  rays_ = std::move(rays);
}

RayTable::~RayTable() = default;
RayTable::RayTable(RayTable&&) noexcept = default;
RayTable& RayTable::operator=(RayTable&&) noexcept = default;
int RayTable::width() const { return rays_->width; }
int RayTable::height() const { return rays_->height; }

struct Renderer::World {
  RendererOptions options;
  SurfaceMesh mesh;
  RayCaster caster;
  LightTable light;
  std::array<std::shared_ptr<const Texture>, 4> details;

  World(const Scene& scene, const RendererOptions& o)
      : options(o),
        mesh(build_surfaces(scene, o.light_texel)),
        caster(mesh),
        light(scene, mesh, caster, o.light_rays, o.threads) {
    for (const Patch& patch : mesh.patches)
      details[static_cast<std::size_t>(patch.detail)] = detail_texture(patch.detail);
  }

  /// A texture averaged over a footprint: lookups side by side along its longer axis, each filtered to the
  /// shorter (McCormack et al., Feline, 1999).
  static float lookup(const Texture& texture, float u, float v, float ax, float ay, float bx, float by) {
    float la = ax * ax + ay * ay, lb = bx * bx + by * by;
    if (la < lb) {
      std::swap(ax, bx);
      std::swap(ay, by);
      std::swap(la, lb);
    }
    const float major = std::sqrt(la), area = std::abs(ax * by - ay * bx);
    // Of a parallelogram the shorter axis is its height.
    const float minor = std::max(area / std::max(major, 1e-20f), major * (1.0f / kMostProbes));
    const auto size = static_cast<float>(texture.size());
    const float lod = fast_log2(std::max(minor * size, 1e-6f));
    const int probes =
        major * size <= 1.0f ? 1 : std::clamp(static_cast<int>(major / minor + 0.5f), 1, kMostProbes);
    return texture.sample(u, v, ax, ay, probes, lod);
  }

  /// The radiance towards the ray of what it hits.
  /// @param dx, dy how the ray's direction changes from this sample's cell to the next in x and y
  float shade(std::uint32_t index, const Vec3f& o, const Vec3f& d, float far, const Vec3f& dx,
              const Vec3f& dy, float lamps, float day, const MovingBodies& moving) const {
    const auto& t = mesh.triangles[index];
    const Patch& patch = mesh.patches[t.patch];
    if (patch.emission > 0) return patch.emission * (patch.daylight ? day : lamps);
    const Vec3f p = o + d * far;
    const Eigen::Map<const Vec3f> gs(t.grad_s), gt(t.grad_t), n(t.normal);
    const float s = gs.dot(p) + t.s0, r = gt.dot(p) + t.t0;
    float slope = d.dot(n);
    if (std::abs(slope) < 1e-4f) slope = slope < 0 ? -1e-4f : 1e-4f;
    const Vec3f px = far * (dx - d * (dx.dot(n) / slope)), py = far * (dy - d * (dy.dot(n) / slope));
    const float sx = gs.dot(px), tx = gt.dot(px), sy = gs.dot(py), ty = gt.dot(py);
    float albedo = lookup(*patch.texture, patch.u_s * s + patch.u_t * r + patch.u_0,
                          patch.v_s * s + patch.v_t * r + patch.v_0, patch.u_s * sx + patch.u_t * tx,
                          patch.v_s * sx + patch.v_t * tx, patch.u_s * sy + patch.u_t * ty,
                          patch.v_s * sy + patch.v_t * ty);
    if (patch.detail != Detail::none) {
      const Texture& detail = *details[static_cast<std::size_t>(patch.detail)];
      const float scale = 1.0f / detail.period();
      // Above this footprint nothing is left of it.
      const float longest = std::max(sx * sx + tx * tx, sy * sy + ty * ty);
      if (longest < 0.01f * 0.01f) {
        const bool turned = patch.u_t != 0;
        const float a = turned ? r : s, b = turned ? s : r;
        const float value =
            lookup(detail, a * scale, b * scale, (turned ? tx : sx) * scale, (turned ? sx : tx) * scale,
                   (turned ? ty : sy) * scale, (turned ? sy : ty) * scale);
        albedo *= 1 + 5 * patch.detail_strength * (value - 0.5f);
      }
    }
    const Irradiance e = light.at(patch, s, r);
    return albedo * (e.lamps * lamps + e.day * day) * moving.light_left(p);
  }
};

Renderer::Renderer(const Scene& scene, const RendererOptions& options) {
  require(options.samples >= 1 && options.samples <= 64, "RendererOptions::samples", "must lie in 1 .. 64",
          options.samples);
  require(options.light_texel >= 0.002 && options.light_texel <= 0.2, "RendererOptions::light_texel",
          "must lie in 0.002 .. 0.2", options.light_texel);
  require(options.light_rays >= 4 && options.light_rays <= 1024, "RendererOptions::light_rays",
          "must lie in 4 .. 1024", options.light_rays);
  scene.check();
  world_ = std::make_unique<const World>(scene, options);
}

Renderer::~Renderer() = default;
Renderer::Renderer(Renderer&&) noexcept = default;
Renderer& Renderer::operator=(Renderer&&) noexcept = default;
const RendererOptions& Renderer::options() const { return world_->options; }

void Renderer::render(const RayTable& table, const ViewRequest& request, RenderedView& view) const {
  const RayTable::Rays& rays = *table.rays_;
  const World& world = *world_;
  const int width = rays.width, height = rays.height, samples = rays.samples;
  require(samples == world.options.samples, "Renderer::render rays",
          "must have the renderer's number of samples", samples);
  const MovingBodies moving(request.moving);
  const auto lamps = static_cast<float>(request.lamps), day = static_cast<float>(request.daylight);

  // Poses of the camera over the exposure, one for each sample of a pixel.
  struct Pose {
    Mat3f R;
    Vec3f o;
  };
  const auto pose_of = [](const SE3d& T) {
    return Pose{T.rotation().matrix().cast<float>(), T.translation().cast<float>()};
  };
  const Pose middle = pose_of(request.T_world_camera);
  std::vector<Pose> poses(static_cast<std::size_t>(samples), middle);
  if (request.blur)
    for (int k = 0; k < samples; ++k)
      poses[static_cast<std::size_t>(k)] = pose_of(
          interpolate(request.T_world_camera_open, request.T_world_camera_close, (k + 0.5) / samples));

  if (request.radiance) view.radiance.resize(width, height);
  if (request.depth) {
    view.depth.resize(width, height);
    view.label.resize(width, height);
  }
  const float cell = 1.0f / std::sqrt(static_cast<float>(samples));

  const auto draw_row = [&](int y) {
    RayCaster::Rays packet;
    packet.near = 1e-3f;
    const std::size_t row = static_cast<std::size_t>(y) * static_cast<std::size_t>(width);
    const auto load = [&](int i, const Pose& pose, const float* m) {
      const bool sees = !std::isnan(m[0]);
      const Vec3f d = pose.R * Vec3f(sees ? m[0] : 0.0f, sees ? m[1] : 0.0f, 1.0f);
      packet.ox[i] = pose.o.x();
      packet.oy[i] = pose.o.y();
      packet.oz[i] = pose.o.z();
      packet.dx[i] = d.x();
      packet.dy[i] = d.y();
      packet.dz[i] = d.z();
      packet.far[i] = kFar;
      packet.valid[i] = sees ? -1 : 0;
    };
    if (request.radiance) {
      float* out = view.radiance.row(y);
      std::fill_n(out, width, 0.0f);
      const int total = width * samples;
      for (int first = 0; first < total; first += RayCaster::kPacket) {
        const int count = std::min(RayCaster::kPacket, total - first);
        const Pose* pose[RayCaster::kPacket];
        for (int i = 0; i < count; ++i) {
          const int x = (first + i) / samples, k = (first + i) % samples;
          // Which instant a sample has varies from pixel to pixel.
          const auto turn = static_cast<int>(pixel_bits(y, x) % static_cast<std::uint32_t>(samples));
          pose[i] = &poses[static_cast<std::size_t>((k + turn) % samples)];
          load(i, *pose[i],
               rays.m.data() +
                   2 * (row * static_cast<std::size_t>(samples) + static_cast<std::size_t>(first + i)));
        }
        for (int i = count; i < RayCaster::kPacket; ++i) packet.valid[i] = 0;
        world.caster.intersect(packet, true);
        for (int i = 0; i < count; ++i) {
          const int x = (first + i) / samples;
          if (!packet.valid[i]) continue;
          const Vec3f o(packet.ox[i], packet.oy[i], packet.oz[i]),
              d(packet.dx[i], packet.dy[i], packet.dz[i]);
          float far = packet.triangle[i] == RayCaster::kNone ? kFar : packet.far[i];
          Vec3f normal;
          if (const auto* body = moving.hit(o, d, far, normal)) {
            const Irradiance e = world.light.mean();
            // Lit from above, a little from all sides.
            out[x] += body->albedo * (e.lamps * lamps + e.day * day) * (0.6f + 0.4f * normal.z());
          } else if (packet.triangle[i] != RayCaster::kNone) {
            const float* J = rays.jacobian.data() + 4 * (row + static_cast<std::size_t>(x));
            const Mat3f& R = pose[i]->R;
            const Vec3f dx = cell * (R.col(0) * J[0] + R.col(1) * J[2]),
                        dy = cell * (R.col(0) * J[1] + R.col(1) * J[3]);
            out[x] += world.shade(packet.triangle[i], o, d, far, dx, dy, lamps, day, moving);
          }
        }
      }
      const float share = 1.0f / static_cast<float>(samples);
      for (int x = 0; x < width; ++x) out[x] *= share;
    }
    if (request.depth)
      for (int first = 0; first < width; first += RayCaster::kPacket) {
        const int count = std::min(RayCaster::kPacket, width - first);
        for (int i = 0; i < count; ++i)
          load(i, middle, rays.centres.data() + 2 * (row + static_cast<std::size_t>(first + i)));
        for (int i = count; i < RayCaster::kPacket; ++i) packet.valid[i] = 0;
        world.caster.intersect(packet, true);
        for (int i = 0; i < count; ++i) {
          float& depth = view.depth(first + i, y);
          std::uint8_t& label = view.label(first + i, y);
          depth = 0;
          label = 0;
          if (!packet.valid[i]) continue;
          const Vec3f o(packet.ox[i], packet.oy[i], packet.oz[i]),
              d(packet.dx[i], packet.dy[i], packet.dz[i]);
          const bool hit = packet.triangle[i] != RayCaster::kNone;
          float far = hit ? packet.far[i] : kFar;
          Vec3f normal;
          if (moving.hit(o, d, far, normal))
            label = static_cast<std::uint8_t>(SceneLabel::moving);
          else if (hit)
            label = static_cast<std::uint8_t>(
                world.mesh.patches[world.mesh.triangles[packet.triangle[i]].patch].label);
          else
            continue;
          depth = far;
        }
      }
  };
  // Rows are dealt out in turn: floor and walls cost differently.
  const int workers = std::min(thread_count(world.options.threads), height);
  parallel_blocks(static_cast<std::size_t>(workers), workers,
                  [&](std::size_t first, std::size_t last, std::size_t) {
                    for (std::size_t block = first; block < last; ++block)
                      for (int y = static_cast<int>(block); y < height; y += workers) draw_row(y);
                  });
}

void Renderer::render(const Camera& camera, const SE3d& T_world_camera, RenderedView& view) const {
  ViewRequest request;
  request.T_world_camera = T_world_camera;
  request.depth = true;
  render(RayTable(camera, options().samples), request, view);
}

MovingThing walking_person(const SE3d& T_world_person, double phase) {
  MovingThing person;
  person.T_world_thing = T_world_person;
  const double swing = std::sin(2 * std::numbers::pi * phase);
  const auto add = [&](const Vec3d& a, const Vec3d& b, double radius, double albedo) {
    person.parts.push_back({a, b, radius, albedo});
  };
  for (const double side : {-1.0, 1.0}) {
    const double s = side * swing;
    // The foot that swings forward is lifted.
    const double lift = 0.06 * std::max(0.0, side * std::cos(2 * std::numbers::pi * phase));
    const Vec3d hip(0, 0.1 * side, 0.9), foot(0.36 * s, 0.1 * side, 0.1 + lift);
    const Vec3d knee = 0.5 * (hip + foot) + Vec3d(0.05 + 0.5 * lift, 0, 0);
    add(hip, knee, 0.085, 0.12);
    add(knee, foot, 0.06, 0.12);
    add(foot + Vec3d(-0.05, 0, -0.055), foot + Vec3d(0.15, 0, -0.06), 0.042, 0.35);
    const Vec3d shoulder(0, 0.21 * side, 1.42), hand(-0.28 * s, 0.27 * side, 0.85);
    add(shoulder, 0.5 * (shoulder + hand) + Vec3d(-0.04, 0, 0), 0.05, 0.45);
    add(0.5 * (shoulder + hand) + Vec3d(-0.04, 0, 0), hand, 0.04, 0.5);
  }
  add({0, 0, 1.0}, {0, 0, 1.38}, 0.17, 0.45);
  add({0, 0, 1.62}, {0.01, 0, 1.68}, 0.1, 0.5);
  return person;
}

}  // namespace sweepkit
