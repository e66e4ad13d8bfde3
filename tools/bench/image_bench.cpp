// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Pyramid (8 levels, factor 1.2) and blur of a 640x400 image of noise, one thread. The bound counts bytes:
// each pixel of a level is read once and written once, 64 bytes a cycle at 4 GHz.
#include <benchmark/benchmark.h>

#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "sweepkit/image/blur.hpp"
#include "sweepkit/image/image.hpp"
#include "sweepkit/image/pyramid.hpp"

namespace {

using namespace sweepkit;

constexpr int kWidth = 640, kHeight = 400, kLevels = 8;
constexpr double kFactor = 1.2;

const cv::Mat& scene() {
  static const cv::Mat image = [] {
    cv::setNumThreads(1);
    cv::Mat m(kHeight, kWidth, CV_8U);
    cv::randu(m, 0, 255);
    return m;
  }();
  return image;
}

GrayView view(const cv::Mat& m) { return {m.data, m.cols, m.rows, static_cast<std::ptrdiff_t>(m.step)}; }

double us_bound(double pixels) { return 2 * pixels / 64 / 4e9 * 1e6; }

void pyramid_sweepkit(benchmark::State& state) {
  ImagePyramid pyramid;
  for (auto _ : state) pyramid.build(view(scene()), kLevels, kFactor);
  double pixels = 0;
  for (int l = 0; l < kLevels; ++l) pixels += pyramid.level(l).width * pyramid.level(l).height;
  state.counters["us_bound"] = us_bound(pixels);
}
BENCHMARK(pyramid_sweepkit)->Name("image/pyramid/sweepkit/640x400")->Unit(benchmark::kMicrosecond);

void pyramid_opencv(benchmark::State& state) {
  const cv::Mat& image = scene();
  std::vector<cv::Mat> levels(kLevels);
  for (auto _ : state) {
    image.copyTo(levels[0]);
    for (int l = 1; l < kLevels; ++l) {
      const double scale = std::pow(kFactor, l);
      cv::resize(levels[l - 1], levels[l],
                 cv::Size(static_cast<int>(std::lround(kWidth / scale)),
                          static_cast<int>(std::lround(kHeight / scale))),
                 0, 0, cv::INTER_LINEAR);
    }
  }
}
BENCHMARK(pyramid_opencv)->Name("image/pyramid/opencv/640x400")->Unit(benchmark::kMicrosecond);

void blur_sweepkit(benchmark::State& state) {
  GaussianBlur7 blur;
  GrayImage target(kWidth, kHeight);
  for (auto _ : state) blur(view(scene()), target.view());
  state.counters["us_bound"] = us_bound(kWidth * kHeight);
}
BENCHMARK(blur_sweepkit)->Name("image/blur/sweepkit/640x400")->Unit(benchmark::kMicrosecond);

void blur_opencv(benchmark::State& state) {
  const cv::Mat& image = scene();
  cv::Mat target;
  for (auto _ : state) cv::GaussianBlur(image, target, {7, 7}, 2, 2, cv::BORDER_REPLICATE);
}
BENCHMARK(blur_opencv)->Name("image/blur/opencv/640x400")->Unit(benchmark::kMicrosecond);

}  // namespace
