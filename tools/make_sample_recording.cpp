// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// Draws a short stereo drive through a furnished room, with truth: something to run on at once. Rays are cast
// through the distorted cameras; surfaces carry patches of all sizes (Lee, Mumford, Huang, Occlusion models
// for natural images, IJCV 2001: "dead leaves"), filtered over the footprint of a ray, four rays a pixel.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <limits>
#include <string>
#include <vector>

#include "command_line.hpp"
#include "sweepkit/core/parallel.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/data/image_file.hpp"
#include "sweepkit/geometry/camera.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/image/image.hpp"

namespace sweepkit {
namespace {

namespace fs = std::filesystem;

struct SampleOptions {
  std::string save_path;
  double seconds = 10.0;
  double rate = 10.0;
  double noise = 1.5;
  int seed = 1;
  int threads = 0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(save_path, "save_path", "", any_value(), "folder for the recording; made if needed");
    v(seconds, "seconds", "s", range(0.5, 16.0), "length of the drive");
    v(rate, "rate", "Hz", range(1.0, 50.0), "images a second");
    v(noise, "noise", "", range(0.0, 20.0), "standard deviation of the noise of a pixel [grey levels]");
    v(seed, "seed", "", range(0, 2147483647), "of textures and noise");
    v(threads, "threads", "", range(0, 64), "threads that draw; 0: as many as the machine has");
  }
};

// A square of texture that repeats, in halved sizes.
class Texture {
 public:
  static constexpr int kSize = 1024;
  static constexpr float kTexel = 0.004f;  // [m]

  explicit Texture(std::uint64_t seed) {
    Random random(seed);
    std::vector<float> full(kSize * kSize, 128.0f);
    // Sizes r with a density like r^-3 from 2 to 150 texels: alike at every distance.
    for (int leaf = 0; leaf < 9000; ++leaf) {
      constexpr double kSmallest = 2.0, kLargest = 150.0;
      const double share = random.uniform();
      const double r =
          kSmallest / std::sqrt(1.0 - share * (1.0 - (kSmallest * kSmallest) / (kLargest * kLargest)));
      const double flat = random.uniform(0.4, 1.0), angle = random.uniform(0.0, 6.283185307179586);
      const double c = std::cos(angle), s = std::sin(angle);
      const double x0 = random.uniform(0.0, kSize), y0 = random.uniform(0.0, kSize);
      const auto grey = static_cast<float>(random.uniform(25.0, 230.0));
      const bool round = random.uniform() < 0.3;
      const int reach = static_cast<int>(1.5 * r) + 1;
      for (int y = -reach; y <= reach; ++y)
        for (int x = -reach; x <= reach; ++x) {
          const double a = (c * x + s * y) / r, b = (c * y - s * x) / (flat * r);
          if (round ? a * a + b * b > 1.0 : std::max(std::abs(a), std::abs(b)) > 1.0) continue;
          const int u = (static_cast<int>(x0) + x) & (kSize - 1),
                    v = (static_cast<int>(y0) + y) & (kSize - 1);
          full[static_cast<std::size_t>(v) * kSize + u] = grey;
        }
    }
    levels_.push_back(std::move(full));
    for (int size = kSize / 2; size >= 1; size /= 2) {
      const std::vector<float>& fine = levels_.back();
      std::vector<float> coarse(static_cast<std::size_t>(size) * size);
      for (int y = 0; y < size; ++y)
        for (int x = 0; x < size; ++x) {
          const float* p = &fine[static_cast<std::size_t>(2 * y) * 2 * size + 2 * x];
          coarse[static_cast<std::size_t>(y) * size + x] =
              0.25f * (p[0] + p[1] + p[2 * size] + p[2 * size + 1]);
        }
      levels_.push_back(std::move(coarse));
    }
  }

  // Mean grey about a place [m] over that width [m]: between two sizes, each bilinear.
  float mean(float u, float v, float width) const {
    const float level =
        std::clamp(std::log2(std::max(width / kTexel, 1.0f)), 0.0f, static_cast<float>(levels_.size() - 2));
    const int l = static_cast<int>(level);
    const float share = level - static_cast<float>(l);
    const float fine = bilinear(l, u, v);
    return share > 0.0f ? fine + share * (bilinear(l + 1, u, v) - fine) : fine;
  }

