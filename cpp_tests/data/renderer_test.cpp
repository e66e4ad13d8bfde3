// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/renderer.hpp"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <set>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/data/flat.hpp"

using namespace sweepkit;
using Vec3d = Vec3<double>;

namespace {

/// One room of 4 x 4 m with furniture, small things, a carpet, a lamp and a window.
Scene room() {
  Scene scene;
  Room r;
  r.name = "room";
  r.corners = {{0, 0}, {4, 0}, {4, 4}, {0, 4}};
  scene.rooms = {r};
  const auto add = [&](ObjectKind kind, double x, double y, double yaw) {
    SceneObject o;
    o.kind = kind;
    o.centre = {x, y};
    o.yaw = yaw;
    scene.objects.push_back(o);
  };
  add(ObjectKind::shelf, 3.8, 1.2, -1.5708);
  add(ObjectKind::cabinet, 3.7, 2.8, -1.5708);
  add(ObjectKind::carpet, 2.2, 3.0, 0);
  add(ObjectKind::mahjong, 1.3, 1.8, 0.4);
  add(ObjectKind::shuttlecock, 1.5, 2.15, 2.0);
  add(ObjectKind::shoe, 1.6, 1.5, 1.0);
  add(ObjectKind::cable, 1.9, 1.9, 1.2);
  add(ObjectKind::pet_waste, 1.9, 2.35, 0);
  scene.lights.push_back({{2, 2, 2.3}, 4.0, 0.1});
  scene.windows.push_back({"room", 2, 1.0, 0.9, 1.0, 1.0});
  return scene;
}

Camera camera(double cy = 120) {
  return Camera({190, 190, 159.3, cy}, Distortion::radial_tangential, {-0.08, 0.015, 0.0004, -0.0003}, 320,
                240);
}

/// A camera at a place, looking along yaw, pitched down.
SE3d look(double x, double y, double z, double yaw, double pitch) {
  Mat3<double> R;
  R.col(2) = Vec3d(std::cos(yaw) * std::cos(pitch), std::sin(yaw) * std::cos(pitch), -std::sin(pitch));
  R.col(0) = Vec3d(std::sin(yaw), -std::cos(yaw), 0);
  R.col(1) = R.col(2).cross(R.col(0));
  return {SO3<double>(R), Vec3d(x, y, z)};
}

RendererOptions quick() {
  RendererOptions options;
  options.light_texel = 0.05;
  options.light_rays = 16;
  return options;
}

/// One for all tests: textures and light take a while.
const Renderer& renderer() {
  static const Renderer kRenderer(room(), quick());
  return kRenderer;
}

double median(std::vector<double> values) {
  REQUIRE(!values.empty());
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2),
                   values.end());
  return values[values.size() / 2];
}

bool same(const RenderedView& a, const RenderedView& b) {
  for (int y = 0; y < a.radiance.height(); ++y) {
    if (std::memcmp(a.radiance.row(y), b.radiance.row(y),
                    sizeof(float) * static_cast<std::size_t>(a.radiance.width())))
      return false;
    if (std::memcmp(a.depth.row(y), b.depth.row(y),
                    sizeof(float) * static_cast<std::size_t>(a.depth.width())))
      return false;
    if (std::memcmp(a.label.row(y), b.label.row(y), static_cast<std::size_t>(a.label.width()))) return false;
  }
  return true;
}

float bilinear(const Image<float>& image, double x, double y) {
  const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
  const auto a = static_cast<float>(x - x0), b = static_cast<float>(y - y0);
  return (1 - b) * ((1 - a) * image(x0, y0) + a * image(x0 + 1, y0)) +
         b * ((1 - a) * image(x0, y0 + 1) + a * image(x0 + 1, y0 + 1));
}

}  // namespace

TEST_CASE("depth of the floor is that of its plane within 0.2 mm, for each camera model") {
  const SE3d T = look(0.8, 1.9, 0.08, 0.1, 0.1);
  for (const Camera& c :
       {camera(), Camera({150, 150, 160, 120}, Distortion::equidistant, {0.01, -0.002, 0, 0}, 320, 240),
        Camera({190, 190, 160, 120}, Distortion::none, {}, 320, 240)}) {
    RenderedView view;
    renderer().render(c, T, view);
    int floor = 0;
    double worst = 0;
    for (int y = 0; y < 240; ++y)
      for (int x = 0; x < 320; ++x) {
        if (view.label(x, y) != 1) continue;
        ++floor;
        const Vec3d ray = c.unproject({x, y}).value();
        worst = std::max(worst, std::abs((T * Vec3d(ray * view.depth(x, y))).z()));
      }
    CHECK(floor > 5000);
    CHECK(worst < 2e-4);
  }
}

TEST_CASE("labels tell what is seen") {
  RenderedView view;
  renderer().render(camera(), look(0.8, 1.9, 0.08, 0.0, 0.1), view);
  std::set<int> seen;
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 320; ++x) seen.insert(view.label(x, y));
  for (const int label : {0, 1, 3, 10, 11, 12, 13, 14}) {
    INFO(label);
    CHECK(seen.count(label) == 1);
  }
  renderer().render(camera(), look(2.2, 2.0, 0.08, 1.57, 0.3), view);
  CHECK(view.label(160, 88) == 2);
}

