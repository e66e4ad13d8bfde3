// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// Whether simulated images agree with the truth that is written beside them.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <filesystem>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "scratch_folder.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/simulate.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/feature/orb.hpp"

using namespace sweepkit;
namespace fs = std::filesystem;

namespace {

const char* const kScene = R"(
name: box
rooms:
  - {name: room, rect: [0, 0, 4, 3], floor: oak, walls: wallpaper}
objects:
  - {kind: cabinet, at: [2.2, 2.6], size: [1.0, 0.4, 0.9]}
  - {kind: shelf, at: [3.8, 1.5], yaw: -90, size: [1.2, 0.3, 1.6]}
  - {kind: carton, at: [3.0, 1.9], yaw: 20, size: [0.4, 0.3, 0.3]}
  - {kind: carpet, at: [2.4, 0.9], size: [1.0, 0.8, 0.008]}
lights:
  - {at: [2, 1.5, 2.3], power: 4}
sensors:
  cameras:
    width: 400
    height: 250
    left: {intrinsics: [217, 217, 199, 124]}
    right: {intrinsics: [216, 216, 201, 126]}
drive:
  start: [1, 1.4, 5]
  steps:
    - stand: 0.2
    - drive: [[2.2, 1.5]]
)";

// A recording of two pairs of images, made once.
struct Made {
  ScratchFolder folder;
  SimulationOptions options;
  std::vector<TimeNs> stamps;
  std::vector<cv::Mat> left, right, depth, label;
  Trajectory truth;

  Made() {
    const SimulatedScene scene = parse_simulated_scene(kScene, "scene.yaml", options);
    options.save_path = (folder / "made").string();
    options.duration = 1.2;
    options.depth_every = 1;
    options.sensors.cameras.rate_hz = 1;
    options.sensors.cameras.motion_blur = false;
    options.sensors.cameras.exposure.vignetting = 0;
    options.sensors.cameras.exposure.automatic = false;
    options.sensors.cameras.exposure.white = 170;
    options.renderer.light_rays = 8;
    options.renderer.light_texel = 0.1;
    simulate(scene, options);
    truth = read_trajectory(folder / "made");
    const fs::path root = folder / "made" / "mav0";
    for (const auto& entry : fs::directory_iterator(root / "cam0" / "data"))
      stamps.push_back(std::stoll(entry.path().stem().string()));
    std::sort(stamps.begin(), stamps.end());
    for (const TimeNs t : stamps) {
      const auto read = [&](const char* where) {
        return cv::imread((root / where / (std::to_string(t) + ".png")).string(), cv::IMREAD_UNCHANGED);
      };
      left.push_back(read("cam0/data"));
      right.push_back(read("cam1/data"));
      depth.push_back(read("depth0/data"));
      label.push_back(read("depth0/labels"));
    }
  }

  SE3d T_world_left(std::size_t i) const {
    return *interpolate(truth, stamps[i]) * options.sensors.rig().left->T_body_camera;
  }
  SE3d T_left_right() const { return options.sensors.rig().stereo().T_left_right(); }
};

const Made& made() {
  static const Made kMade;
  return kMade;
}

double median(std::vector<double> values) {
  REQUIRE(!values.empty());
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2),
                   values.end());
  return values[values.size() / 2];
}

// The pixel's point in its camera.
Vec3<double> point_of(const Camera& camera, const cv::Mat& depth, int x, int y) {
  return *camera.unproject({x, y}) * (1e-4 * depth.at<std::uint16_t>(y, x));
}

// Differences in grey of an image to another that sees the same points.
std::vector<double> differences(const Camera& from, const cv::Mat& image, const cv::Mat& depth,
                                const Camera& to, const cv::Mat& other, const SE3d& T_to_from) {
  std::vector<double> d;
  for (int y = 3; y < image.rows - 3; y += 6)
    for (int x = 3; x < image.cols - 3; x += 6) {
      if (depth.at<std::uint16_t>(y, x) == 0) continue;
      const auto at = to.project<double>(T_to_from * point_of(from, depth, x, y));
      if (!at || at->x() < 1 || at->y() < 1 || at->x() > other.cols - 2 || at->y() > other.rows - 2) continue;
      const int x0 = static_cast<int>(at->x()), y0 = static_cast<int>(at->y());
      const double a = at->x() - x0, b = at->y() - y0;
      const auto grey = [&](int u, int v) { return static_cast<double>(other.at<std::uint8_t>(v, u)); };
      const double there = (1 - b) * ((1 - a) * grey(x0, y0) + a * grey(x0 + 1, y0)) +
                           b * ((1 - a) * grey(x0, y0 + 1) + a * grey(x0 + 1, y0 + 1));
      d.push_back(std::abs(there - image.at<std::uint8_t>(y, x)));
    }
  return d;
}