 private:
  float bilinear(int l, float u, float v) const {
    const int size = kSize >> l;
    const float texels = 1.0f / (kTexel * static_cast<float>(1 << l));
    const float x = u * texels - 0.5f, y = v * texels - 0.5f;
    const float fx = std::floor(x), fy = std::floor(y);
    const int x0 = static_cast<int>(fx) & (size - 1), y0 = static_cast<int>(fy) & (size - 1);
    const int x1 = (x0 + 1) & (size - 1), y1 = (y0 + 1) & (size - 1);
    const std::vector<float>& p = levels_[static_cast<std::size_t>(l)];
    const float a = x - fx, b = y - fy;
    const float top = p[y0 * size + x0] + a * (p[y0 * size + x1] - p[y0 * size + x0]);
    const float bottom = p[y1 * size + x0] + a * (p[y1 * size + x1] - p[y1 * size + x0]);
    return top + b * (bottom - top);
  }

  std::vector<std::vector<float>> levels_;
};

struct Box {
  Vec3<float> low, high;
};

// A room of 6 m x 5 m x 2.5 m, floor at z = 0, and what stands in it.
class Scene {
 public:
  explicit Scene(int seed) {
    for (std::uint64_t i = 0; i < 3; ++i) textures_.emplace_back(static_cast<std::uint64_t>(seed) * 3 + i);
  }

  // Grey seen along a unit ray whose width grows by `spread` [rad].
  float grey(const Vec3<float>& origin, const Vec3<float>& ray, float spread) const {
    const Vec3<float> inverse = ray.cwiseInverse();
    float nearest = std::numeric_limits<float>::infinity();
    std::size_t what = 0;
    int axis = 0;
    // The room is left by the first of its far sides.
    for (int k = 0; k < 3; ++k) {
      const float t = ((ray[k] > 0 ? kRoom.high[k] : kRoom.low[k]) - origin[k]) * inverse[k];
      if (t < nearest) nearest = t, axis = k;
    }
    for (std::size_t i = 0; i < kBoxes.size(); ++i) {
      float enter = 0.0f, leave = nearest;
      int side = -1;
      for (int k = 0; k < 3; ++k) {
        float a = (kBoxes[i].low[k] - origin[k]) * inverse[k];
        float b = (kBoxes[i].high[k] - origin[k]) * inverse[k];
        if (a > b) std::swap(a, b);
        if (a > enter) enter = a, side = k;
        leave = std::min(leave, b);
      }
      if (side >= 0 && enter < leave) nearest = enter, axis = side, what = i + 1;
    }
    const Vec3<float> p = origin + nearest * ray;
    const int u = axis == 0 ? 1 : 0, v = axis == 2 ? 1 : 2;
    const float slant = std::max(std::abs(ray[axis]), 0.15f);
    // Each surface looks at another part of a texture; those turned away from the lamp are darker.
    const std::size_t surface = 6 * what + 2 * static_cast<std::size_t>(axis) + (ray[axis] > 0 ? 1 : 0);
    const float shift = 0.7310585f * static_cast<float>(surface);
    constexpr std::array<float, 6> kLight = {0.9f, 0.75f, 0.85f, 1.0f, 0.95f, 0.8f};
    return kLight[surface % 6] *
           textures_[surface % 3].mean(p[u] + shift, p[v] + 1.7f * shift, nearest * spread / slant);
  }

