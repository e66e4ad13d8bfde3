// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// disparity_accuracy RECORDING...: errors of sparse disparities against true depth, by octave and by
// disparity, and how they compare with the standard deviations that the frontend gives them. A recording
// needs `depth0` (16-bit z-depth of the raw left camera in 0.1 mm, 0: none); points where the depth varies by
// over 3 % within 2 px are left out.

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/slam/frontend.hpp"

namespace {

using namespace sweepkit;
namespace fs = std::filesystem;

constexpr double kDepthUnit = 1e-4;     // m
constexpr double kFlat = 0.03;          // largest share by which depth may vary around a point
constexpr double kMadToSigma = 1.4826;  // of a normal distribution

struct DisparityError {
  int octave;
  double truth;  // px
  double error;  // px
  double sigma;  // px
};

// The true disparity at a measurement, or nothing where the depth is unknown or not flat.
std::optional<double> true_disparity(const StereoRig& rig, const cv::Mat& depth, const Measurement& m) {
  const auto pixel = rig.unrectify(Side::left, {m.u, m.v});
  if (!pixel) return std::nullopt;
  const int x = static_cast<int>(std::lround(pixel->x())), y = static_cast<int>(std::lround(pixel->y()));
  if (x < 2 || y < 2 || x >= depth.cols - 2 || y >= depth.rows - 2) return std::nullopt;
  double low, high;
  cv::minMaxIdx(depth(cv::Rect(x - 2, y - 2, 5, 5)), &low, &high);
  if (low <= 0 || high - low > kFlat * high) return std::nullopt;
  const auto ray = rig.camera(Side::left).unproject(*pixel);
  if (!ray) return std::nullopt;
  const double z = depth.at<std::uint16_t>(y, x) * kDepthUnit;
  return rig.focal() * rig.baseline() / (rig.R_camera_raw(Side::left) * (z * *ray)).z();
}

std::vector<DisparityError> errors_of(const fs::path& folder) {
  RecordingOptions options;
  options.use_imu = options.use_wheels = false;
  const auto recording = open_recording(folder, options);
  const StereoRig rig = recording->rig().stereo();
  Frontend frontend(rig, {});
  StereoFrame frame;
  std::vector<DisparityError> errors;
  while (const auto sample = recording->next()) {
    const auto* image = std::get_if<StereoImage>(&*sample);
    if (!image || image->left.empty() || image->right.empty()) continue;
    const fs::path file = recording->info().path / "depth0" / "data" / (std::to_string(image->t) + ".png");
    if (!fs::exists(file)) continue;
    const cv::Mat depth = cv::imread(file.string(), cv::IMREAD_UNCHANGED);
    if (depth.type() != CV_16U) throw Error(ErrorKind::data, file.string(), "is no 16-bit image");
    frontend.extract(image->left.view, image->right.view);
    frontend.match(frame);
    for (const Measurement& m : frame.measurements)
      if (const auto truth = m.stereo() ? true_disparity(rig, depth, m) : std::nullopt)
        errors.push_back({m.octave, *truth, m.disparity() - *truth, m.sigma_right});
  }
  if (errors.empty()) throw Error(ErrorKind::data, folder.string(), "has no depth0 for its images");
  return errors;
}

double quantile(std::vector<double> values, double share) {
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

void print(const std::string& name, const std::vector<DisparityError>& all,
           const std::function<bool(const DisparityError&)>& chosen) {
  std::vector<double> errors, sizes, ratios, sigmas;
  for (const DisparityError& e : all) {
    if (!chosen(e)) continue;
    errors.push_back(e.error);
    sizes.push_back(std::abs(e.error));
    ratios.push_back(std::abs(e.error) / e.sigma);
    sigmas.push_back(e.sigma);
  }
  if (errors.size() < 20) return;
  const auto bad = std::count_if(sizes.begin(), sizes.end(), [](double size) { return size > 1; });
  fmt::print("{:<16}{:>8}{:>+10.3f}{:>10.3f}{:>10.3f}{:>10.1f}{:>10.3f}{:>10.2f}\n", name, errors.size(),
             quantile(errors, 0.5), kMadToSigma * quantile(sizes, 0.5), quantile(sizes, 0.9),
             100.0 * static_cast<double>(bad) / static_cast<double>(sizes.size()), quantile(sigmas, 0.5),
             kMadToSigma * quantile(ratios, 0.5));
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    fmt::print(stderr, "usage: disparity_accuracy RECORDING...\n");
    return 2;
  }
  try {
    for (int i = 1; i < argc; ++i) {
      const std::vector<DisparityError> errors = errors_of(argv[i]);
      fmt::print("{}\n{:<16}{:>8}{:>10}{:>10}{:>10}{:>10}{:>10}{:>10}\n", argv[i], "", "points", "median px",
                 "spread px", "90 % px", "bad1 %", "sigma px", "spread/s.");
      print("all", errors, [](const auto&) { return true; });
      for (int octave = 0; octave < 8; ++octave)
        print(fmt::format("octave {}", octave), errors, [&](const auto& e) { return e.octave == octave; });
      for (double low = 2; low <= 128; low *= 2)
        print(fmt::format("{:g} to {:g} px", low, 2 * low), errors,
              [&](const auto& e) { return e.truth > low && e.truth <= 2 * low; });
    }
  } catch (const Error& error) {
    fmt::print(stderr, "disparity_accuracy: {}\n", error.what());
    return 3;
  }
}