TEST_CASE("depth takes pixels into the other camera, where they look the same") {
  const Camera c({322, 322, 319, 199}, Distortion::radial_tangential, {-0.08, 0.015, 0.0004, -0.0003}, 640,
                 400);
  const SE3d T_left = look(0.8, 1.9, 0.08, 0.1, 0.08);
  for (const SE3d& T_other :
       {SE3d(T_left * SE3d(SO3<double>(), Vec3d(0.06, 0, 0))), look(0.86, 1.91, 0.08, 0.13, 0.08)}) {
    RenderedView a, b;
    renderer().render(c, T_left, a);
    renderer().render(c, T_other, b);
    std::vector<double> error;
    for (int y = 2; y < 398; ++y)
      for (int x = 2; x < 638; ++x) {
        if (a.depth(x, y) == 0) continue;
        const Vec3d p = T_other.inverse() * (T_left * Vec3d(c.unproject({x, y}).value() * a.depth(x, y)));
        const auto q = c.project(p);
        if (!q || !c.contains(*q, 2)) continue;
        const int u = static_cast<int>(q->x() + 0.5), v = static_cast<int>(q->y() + 0.5);
        if (std::abs(b.depth(u, v) - p.z()) > 0.02 * p.z()) continue;  // hidden
        error.push_back(std::abs(bilinear(b.radiance, q->x(), q->y()) - a.radiance(x, y)));
      }
    CHECK(error.size() > 150000);
    // A grey value is about 1/85 of the mean radiance here; noise of a real camera is about one.
    double mean = 0;
    for (int y = 0; y < 400; ++y)
      for (int x = 0; x < 640; ++x) mean += a.radiance(x, y) / (640 * 400);
    CHECK(median(error) < mean / 85);
  }
}

TEST_CASE("images are the same for every number of threads, and from one build to the next") {
  const Camera c = camera();
  const SE3d T = look(0.8, 1.9, 0.08, 0.1, 0.08);
  RenderedView first;
  renderer().render(c, T, first);
  for (const int threads : {1, 2, 3}) {
    RendererOptions options = quick();
    options.threads = threads;
    RenderedView view;
    Renderer(room(), options).render(c, T, view);
    CHECK(same(first, view));
  }
}

TEST_CASE("a surface looks the same from near, reduced, as from far") {
  // A wall with a pattern seen from 0.8 m at four times the focal length and reduced by four, against the
  // same view at the plain focal length: mean, contrast and each pixel must agree.
  for (const char* material : {"wallpaper", "bricks", "plaster", "oak"}) {
    Scene scene = room();
    scene.objects.clear();
    scene.windows.clear();
    scene.rooms[0].walls = material;
    const Renderer r(scene, quick());
    for (const double yaw : {3.14159, 2.2}) {
      const SE3d T = look(2.0, 2.0, 1.0, yaw, 0.0);
      const Camera far({60, 60, 39.5, 29.5}, Distortion::none, {}, 80, 60);
      const Camera near({480, 480, 319.5, 239.5}, Distortion::none, {}, 640, 480);
      RenderedView a, b;
      r.render(far, T, a);
      r.render(near, T, b);
      double mean_a = 0, mean_b = 0, cross = 0, power_a = 0, power_b = 0;
      std::vector<double> va, vb;
      for (int y = 0; y < 60; ++y)
        for (int x = 0; x < 80; ++x) {
          double sum = 0;
          for (int j = 0; j < 8; ++j)
            for (int i = 0; i < 8; ++i) sum += b.radiance(8 * x + i, 8 * y + j) / 64;
          va.push_back(a.radiance(x, y));
          vb.push_back(sum);
          mean_a += a.radiance(x, y) / 4800;
          mean_b += sum / 4800;
        }
      for (std::size_t i = 0; i < va.size(); ++i) {
        cross += (va[i] - mean_a) * (vb[i] - mean_b);
        power_a += (va[i] - mean_a) * (va[i] - mean_a);
        power_b += (vb[i] - mean_b) * (vb[i] - mean_b);
      }
      INFO(material << " yaw " << yaw << " means " << mean_a << " " << mean_b << " powers " << power_a << " "
                    << power_b);
      CHECK(mean_a == Approx(mean_b).epsilon(0.01));
      CHECK(cross / std::sqrt(power_a * power_b) > 0.95);
      CHECK(power_a / power_b == Approx(1.0).epsilon(0.25));
    }
  }
}