 private:
  inline static const Box kRoom{{-3.0f, -2.5f, 0.0f}, {3.0f, 2.5f, 2.5f}};
  inline static const std::array<Box, 9> kBoxes = {{
      {{1.6f, -2.3f, 0.0f}, {2.6f, -1.5f, 0.75f}},     // chest
      {{2.3f, -0.5f, 0.0f}, {2.9f, 0.7f, 1.8f}},       // cupboard
      {{0.9f, 1.9f, 0.0f}, {2.4f, 2.45f, 0.9f}},       // sideboard
      {{-0.9f, 1.6f, 0.0f}, {-0.2f, 2.2f, 0.45f}},     // stool
      {{-2.8f, 1.2f, 0.0f}, {-1.6f, 2.4f, 0.6f}},      // bed
      {{0.5f, -1.9f, 0.0f}, {0.9f, -1.5f, 0.35f}},     // box
      {{1.7f, 1.0f, 0.0f}, {1.95f, 1.25f, 0.3f}},      // small box
      {{1.3f, -0.6f, 0.55f}, {1.9f, -0.1f, 0.6f}},     // table top, floating: its foot is thin
      {{1.58f, -0.37f, 0.0f}, {1.62f, -0.33f, 0.55f}}  // and this is it
  }};
  std::vector<Texture> textures_;
};

// A drive at 0.4 m/s in curves: speed and turn rate are smooth in time. Poses are of the body on the floor: x
// forward, y left, z up.
class Drive {
 public:
  explicit Drive(double seconds) {
    constexpr double kStep = 1e-3;
    double x = -1.9, y = -1.5, yaw = 0.05;
    for (int i = 0; i * kStep <= seconds + 0.5 * kStep; ++i) {
      poses_.emplace_back(SO3d::exp({0.0, 0.0, yaw}), Vec3<double>(x, y, 0.0));
      const double t = (i + 0.5) * kStep;
      const double start = std::min(t, 1.0), speed = 0.4 * start * start * (3.0 - 2.0 * start);
      const double rate = start * 0.5 * std::sin(6.283185307179586 * t / 8.0);
      x += kStep * speed * std::cos(yaw + 0.5 * kStep * rate);
      y += kStep * speed * std::sin(yaw + 0.5 * kStep * rate);
      yaw += kStep * rate;
    }
  }
  // T_world_body at a whole millisecond.
  const SE3d& pose(TimeNs since_start) const {
    return poses_[std::min(static_cast<std::size_t>(since_start / 1'000'000), poses_.size() - 1)];
  }

