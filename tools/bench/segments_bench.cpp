// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Line segments, their descriptors and their matching on one 640x400 image: the middle of opencv-doc's
// graf1.png, or a made scene where that is missing; the right image is the same 24 px to the side. One
// thread.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/line_descriptor.hpp>
#include <vector>

#include "sweepkit/feature/line_extractor.hpp"
#include "sweepkit/match/lines.hpp"

namespace {

using namespace sweepkit;

constexpr int kShift = 24;  // px

cv::Mat scene(Side side) {
  static const cv::Mat image = [] {
    cv::setNumThreads(1);
    cv::Mat m = cv::imread("/usr/share/doc/opencv-doc/examples/data/graf1.png", cv::IMREAD_GRAYSCALE);
    if (m.empty()) {
      m.create(640, 800, CV_8U);
      cv::RNG random(1);
      for (int i = 0; i < 1500; ++i)
        cv::rectangle(m,
                      cv::Rect(random.uniform(0, 760), random.uniform(0, 600), random.uniform(4, 40),
                               random.uniform(4, 40)),
                      random.uniform(0, 255), cv::FILLED);
    }
    cv::resize(m, m, {700, 560}, 0, 0, cv::INTER_AREA);
    return m;
  }();
  return image(cv::Rect(side == Side::left ? 10 : 10 + kShift, 80, 640, 400)).clone();
}

GrayView view(const cv::Mat& m) { return {m.data, m.cols, m.rows, static_cast<std::ptrdiff_t>(m.step)}; }

double best_us(const auto& work) {
  double best = 1e12;
  for (int i = 0; i < 30; ++i) {
    const auto start = std::chrono::steady_clock::now();
    work();
    best = std::min(
        best, std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - start).count());
  }
  return best;
}

/// Bound: gradient and ridges of all pixels, which every edge detector has to look at.
void segments_sweepkit(benchmark::State& state) {
  const cv::Mat image = scene(Side::left);
  SegmentDetector detector;
  std::vector<LineSegment> segments;
  for (auto _ : state) detector.detect(view(image), segments);
  EdgeMap map;
  state.counters["segments"] = static_cast<double>(segments.size());
  state.counters["bound_ms"] =
      1e-3 * best_us([&] { map.build<std::uint8_t>(view(image), detector.options().threshold); });
}
BENCHMARK(segments_sweepkit)->Name("feature/segments/sweepkit")->Unit(benchmark::kMillisecond);

void segments_portable(benchmark::State& state) {
  const ScopedSimdLevel level(SimdLevel::portable);
  segments_sweepkit(state);
}
BENCHMARK(segments_portable)->Name("feature/segments/sweepkit_portable")->Unit(benchmark::kMillisecond);

void segments_lsd(benchmark::State& state) {
  const cv::Mat image = scene(Side::left);
  const auto lsd = cv::createLineSegmentDetector(cv::LSD_REFINE_STD);
  std::vector<cv::Vec4f> lines;
  for (auto _ : state) lsd->detect(image, lines);
  state.counters["segments"] = static_cast<double>(lines.size());
}
BENCHMARK(segments_lsd)->Name("feature/segments/opencv_lsd")->Unit(benchmark::kMillisecond);

void segments_edlines(benchmark::State& state) {
  const cv::Mat image = scene(Side::left);
  const auto rival = cv::line_descriptor::BinaryDescriptor::createBinaryDescriptor();
  std::vector<cv::line_descriptor::KeyLine> lines;
  for (auto _ : state) {
    lines.clear();
    rival->detect(image, lines);
  }
  state.counters["segments"] = static_cast<double>(lines.size());
}
BENCHMARK(segments_edlines)->Name("feature/segments/opencv_edlines")->Unit(benchmark::kMillisecond);