TEST_CASE("lamps and daylight can be dimmed apart; radiance is linear in both") {
  const RayTable rays(camera(), 4);
  ViewRequest request;
  request.T_world_camera = look(0.8, 1.9, 0.08, 0.1, 0.08);
  RenderedView all, lamps, day, dark;
  renderer().render(rays, request, all);
  request.daylight = 0;
  renderer().render(rays, request, lamps);
  request.lamps = 0;
  renderer().render(rays, request, dark);
  request.daylight = 1;
  renderer().render(rays, request, day);
  double lit = 0;
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 320; ++x) {
      REQUIRE(lamps.radiance(x, y) + day.radiance(x, y) ==
              Approx(all.radiance(x, y)).epsilon(1e-4).margin(1e-6));
      REQUIRE(dark.radiance(x, y) == 0.0f);
      lit += lamps.radiance(x, y);
    }
  CHECK(lit / (320 * 240) > 0.02);
}

TEST_CASE("things cast shadows, and light falls off with distance") {
  Scene scene = room();
  scene.objects.clear();
  scene.windows.clear();
  scene.rooms[0].floor = "bare";
  SceneObject plate;
  plate.kind = ObjectKind::box;
  plate.centre = {2, 2};
  plate.size = {1.0, 1.0, 0.05};
  plate.base = 0.8;
  scene.objects.push_back(plate);
  const Renderer r(scene, quick());
  RenderedView view;
  // From under the plate, straight down.
  const Camera c({100, 100, 49.5, 49.5}, Distortion::none, {}, 100, 100);
  const auto brightness = [&](double x, double y) {
    r.render(c, look(x, y, 0.3, 0, 1.5), view);
    double sum = 0;
    for (int v = 40; v < 60; ++v)
      for (int u = 40; u < 60; ++u) sum += view.radiance(u, v) / 400;
    return sum;
  };
  const double under = brightness(2, 2), beside = brightness(0.8, 2), corner = brightness(0.4, 0.4);
  CHECK(under < 0.4 * beside);
  CHECK(corner < 0.9 * beside);
}

TEST_CASE("a moving camera blurs along its motion, by nothing if it stands") {
  const RayTable rays(camera(), 4);
  ViewRequest request;
  request.T_world_camera = look(0.8, 1.9, 0.08, 0.1, 0.08);
  RenderedView sharp, still, moved;
  renderer().render(rays, request, sharp);
  request.blur = true;
  request.T_world_camera_open = request.T_world_camera_close = request.T_world_camera;
  renderer().render(rays, request, still);
  request.T_world_camera_open = look(0.8, 1.9, 0.08, 0.1 - 0.01, 0.08);
  request.T_world_camera_close = look(0.8, 1.9, 0.08, 0.1 + 0.01, 0.08);
  renderer().render(rays, request, moved);
  double difference = 0, steep_sharp = 0, steep_moved = 0;
  for (int y = 0; y < 240; ++y)
    for (int x = 1; x < 320; ++x) {
      difference =
          std::max(difference, static_cast<double>(std::abs(sharp.radiance(x, y) - still.radiance(x, y))));
      steep_sharp += std::abs(sharp.radiance(x, y) - sharp.radiance(x - 1, y));
      steep_moved += std::abs(moved.radiance(x, y) - moved.radiance(x - 1, y));
    }
  CHECK(difference < 1e-4);
  CHECK(steep_moved < 0.8 * steep_sharp);
}

TEST_CASE("moving things are seen before what they hide") {
  const RayTable rays(camera(), 4);
  ViewRequest request;
  request.T_world_camera = look(0.8, 1.9, 0.3, 0.0, 0.0);
  request.depth = true;
  // A ball of 0.2 m radius, 1 m ahead: its front at 0.8 m.
  MovingThing ball;
  ball.parts.push_back({{0, 0, 0}, {0, 0, 1e-4}, 0.2, 0.5});
  ball.T_world_thing = SE3d(SO3<double>(), {1.8, 1.9, 0.3});
  request.moving = {ball};
  RenderedView view;
  renderer().render(rays, request, view);
  CHECK(view.label(159, 120) == 20);
  CHECK(view.depth(159, 120) == Approx(0.8).margin(2e-3));
  CHECK(view.label(5, 200) != 20);
  request.moving = {walking_person(SE3d(SO3<double>(), {2.3, 1.9, 0}), 0.3)};
  renderer().render(rays, request, view);
  int person = 0;
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 320; ++x) person += view.label(x, y) == 20;
  CHECK(person > 1000);
  request.moving[0].parts[0].radius = -1;
  CHECK_THROWS_AS(renderer().render(rays, request, view), Error);
}

TEST_CASE("what cannot be drawn is refused") {
  Scene scene = room();
  scene.objects[0].centre = {3.99, 1};
  CHECK_THROWS_AS(Renderer(scene, quick()), Error);
  RendererOptions options = quick();
  options.samples = 0;
  CHECK_THROWS_AS(Renderer(room(), options), Error);
  options = quick();
  options.light_texel = 0;
  CHECK_THROWS_AS(Renderer(room(), options), Error);
  RenderedView view;
  CHECK_THROWS_AS(renderer().render(RayTable(camera(), 2), ViewRequest{}, view), Error);
  // A lens whose model ends within the image.
  CHECK_THROWS_AS(
      RayTable(Camera({40, 40, 320, 200}, Distortion::radial_tangential, {-0.3, 0, 0, 0}, 640, 400), 4),
      Error);
}