 private:
  std::vector<SE3d> poses_;
};

struct Mounted {
  Camera camera;
  SE3d T_body_camera;
};

// Two cameras 6 cm apart, looking forward and 3 degrees down, each a little off in its own way.
std::array<Mounted, 2> cameras() {
  Mat3<double> R_body_camera;  // x right, y down, z forward in the camera
  R_body_camera << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  const SO3d forward(R_body_camera), down = SO3d::exp({-0.05, 0.0, 0.0});
  return {{{Camera({349.2, 349.4, 318.3, 198.7}, Distortion::radial_tangential,
                   {-0.101, 0.0203, -0.0004, 0.0005}, 640, 400),
            SE3d(forward * down * SO3d::exp({0.004, -0.003, 0.006}), {0.12, 0.030, 0.08})},
           {Camera({346.5, 346.4, 321.9, 201.1}, Distortion::radial_tangential,
                   {-0.099, 0.0209, -0.0002, -0.0003}, 640, 400),
            SE3d(forward * down * SO3d::exp({-0.005, 0.002, -0.004}), {0.1205, -0.030, 0.0797})}}};
}

// Four rays for each pixel in the body's axes, the pixels by rows.
std::vector<Vec3<float>> body_rays(const Mounted& mounted) {
  const Camera& camera = mounted.camera;
  std::vector<Vec3<float>> rays;
  rays.reserve(static_cast<std::size_t>(camera.width()) * camera.height() * 4);
  for (int y = 0; y < camera.height(); ++y)
    for (int x = 0; x < camera.width(); ++x)
      for (const auto& [dx, dy] : {std::pair(-0.25, -0.25), {0.25, -0.25}, {-0.25, 0.25}, {0.25, 0.25}}) {
        const auto ray = camera.unproject({x + dx, y + dy});
        if (!ray) throw Error(ErrorKind::calibration, "sample camera", "does not see all of its image");
        rays.push_back((mounted.T_body_camera.rotation() * ray->normalized()).cast<float>());
      }
  return rays;
}

GrayImage draw(const Scene& scene, const Mounted& mounted, const std::vector<Vec3<float>>& rays,
               const SE3d& T_world_body, double noise, std::uint64_t seed) {
  const Camera& camera = mounted.camera;
  GrayImage image(camera.width(), camera.height());
  const Vec3<float> origin = (T_world_body * mounted.T_body_camera.translation()).cast<float>();
  const Mat3<float> R = T_world_body.rotation().matrix().cast<float>();
  const float spread = 0.5f / static_cast<float>(camera.fx());
  Random random(seed);
  const Vec3<float>* ray = rays.data();
  for (int y = 0; y < camera.height(); ++y)
    for (int x = 0; x < camera.width(); ++x) {
      float sum = 0.0f;
      for (int i = 0; i < 4; ++i) sum += scene.grey(origin, R * *ray++, spread);
      image(x, y) = static_cast<std::uint8_t>(
          std::clamp(0.25f * sum + static_cast<float>(random.normal(0.0, noise)) + 0.5f, 0.0f, 255.0f));
    }
  return image;
}

std::ofstream create(const fs::path& file) {
  fs::create_directories(file.parent_path());
  std::ofstream stream(file);
  if (!stream) throw Error(ErrorKind::io, file.string(), "cannot be written");
  return stream;
}

void write_sensor(const fs::path& file, const Mounted& mounted, double rate) {
  const Eigen::Matrix4d T = mounted.T_body_camera.matrix();
  std::string matrix;
  for (int i = 0; i < 16; ++i) matrix += fmt::format("{}{:.12g}", i ? ", " : "", T(i / 4, i % 4));
  const auto& k = mounted.camera.coefficients();
  const auto& f = mounted.camera.intrinsics();
  create(file) << fmt::format(
      "sensor_type: camera\ncomment: drawn by make_sample_recording\nT_BS:\n  cols: 4\n  rows: 4\n  data: "
      "[{}]\n"
      "rate_hz: {}\nresolution: [{}, {}]\ncamera_model: pinhole\nintrinsics: [{}, {}, {}, {}]\n"
      "distortion_model: radial-tangential\ndistortion_coefficients: [{}, {}, {}, {}]\n",
      matrix, rate, mounted.camera.width(), mounted.camera.height(), f[0], f[1], f[2], f[3], k[0], k[1], k[2],
      k[3]);
}

int make(const SampleOptions& options) {
  if (options.save_path.empty()) throw Error(ErrorKind::option, "save_path", "is needed: --out DIR");
  constexpr TimeNs kBegin = 1'700'000'000 * kNsPerSecond;
  const fs::path root = fs::path(options.save_path) / "mav0";
  fs::remove_all(root);
  const Scene scene(options.seed);
  const Drive drive(options.seconds);
  const auto rig = cameras();
  // Whole milliseconds, which the drive is known at.
  const TimeNs step = from_seconds(std::round(1000.0 / options.rate) / 1000.0);
  const auto count = static_cast<std::size_t>(from_seconds(options.seconds) / step) + 1;

  for (std::size_t side = 0; side < 2; ++side) {
    const fs::path folder = root / fmt::format("cam{}", side);
    write_sensor(folder / "sensor.yaml", rig[side], options.rate);
    std::ofstream list = create(folder / "data.csv");
    list << "#timestamp [ns],filename\n";
    for (std::size_t i = 0; i < count; ++i) {
      const TimeNs t = kBegin + static_cast<TimeNs>(i) * step;
      list << fmt::format("{},{}.png\n", t, t);
    }
    fs::create_directories(folder / "data");
    const std::vector<Vec3<float>> rays = body_rays(rig[side]);
    parallel_for(count, options.threads, [&](std::size_t i) {
      if (interrupted()) return;
      const TimeNs t = static_cast<TimeNs>(i) * step;
      const std::uint64_t seed = (static_cast<std::uint64_t>(options.seed) << 32) + 2 * i + side;
      const GrayImage image = draw(scene, rig[side], rays, drive.pose(t), options.noise, seed);
      write_png(folder / "data" / fmt::format("{}.png", kBegin + t), image);
    });
  }
  std::ofstream truth = create(root / "state_groundtruth_estimate0" / "data.csv");
  truth << "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], "
           "q_RS_z []\n";
  for (TimeNs t = 0; t <= from_seconds(options.seconds); t += 10'000'000) {
    const SE3d& T = drive.pose(t);
    const auto& q = T.rotation().quaternion();
    truth << fmt::format("{},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f}\n", kBegin + t,
                         T.translation().x(), T.translation().y(), T.translation().z(), q.w(), q.x(), q.y(),
                         q.z());
  }
  truth.close();
  if (!truth) throw Error(ErrorKind::io, root.string(), "cannot be written");
  fmt::print("{} stereo images in {}\n", count, root.string());
  return 0;
}

}  // namespace
}  // namespace sweepkit

int main(int argc, char** argv) {
  using namespace sweepkit;
  SampleOptions options;
  const ProgramInfo info{
      "make_sample_recording",
      "Draws a short stereo drive through a furnished room, in EuRoC's layout and with truth.",
      {"make_sample_recording --out sample"},
      {{"--out", "save_path"}, {"--seconds", "seconds"}}};
  return run_program(argc, argv, info, list_options(options), [&] { return make(options); });
}
