// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Features of one 640x400 image: the middle of opencv-doc's graf1.png, or a made scene where that is missing.
// One thread.
#include <benchmark/benchmark.h>

#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

#include "sweepkit/feature/hamming.hpp"
#include "sweepkit/feature/orb.hpp"

namespace {

using namespace sweepkit;

const cv::Mat& scene() {
  static const cv::Mat image = [] {
    cv::setNumThreads(1);
    cv::Mat m = cv::imread("/usr/share/doc/opencv-doc/examples/data/graf1.png", cv::IMREAD_GRAYSCALE);
    if (m.empty()) {
      m.create(512, 640, CV_8U);
      cv::RNG random(1);
      for (int i = 0; i < 1500; ++i)
        cv::rectangle(m,
                      cv::Rect(random.uniform(0, 600), random.uniform(0, 480), random.uniform(4, 40),
                               random.uniform(4, 40)),
                      random.uniform(0, 255), cv::FILLED);
    }
    cv::resize(m, m, {640, 512}, 0, 0, cv::INTER_AREA);
    return cv::Mat(m(cv::Rect(0, 56, 640, 400)).clone());
  }();
  return image;
}

GrayView view(const cv::Mat& m) { return {m.data, m.cols, m.rows, static_cast<std::ptrdiff_t>(m.step)}; }

void orb_sweepkit(benchmark::State& state) {
  OrbOptions options;
  options.count = static_cast<int>(state.range(0));
  OrbExtractor extractor(options);
  Features<256> features;
  for (auto _ : state) extractor.extract(view(scene()), features);
  state.counters["keypoints"] = static_cast<double>(features.size());
}
BENCHMARK(orb_sweepkit)->Name("feature/orb/sweepkit")->Arg(1000)->Arg(2000)->Unit(benchmark::kMillisecond);

void orb_portable(benchmark::State& state) {
  const ScopedSimdLevel level(SimdLevel::portable);
  orb_sweepkit(state);
}
BENCHMARK(orb_portable)->Name("feature/orb/sweepkit_portable")->Arg(1000)->Unit(benchmark::kMillisecond);

void orb_opencv(benchmark::State& state) {
  const cv::Mat& image = scene();
  const auto orb = cv::ORB::create(static_cast<int>(state.range(0)), 1.2f, 8, 31, 0, 2, cv::ORB::FAST_SCORE);
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  for (auto _ : state) orb->detectAndCompute(image, cv::noArray(), keypoints, descriptors);
  state.counters["keypoints"] = static_cast<double>(keypoints.size());
}
BENCHMARK(orb_opencv)->Name("feature/orb/opencv")->Arg(1000)->Arg(2000)->Unit(benchmark::kMillisecond);

void fast_sweepkit(benchmark::State& state) {
  FastDetector detector;
  std::vector<Corner> corners;
  for (auto _ : state) detector.detect(view(scene()), 20, 3, corners);
  state.counters["corners"] = static_cast<double>(corners.size());
}
BENCHMARK(fast_sweepkit)->Name("feature/fast/sweepkit/640x400")->Unit(benchmark::kMicrosecond);

void fast_opencv(benchmark::State& state) {
  const cv::Mat& image = scene();
  std::vector<cv::KeyPoint> corners;
  for (auto _ : state) cv::FAST(image, corners, 20, true);
  state.counters["corners"] = static_cast<double>(corners.size());
}
BENCHMARK(fast_opencv)->Name("feature/fast/opencv/640x400")->Unit(benchmark::kMicrosecond);

/// Of level 0 alone: what each stage of ORB costs there, with 300 key points.
void orb_stage(benchmark::State& state, int stage) {
  const GrayImage image(view(scene()));
  FastDetector detector;
  SpreadSelector selector;
  GaussianBlur7 blur;
  GrayImage smoothed(image.width(), image.height());
  RotatedBrief<> brief;
  brief.prepare(smoothed.stride());
  std::vector<Corner> corners, chosen;
  OrbDescriptor descriptor;
  const auto run = [&](int s) {
    if (s == 0) detector.detect(image, 7, 19, corners);
    if (s == 1) selector.select(corners, image.width(), image.height(), 300, 60, 20, chosen);
    if (s == 2) blur(image, smoothed.view());
    if (s == 3)
      for (const Corner& c : chosen) benchmark::DoNotOptimize(centroid_angle(patch_moments(image, c.x, c.y)));
    if (s == 4)
      for (const Corner& c : chosen) {
        descriptor = brief.describe(smoothed, c.x, c.y, 0.01f * static_cast<float>(c.score));
        benchmark::DoNotOptimize(descriptor);
      }
  };
  for (int s = 0; s < 5; ++s) run(s);
  for (auto _ : state) run(stage);
}
BENCHMARK_CAPTURE(orb_stage, detect, 0)->Name("feature/orb_stage/detect")->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(orb_stage, spread, 1)->Name("feature/orb_stage/spread")->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(orb_stage, blur, 2)->Name("feature/orb_stage/blur")->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(orb_stage, angle, 3)->Name("feature/orb_stage/angle")->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(orb_stage, describe, 4)->Name("feature/orb_stage/describe")->Unit(benchmark::kMicrosecond);

std::vector<OrbDescriptor> random_descriptors(std::size_t count) {
  std::mt19937_64 random(count);
  std::vector<OrbDescriptor> descriptors(count);
  for (auto& d : descriptors)
    for (auto& word : d.words) word = random();
  return descriptors;
}

/// Distances a second. Bound: each reads 32 bytes, two such loads a cycle at 4 GHz.
void hamming_sweepkit(benchmark::State& state) {
  const auto a = random_descriptors(static_cast<std::size_t>(state.range(0)));
  const auto b = random_descriptors(static_cast<std::size_t>(state.range(0)));
  std::vector<std::uint16_t> distances(a.size() * b.size());
  for (auto _ : state) {
    hamming_distance_matrix<256>(a, b, distances);
    benchmark::DoNotOptimize(distances.data());
  }
  state.counters["distances"] = benchmark::Counter(static_cast<double>(distances.size()),
                                                   benchmark::Counter::kIsIterationInvariantRate);
  state.counters["bound"] = 8e9;
}
BENCHMARK(hamming_sweepkit)
    ->Name("feature/hamming_matrix/sweepkit")
    ->Arg(1000)
    ->Unit(benchmark::kMicrosecond);

void hamming_portable(benchmark::State& state) {
  const ScopedSimdLevel level(SimdLevel::portable);
  hamming_sweepkit(state);
}
BENCHMARK(hamming_portable)
    ->Name("feature/hamming_matrix/sweepkit_portable")
    ->Arg(1000)
    ->Unit(benchmark::kMicrosecond);

void hamming_opencv(benchmark::State& state) {
  const auto a = random_descriptors(static_cast<std::size_t>(state.range(0)));
  const auto b = random_descriptors(static_cast<std::size_t>(state.range(0)));
  const cv::Mat ma(static_cast<int>(a.size()), 32, CV_8U, const_cast<OrbDescriptor*>(a.data()));
  const cv::Mat mb(static_cast<int>(b.size()), 32, CV_8U, const_cast<OrbDescriptor*>(b.data()));
  cv::Mat distances;
  for (auto _ : state) cv::batchDistance(ma, mb, distances, CV_32S, cv::noArray(), cv::NORM_HAMMING);
}
BENCHMARK(hamming_opencv)->Name("feature/hamming_matrix/opencv")->Arg(1000)->Unit(benchmark::kMicrosecond);

}  // namespace