/// Gradient included. Bound: two loads a cycle at 4 GHz of the samples of all strips, and the gradient.
void lbd_sweepkit(benchmark::State& state) {
  const cv::Mat image = scene(Side::left);
  std::vector<LineSegment> segments;
  SegmentDetector().detect(view(image), segments);
  const Lbd lbd;
  EdgeMap map;
  std::vector<LineDescriptor> descriptors(segments.size());
  const auto gradient = [&] { map.build<std::uint8_t>(view(image), EdgeMap::kNoRidges); };
  for (auto _ : state) {
    gradient();
    for (std::size_t i = 0; i < segments.size(); ++i)
      descriptors[i] = lbd.describe(map, segments[i].x1, segments[i].y1, segments[i].x2, segments[i].y2);
    benchmark::DoNotOptimize(descriptors.data());
  }
  double samples = 0;
  for (const LineSegment& s : segments)
    samples += Lbd::kRows * std::min<double>(s.length(), Lbd::kMaxColumns);
  state.counters["segments"] = static_cast<double>(segments.size());
  state.counters["bound_ms"] = 1e-3 * best_us(gradient) + samples / 8e9 * 1e3;
}
BENCHMARK(lbd_sweepkit)->Name("feature/lbd/sweepkit")->Unit(benchmark::kMillisecond);

void lbd_portable(benchmark::State& state) {
  const ScopedSimdLevel level(SimdLevel::portable);
  lbd_sweepkit(state);
}
BENCHMARK(lbd_portable)->Name("feature/lbd/sweepkit_portable")->Unit(benchmark::kMillisecond);

void lbd_opencv(benchmark::State& state) {
  const cv::Mat image = scene(Side::left);
  std::vector<LineSegment> segments;
  SegmentDetector().detect(view(image), segments);
  std::vector<cv::line_descriptor::KeyLine> lines;
  for (const LineSegment& s : segments) {
    cv::line_descriptor::KeyLine k;
    k.startPointX = k.sPointInOctaveX = s.x1;
    k.startPointY = k.sPointInOctaveY = s.y1;
    k.endPointX = k.ePointInOctaveX = s.x2;
    k.endPointY = k.ePointInOctaveY = s.y2;
    k.angle = s.angle();
    k.octave = 0;
    k.class_id = static_cast<int>(lines.size());
    k.lineLength = s.length();
    k.numOfPixels = static_cast<int>(std::max(std::abs(s.dx()), std::abs(s.dy()))) + 1;
    k.pt = {0.5f * (s.x1 + s.x2), 0.5f * (s.y1 + s.y2)};
    k.response = k.lineLength / 640;
    k.size = std::abs(s.dx() * s.dy());
    lines.push_back(k);
  }
  const auto rival = cv::line_descriptor::BinaryDescriptor::createBinaryDescriptor();
  cv::Mat codes;
  for (auto _ : state) rival->compute(image, lines, codes);
  state.counters["segments"] = static_cast<double>(lines.size());
}
BENCHMARK(lbd_opencv)->Name("feature/lbd/opencv")->Unit(benchmark::kMillisecond);

void lines_sweepkit(benchmark::State& state) {
  const cv::Mat image = scene(Side::left);
  LineExtractor extractor;
  LineFeatures<256> lines;
  for (auto _ : state) extractor.extract(view(image), lines);
  state.counters["segments"] = static_cast<double>(lines.size());
}
BENCHMARK(lines_sweepkit)->Name("feature/lines/sweepkit")->Unit(benchmark::kMillisecond);

struct LinePair {
  StereoRig rig;
  LineFeatures<256> left, right;

  static const LinePair& get() {
    static const LinePair pair = [] {
      const Camera camera({420, 420, 319.5, 199.5}, Distortion::none, {}, 640, 400);
      LinePair p{StereoRig(camera, camera, SE3d(), SE3d(SO3d(), {0.11, 0, 0})), {}, {}};
      LineExtractor extractor;
      extractor.extract(view(scene(Side::left)), p.left);
      extractor.extract(view(scene(Side::right)), p.right);
      return p;
    }();
    return pair;
  }
};

