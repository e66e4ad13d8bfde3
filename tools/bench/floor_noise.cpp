// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// floor_noise [--every N] [--no-ramp] [--set path=value ...] RECORDING...: how far dense
// disparities on the floor lie off the true ones, by method and by disparity, and what FloorTolerance with
// the default FloorNoise makes of them. A recording needs `depth0` with `labels` (depth of the raw left
// camera in 0.1 mm; label 1: floor, 2: carpet); they are warped to the rectified image. Pixels whose
// neighbours within 2 px belong to something else are left out. Matching expects the floor of the nominal
// mounting (base of the wheels to camera), unless told --no-ramp. The plane's own error is in none of the
// figures: the truth is that of each pixel.

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/option_text.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/floor/floor_tolerance.hpp"
#include "sweepkit/image/dense_disparity.hpp"

namespace {

using namespace sweepkit;
namespace fs = std::filesystem;

constexpr double kDepthUnit = 1e-4;     // m
constexpr double kMadToSigma = 1.4826;  // of a normal distribution
constexpr int kFloor = 1, kCarpet = 2;  // labels
constexpr double kBins[] = {2, 4, 8, 16, 32, 64, 96, 128};

/// True disparities of the rectified left image on floor and carpet; 0 elsewhere.
Image<float> true_floor(const StereoRectifier& rectifier, const cv::Mat& depth, const cv::Mat& labels) {
  const StereoRig& rig = rectifier.rig();
  Image<float> truth(rectifier.width(), rectifier.height());
  truth.fill(0);
  const auto inverse_depth = [&](int x, int y) {
    // Along the rectified axis: linear over a plane in the rectified image, nearly so in the raw one.
    const auto ray = rig.camera(Side::left).unproject(Vec2<double>(x, y));
    return ray ? 1 / ((rig.R_camera_raw(Side::left) * *ray).z() * depth.at<std::uint16_t>(y, x) * kDepthUnit)
               : 0;
  };
  for (int v = 0; v < truth.height(); ++v)
    for (int u = 0; u < truth.width(); ++u) {
      const auto p = rig.unrectify(Side::left, Vec2<double>(u, v));
      if (!p) continue;
      const int x = static_cast<int>(std::floor(p->x())), y = static_cast<int>(std::floor(p->y()));
      if (x < 2 || y < 2 || x + 3 >= depth.cols || y + 3 >= depth.rows) continue;
      const int label = labels.at<std::uint8_t>(y, x);
      bool plain = label == kFloor || label == kCarpet;
      for (int j = -2; plain && j <= 3; ++j)
        for (int i = -2; plain && i <= 3; ++i)
          plain = labels.at<std::uint8_t>(y + j, x + i) == label && depth.at<std::uint16_t>(y + j, x + i) > 0;
      if (!plain) continue;
      const double a = p->x() - x, b = p->y() - y;
      const double inverse = (1 - b) * ((1 - a) * inverse_depth(x, y) + a * inverse_depth(x + 1, y)) +
                             b * ((1 - a) * inverse_depth(x, y + 1) + a * inverse_depth(x + 1, y + 1));
      truth(u, v) = static_cast<float>(rig.focal() * rig.baseline() * inverse);
    }
  return truth;
}

struct Found {
  float truth;  // px
  float error;  // px; positive: too near; not a number where no disparity was found
};

void collect(const fs::path& folder, const DisparityOptions& options, int every, bool with_ramp,
             std::vector<Found>& found) {
  RecordingOptions reading;
  reading.use_imu = false;
  const auto recording = open_recording(folder, reading);
  StereoDisparity source(recording->rig().stereo(), options);
  DisparityRamp ramp;
  if (with_ramp) {
    if (!recording->rig().wheels)
      throw Error(ErrorKind::data, folder.string(), "has no wheels, whose base stands on the floor");
    const SE3d T_base_camera =
        recording->rig().wheels->T_body_base.inverse() * source.rectifier().rig().T_body_camera();
    const GroundPlane floor{T_base_camera.rotation().matrix().transpose() * Vec3<double>(0, 0, -1),
                            T_base_camera.translation().z()};
    ramp = floor.disparity(source.camera()).ramp(source.camera().cx);
  }
  int frame = 0;
  while (const auto sample = recording->next()) {
    const auto* image = std::get_if<StereoImage>(&*sample);
    if (!image || image->left.empty() || image->right.empty()) continue;
    const fs::path base = recording->info().path / "depth0", name = std::to_string(image->t) + ".png";
    if (!fs::exists(base / "data" / name) || frame++ % every != 0) continue;
    const cv::Mat depth = cv::imread((base / "data" / name).string(), cv::IMREAD_UNCHANGED);
    const cv::Mat labels = cv::imread((base / "labels" / name).string(), cv::IMREAD_UNCHANGED);
    if (depth.type() != CV_16U || labels.type() != CV_8U || labels.size() != depth.size())
      throw Error(ErrorKind::data, (base / "data" / name).string(), "has no 16-bit depth with 8-bit labels");
    const DisparityView disparity = source.match(image->left.view, image->right.view, ramp);
    const Image<float> truth = true_floor(source.rectifier(), depth, labels);
    for (int v = 0; v < truth.height(); ++v)
      for (int u = 0; u < truth.width(); ++u) {
        if (truth(u, v) <= 0 || u < truth(u, v)) continue;
        found.push_back({truth(u, v), disparity(u, v) > 0 ? disparity(u, v) / 16.0f - truth(u, v) : NAN});
      }
  }
}

double quantile(std::vector<double> values, double share) {
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

void print(const std::string& name, const std::vector<Found>& all, double low, double high) {
  // A plane as the cameras of the recordings have it: what matters to the tolerance is sigma alone.
  FloorNoise noise;
  noise.sigma_pitch = noise.sigma_height = 0;
  const FloorTolerance tolerance =
      FloorTolerance::of(noise, {Vec3<double>::UnitY(), 0.08}, {320, 320, 200, 0.06});
  std::vector<double> errors, sizes;
  std::size_t pixels = 0, obstacles = 0, holes = 0;
  for (const Found& f : all) {
    if (f.truth < low || f.truth >= high) continue;
    ++pixels;
    if (!(std::abs(f.error) < 1e6f)) continue;
    errors.push_back(f.error);
    sizes.push_back(std::abs(f.error));
    obstacles += f.error > tolerance.towards(f.truth);
    holes += f.error < -tolerance.away(f.truth);
  }
  if (errors.size() < 100) return;
  const double median = quantile(errors, 0.5);
  for (double& e : errors) e = std::abs(e - median);
  const double percent = 100.0 / static_cast<double>(sizes.size());
  fmt::print(
      "{:<14}{:>9}{:>8.1f}{:>+9.3f}{:>9.3f}{:>8.2f}{:>8.2f}{:>8.2f}{:>8.2f}{:>9.2f}{:>10.3f}{:>10.3f}\n",
      name, pixels, 100.0 * static_cast<double>(sizes.size()) / static_cast<double>(pixels), median,
      kMadToSigma * quantile(errors, 0.5), quantile(sizes, 0.9), quantile(sizes, 0.95), quantile(sizes, 0.99),
      quantile(sizes, 0.999), tolerance.towards((low + high) / 2), percent * static_cast<double>(obstacles),
      percent * static_cast<double>(holes));
}

}  // namespace

int main(int argc, char** argv) {
  try {
    std::vector<std::string> recordings;
    DisparityOptions options;
    int every = 1;
    bool with_ramp = true;
    for (int i = 1; i < argc; ++i) {
      const std::string argument = argv[i];
      if (argument == "--every" && i + 1 < argc) {
        every = std::max(1, std::atoi(argv[++i]));
      } else if (argument == "--no-ramp") {
        with_ramp = false;
      } else if (argument == "--set" && i + 1 < argc) {
        const std::string setting = argv[++i];
        set_option(list_options(options), setting);
      } else {
        recordings.push_back(argument);
      }
    }
    if (recordings.empty()) {
      fmt::print(stderr, "usage: floor_noise [--every N] [--no-ramp] [--set path=value ...] RECORDING...\n");
      return 2;
    }
    std::vector<Found> found;
    for (const std::string& recording : recordings) collect(recording, options, every, with_ramp, found);
    fmt::print("{:<14}{:>9}{:>8}{:>9}{:>9}{:>8}{:>8}{:>8}{:>8}{:>9}{:>10}{:>10}\n", "floor px", "pixels",
               "found %", "median", "spread", "90 %", "95 %", "99 %", "99.9 %", "allowed", "nearer %",
               "farther %");
    for (std::size_t i = 0; i + 1 < std::size(kBins); ++i)
      print(fmt::format("{:g} to {:g}", kBins[i], kBins[i + 1]), found, kBins[i], kBins[i + 1]);
    print("all", found, kBins[0], kBins[std::size(kBins) - 1]);
  } catch (const Error& error) {
    fmt::print(stderr, "floor_noise: {}\n", error.what());
    return error.kind() == ErrorKind::option ? 2 : 3;
  }
}