GrayView view(const cv::Mat& m) { return {m.data, m.cols, m.rows, static_cast<std::ptrdiff_t>(m.step)}; }

}  // namespace

TEST_CASE("the depth of the floor is that of its plane", "[simulate]") {
  const Made& m = made();
  const Camera camera = m.options.sensors.cameras.camera(Side::left);
  REQUIRE(m.stamps.size() == 2);
  for (std::size_t i = 0; i < m.stamps.size(); ++i) {
    const SE3d T = m.T_world_left(i);
    double worst = 0;
    int pixels = 0;
    for (int y = 0; y < m.depth[i].rows; y += 5)
      for (int x = 0; x < m.depth[i].cols; x += 5) {
        if (m.label[i].at<std::uint8_t>(y, x) != 1 || m.depth[i].at<std::uint16_t>(y, x) == 0) continue;
        worst = std::max(worst, std::abs((T * point_of(camera, m.depth[i], x, y)).z()));
        ++pixels;
      }
    CHECK(pixels > 1000);
    CHECK(worst < 2e-4);
  }
}

TEST_CASE("true depth carries an image into the other camera and into the next image", "[simulate]") {
  const Made& m = made();
  const SimulatedCameras& cameras = m.options.sensors.cameras;
  const Camera left = cameras.camera(Side::left), right = cameras.camera(Side::right);
  std::vector<double> grey;
  for (int y = 0; y < m.left[0].rows; ++y)
    for (int x = 0; x < m.left[0].cols; ++x) grey.push_back(m.left[0].at<std::uint8_t>(y, x));
  // Two images with noise, one of them a mean of four pixels: its noise is between one half and all.
  const ExposureOptions& e = cameras.exposure;
  const double sigma = std::sqrt(e.read_noise * e.read_noise + e.shot_noise * median(grey) + 1.0 / 12);
  const double expected = 0.6745 * sigma * std::sqrt(1.0 + 4.0 / 9.0);
  for (std::size_t i = 0; i < m.stamps.size(); ++i) {
    const double across =
        median(differences(left, m.left[i], m.depth[i], right, m.right[i], m.T_left_right().inverse()));
    CAPTURE(i, across, expected);
    // Sampling of fine texture adds to the noise.
    CHECK(across < 2.0 * expected);
    if (i + 1 == m.stamps.size()) continue;
    const SE3d T_next_this = m.T_world_left(i + 1).inverse() * m.T_world_left(i);
    const double along = median(differences(left, m.left[i], m.depth[i], left, m.left[i + 1], T_next_this));
    CAPTURE(along);
    CHECK(along < 2.0 * expected);
  }
}

TEST_CASE("ORB matches lie where true depth says", "[simulate]") {
  const Made& m = made();
  const Camera left = m.options.sensors.cameras.camera(Side::left),
               right = m.options.sensors.cameras.camera(Side::right);
  OrbExtractor orb;
  for (std::size_t i = 0; i < m.stamps.size(); ++i) {
    Features<256> a, b;
    orb.extract(view(m.left[i]), a);
    orb.extract(view(m.right[i]), b);
    std::vector<double> off;
    int points = 0;
    for (std::size_t k = 0; k < a.keypoints.size(); ++k) {
      const KeyPoint& p = a.keypoints[k];
      if (p.octave > 0) continue;
      const int x = static_cast<int>(std::lround(p.x)), y = static_cast<int>(std::lround(p.y));
      // Corners at edges of depth belong to neither side.
      std::uint16_t low = 65535, high = 0;
      for (int v = -2; v <= 2; ++v)
        for (int u = -2; u <= 2; ++u) {
          const std::uint16_t z = m.depth[i].at<std::uint16_t>(y + v, x + u);
          low = std::min(low, z), high = std::max(high, z);
        }
      if (low == 0 || high > 1.1 * low) continue;
      const Vec3<double> q = *left.unproject({p.x, p.y}) * (1e-4 * m.depth[i].at<std::uint16_t>(y, x));
      const auto at = right.project<double>(m.T_left_right().inverse() * q);
      if (!at || at->x() < 25 || at->y() < 25 || at->x() > 375 || at->y() > 225) continue;
      ++points;
      // The best of all that lie within 20 px, if it is good.
      int best = 41;
      double distance = 0;
      for (std::size_t j = 0; j < b.keypoints.size(); ++j) {
        const double d = std::hypot(b.keypoints[j].x - at->x(), b.keypoints[j].y - at->y());
        if (d > 20 || b.keypoints[j].octave > 1) continue;
        const int bits = hamming_distance(a.descriptors[k], b.descriptors[j]);
        if (bits < best) best = bits, distance = d;
      }
      if (best < 41) off.push_back(distance);
    }
    CAPTURE(i, points, off.size(), median(off));
    CHECK(points > 40);
    CHECK(off.size() > 10);
    CHECK(median(off) < 0.5);
  }
}
