// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Accuracy of the sparse stereo matcher against dense ground truth: 1000 key points a side, error of each
// match whose pixel has a true disparity. Takes options of the matcher as path=value (search.ratio=0.8).
// Reads Aloe of opencv-doc, and the Middlebury pairs below SWEEPKIT_DATA where that is set.
#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "sweepkit/feature/orb.hpp"
#include "sweepkit/match/stereo.hpp"

using namespace sweepkit;

namespace {

struct Pair {
  std::string name;
  cv::Mat left, right;
  cv::Mat truth;           // of the left image as it was taken
  double truth_scale = 1;  // truth value of one pixel of disparity in these images
  double truth_size = 1;   // pixels of the truth for one of these images
  int first_row = 0;       // of these images in the whole ones
};

GrayView view(const cv::Mat& m) { return {m.data, m.cols, m.rows, static_cast<std::ptrdiff_t>(m.step)}; }

struct Score {
  int matches = 0, known = 0, bad = 0;
  double median = 0, bias = 0;
};

Score score(const Pair& pair, const StereoOptions& options) {
  const int width = pair.left.cols, height = pair.left.rows;
  // Any focal length will do; as wide as the image, the range of disparity excludes nothing.
  const Camera camera({double(width), double(width), width / 2.0, height / 2.0}, Distortion::none, {}, width,
                      height);
  const SE3d T_body_right(SO3d(), {0.1, 0, 0});
  StereoMatcher matcher(StereoRig(camera, camera, SE3d(), T_body_right), options);
  const OrbOptions orb_options;
  OrbExtractor orb(orb_options);
  ImagePyramid left, right;
  left.build(view(pair.left), orb_options.levels, orb_options.scale_factor);
  right.build(view(pair.right), orb_options.levels, orb_options.scale_factor);
  Features<256> features_left, features_right;
  orb.extract(left, features_left);
  orb.extract(right, features_right);
  std::vector<StereoMatch> matches;

  Score result;
  result.matches = matcher.match(features_left, left, features_right, right, {}, matches);
  std::vector<double> errors, signed_errors;
  for (const StereoMatch& m : matches) {
    if (!m.found()) continue;
    const auto at = [&](float x) { return static_cast<int>(std::lround((x + 0.5) * pair.truth_size - 0.5)); };
    const double truth =
        pair.truth.at<std::uint8_t>(at(m.v_left + pair.first_row), at(m.u_left)) / pair.truth_scale;
    if (truth <= 0) continue;
    ++result.known;
    const double error = m.disparity - truth;
    errors.push_back(std::abs(error));
    if (std::abs(error) < 1) signed_errors.push_back(error);
    result.bad += std::abs(error) > 1;
  }
  if (errors.empty()) return result;
  std::nth_element(errors.begin(), errors.begin() + errors.size() / 2, errors.end());
  result.median = errors[errors.size() / 2];
  for (const double e : signed_errors) result.bias += e / signed_errors.size();
  return result;
}

cv::Mat read(const std::filesystem::path& file) { return cv::imread(file.string(), cv::IMREAD_GRAYSCALE); }

std::vector<Pair> pairs() {
  std::vector<Pair> all;
  const std::filesystem::path doc = "/usr/share/doc/opencv-doc/examples/data";
  const cv::Mat left = read(doc / "aloeL.jpg"), right = read(doc / "aloeR.jpg"),
                truth = read(doc / "aloeGT.png");
  if (!left.empty() && !right.empty() && !truth.empty()) {
    cv::Mat half_left, half_right;
    cv::resize(left, half_left, {}, 0.5, 0.5, cv::INTER_AREA);
    cv::resize(right, half_right, {}, 0.5, 0.5, cv::INTER_AREA);
    const cv::Range rows(77, 477);
    all.push_back(
        {"aloe half, 400 rows", half_left.rowRange(rows), half_right.rowRange(rows), truth, 2, 2, 77});
    all.push_back({"aloe full", left, right, truth, 1, 1, 0});
  }
  if (const char* data = std::getenv("SWEEPKIT_DATA")) {
    const std::filesystem::path folder = std::filesystem::path(data) / "middlebury";
    for (const auto& [name, scale] : {std::pair{"aloe", 2.0},
                                      {"teddy", 4.0},
                                      {"cones", 4.0},
                                      {"art", 3.0},
                                      {"laundry", 3.0},
                                      {"reindeer", 3.0}}) {
      const cv::Mat l = read(folder / name / "left.png"), r = read(folder / name / "right.png"),
                    t = read(folder / name / "disp_left.png");
      if (!l.empty() && !r.empty() && !t.empty())
        all.push_back({std::string("middlebury ") + name, l, r, t, scale, 1, 0});
    }
  }
  return all;
}

}  // namespace

int main(int argc, char** argv) {
  StereoOptions options;
  OptionList list = list_options(options);
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    const auto equals = argument.find('=');
    const OptionRef* option = list.find(argument.substr(0, equals));
    if (!option || equals == std::string::npos) {
      fmt::print(stderr, "no such option: {}\n", argument);
      for (const OptionRef& o : list) fmt::print(stderr, "  {}  {}\n", o.path, o.doc);
      return 2;
    }
    const std::string value = argument.substr(equals + 1);
    if (auto* const* d = std::get_if<double*>(&option->pointer)) **d = std::stod(value);
    if (auto* const* n = std::get_if<int*>(&option->pointer)) **n = std::stoi(value);
    if (auto* const* b = std::get_if<bool*>(&option->pointer)) **b = value == "1" || value == "true";
  }
  fmt::print("{:22} {:>8} {:>9} {:>9} {:>8} {:>9}\n", "", "matches", "in truth", "median", "bad1",
             "mean<1px");
  for (const Pair& pair : pairs()) {
    const Score s = score(pair, options);
    fmt::print("{:22} {:8} {:9} {:6.3f} px {:6.2f} % {:+6.3f} px\n", pair.name, s.matches, s.known, s.median,
               s.known ? 100.0 * s.bad / s.known : 0.0, s.bias);
  }
}