void match_sweepkit(benchmark::State& state) {
  const LinePair& pair = LinePair::get();
  LineStereoMatcher matcher(pair.rig);
  std::vector<LineStereoMatch> matches;
  int count = 0;
  for (auto _ : state) count = matcher.match(pair.left, pair.right, matches);
  int right = 0;
  for (const LineStereoMatch& m : matches)
    right += m.found() && std::abs(0.5f * (m.disparity1 + m.disparity2) - kShift) < 1.5f;
  state.counters["segments"] = static_cast<double>(pair.left.size());
  state.counters["matches"] = count;
  state.counters["right"] = right;
}
BENCHMARK(match_sweepkit)->Name("match/lines/sweepkit")->Unit(benchmark::kMicrosecond);

/// All with all by descriptor, checked crosswise, with the same rule of directions afterwards.
void match_brute_force(benchmark::State& state) {
  const LinePair& pair = LinePair::get();
  const auto codes = [](const LineFeatures<256>& f) {
    cv::Mat m(static_cast<int>(f.size()), 32, CV_8U);
    std::copy_n(reinterpret_cast<const char*>(f.descriptors.data()), 32 * f.size(),
                reinterpret_cast<char*>(m.data));
    return m;
  };
  const cv::Mat left = codes(pair.left), right_codes = codes(pair.right);
  cv::BFMatcher matcher(cv::NORM_HAMMING, true);
  std::vector<cv::DMatch> matches;
  for (auto _ : state) matcher.match(left, right_codes, matches);
  int right = 0;
  for (const cv::DMatch& m : matches) {
    const LineSegment &a = pair.left.segments[m.queryIdx], &b = pair.right.segments[m.trainIdx];
    // Across the left line, the right one's middle moved back lies on it.
    const float x = 0.5f * (b.x1 + b.x2) + kShift - a.x1, y = 0.5f * (b.y1 + b.y2) - a.y1;
    right += std::abs(x * a.dy() - y * a.dx()) < 1.5f * a.length();
  }
  state.counters["segments"] = static_cast<double>(pair.left.size());
  state.counters["matches"] = static_cast<double>(matches.size());
  state.counters["right"] = right;
}
BENCHMARK(match_brute_force)->Name("match/lines/opencv_bf")->Unit(benchmark::kMicrosecond);

/// Every line of the left image looked for in itself, 20 px about where it is.
void match_predicted(benchmark::State& state) {
  const LinePair& pair = LinePair::get();
  std::vector<LineQuery> queries;
  std::vector<Segment2d> segments;
  std::vector<std::int32_t> octaves;
  for (const LineSegment& s : pair.left.segments) {
    segments.push_back({s.x1, s.y1, s.x2, s.y2});
    octaves.push_back(s.octave);
    queries.push_back({segments.back(), 20, std::max(0, s.octave - 1), s.octave + 1});
  }
  LineProjectionMatcher matcher;
  std::vector<Match> matches;
  int count = 0;
  for (auto _ : state)
    count = matcher.match(queries, pair.left.descriptors, segments, octaves, pair.left.descriptors, matches);
  state.counters["segments"] = static_cast<double>(segments.size());
  state.counters["matches"] = count;
}
BENCHMARK(match_predicted)->Name("match/line_projection/sweepkit")->Unit(benchmark::kMicrosecond);

void triangulate_lines(benchmark::State& state) {
  const LinePair& pair = LinePair::get();
  LineStereoMatcher matcher(pair.rig);
  std::vector<LineStereoMatch> matches;
  const int count = matcher.match(pair.left, pair.right, matches);
  for (auto _ : state)
    for (const LineStereoMatch& m : matches) benchmark::DoNotOptimize(matcher.triangulate(m));
  state.counters["matches"] = count;
}
BENCHMARK(triangulate_lines)->Name("match/line_triangulation/sweepkit")->Unit(benchmark::kMicrosecond);

}  // namespace
