// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Matching. The stereo benchmarks look at Aloe of opencv-doc (half size, 400 rows) through two distorted
// cameras that are turned against each other: 640x400 px raw images, 1000 ORB key points a side. sweepkit and
// the classic way get the same images and the same left key points; extraction is in neither time.
#include <benchmark/benchmark.h>

#include <numbers>
#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/feature/orb.hpp"
#include "sweepkit/match/align.hpp"
#include "sweepkit/match/brute_force.hpp"
#include "sweepkit/match/projection.hpp"
#include "sweepkit/match/stereo.hpp"

using namespace sweepkit;

namespace {

GrayView view(const cv::Mat& m) { return {m.data, m.cols, m.rows, static_cast<std::ptrdiff_t>(m.step)}; }

StereoRig make_rig() {
  const Camera left({500, 499, 318, 203}, Distortion::radial_tangential, {-0.28, 0.07, 0.0002, 0.00002}, 640,
                    400);
  const Camera right({498, 500, 323, 198}, Distortion::radial_tangential, {-0.285, 0.075, -0.0001, 0.0001},
                     640, 400);
  const SE3d T_body_right(SO3d::exp(Vec3<double>(0.006, -0.012, 0.014)), {0.11, 0.001, -0.002});
  return StereoRig(left, right, SE3d(), T_body_right);
}

/// What a camera of the rig sees of a scene given as an image of the rectified pair.
cv::Mat raw_image(const StereoRig& rig, Side side, const cv::Mat& rectified) {
  cv::Mat map(400, 640, CV_32FC2), image;
  for (int y = 0; y < 400; ++y)
    for (int x = 0; x < 640; ++x) {
      const auto r = rig.rectify(side, Vec2<double>(x, y));
      map.at<cv::Vec2f>(y, x) = r ? cv::Vec2f(r->x(), r->y()) : cv::Vec2f(-1, -1);
    }
  cv::remap(rectified, image, map, cv::noArray(), cv::INTER_CUBIC, cv::BORDER_REFLECT_101);
  return image;
}

struct Scene {
  StereoRig rig = make_rig();
  cv::Mat raw[2];
  ImagePyramid pyramid[2];
  Features<256> features[2];
  std::vector<float> prior;

  static const std::optional<Scene>& get() {
    static const std::optional<Scene> scene = make();
    return scene;
  }

 private:
  static std::optional<Scene> make() {
    Scene s;
    const std::string folder = "/usr/share/doc/opencv-doc/examples/data/";
    OrbExtractor orb;
    for (const int side : {0, 1}) {
      const cv::Mat full = cv::imread(folder + (side == 0 ? "aloeL.jpg" : "aloeR.jpg"), cv::IMREAD_GRAYSCALE);
      if (full.empty()) return std::nullopt;
      cv::Mat half;
      cv::resize(full, half, {}, 0.5, 0.5, cv::INTER_AREA);
      s.raw[side] = raw_image(s.rig, side == 0 ? Side::left : Side::right, half.rowRange(77, 477));
      s.pyramid[side].build(view(s.raw[side]), 8, 1.2);
      orb.extract(s.pyramid[side], s.features[side]);
    }
    // Priors as a map would give them: the disparities themselves, a little off.
    StereoMatcher matcher(s.rig);
    std::vector<StereoMatch> matches;
    matcher.match(s.features[0], s.pyramid[0], s.features[1], s.pyramid[1], {}, matches);
    Random random(1);
    for (const StereoMatch& m : matches)
      s.prior.push_back(m.found() ? m.disparity + static_cast<float>(random.normal(0, 2))
                                  : static_cast<float>(random.uniform(5, 60)));
    return s;
  }
};

template <class Matcher, bool with_priors>
void run_stereo(benchmark::State& state) {
  if (!Scene::get()) return state.SkipWithError("opencv-doc is not installed");
  const Scene& s = *Scene::get();
  Matcher matcher(s.rig);
  std::vector<StereoMatch> matches;
  int found = 0;
  const std::span<const float> prior =
      with_priors ? std::span<const float>(s.prior) : std::span<const float>();
  for (auto _ : state) {
    found = matcher.match(s.features[0], s.pyramid[0], s.features[1], s.pyramid[1], prior, matches);
    benchmark::DoNotOptimize(matches.data());
  }
  state.counters["matches"] = found;
  state.counters["left"] = static_cast<double>(s.features[0].size());
  state.counters["right"] = static_cast<double>(s.features[1].size());
}

// Search alone: key points undistorted, gridded, paired, checked, filtered.
using SearchOnly = BasicStereoMatcher<NoRefinement, MedianFilter>;
BENCHMARK_TEMPLATE(run_stereo, SearchOnly, false)->Name("match/stereo/sweepkit/1000");
BENCHMARK_TEMPLATE(run_stereo, SearchOnly, true)->Name("match/stereo_prior/sweepkit/1000");
// The same and disparities to a part of a pixel.
BENCHMARK_TEMPLATE(run_stereo, StereoMatcher, false)->Name("match/stereo_refined/sweepkit/1000");
BENCHMARK_TEMPLATE(run_stereo, StereoMatcher, true)->Name("match/stereo_refined_prior/sweepkit/1000");

/// Rectifies both images with ready maps, then moves an 11x11 patch about each left key point along its row
/// over 128 disparities; the least sum of absolute differences wins, a parabola gives the part of a pixel.
void classic_stereo(benchmark::State& state) {
  if (!Scene::get()) return state.SkipWithError("opencv-doc is not installed");
  const Scene& s = *Scene::get();
  constexpr int kRadius = 5, kRange = 128;
  cv::Mat map[2], fixed[2], fraction[2], rectified[2];
  for (const int side : {0, 1}) {
    map[side].create(400, 640, CV_32FC2);
    for (int y = 0; y < 400; ++y)
      for (int x = 0; x < 640; ++x) {
        const auto p = s.rig.unrectify(side == 0 ? Side::left : Side::right, Vec2<double>(x, y));
        map[side].at<cv::Vec2f>(y, x) = p ? cv::Vec2f(p->x(), p->y()) : cv::Vec2f(-1, -1);
      }
    cv::convertMaps(map[side], cv::noArray(), fixed[side], fraction[side], CV_16SC2);
  }
  std::vector<Vec2<float>> points(s.features[0].size());
  std::vector<std::uint8_t> valid(points.size());
  s.rig.rectify(Side::left, s.features[0].keypoints, points, valid);
  cv::setNumThreads(1);
  int found = 0;
  for (auto _ : state) {
    for (const int side : {0, 1})
      cv::remap(s.raw[side], rectified[side], fixed[side], fraction[side], cv::INTER_LINEAR);
    found = 0;
    for (const Vec2<float>& p : points) {
      const int x = static_cast<int>(std::lround(p.x())), y = static_cast<int>(std::lround(p.y()));
      if (x < kRadius || x + kRadius >= 640 || y < kRadius || y + kRadius >= 400) continue;
      const int last = std::min(kRange, x - kRadius);
      int sums[kRange + 1];
      for (int d = 0; d <= last; ++d) {
        int sum = 0;
        for (int j = -kRadius; j <= kRadius; ++j) {
          const std::uint8_t* l = rectified[0].ptr(y + j) + x - kRadius;
          const std::uint8_t* r = rectified[1].ptr(y + j) + x - kRadius - d;
          for (int i = 0; i <= 2 * kRadius; ++i) sum += std::abs(l[i] - r[i]);
        }
        sums[d] = sum;
      }
      const int best = static_cast<int>(std::min_element(sums, sums + last + 1) - sums);
      if (best == 0 || best >= last) continue;
      const double curvature = sums[best - 1] + sums[best + 1] - 2 * sums[best];
      benchmark::DoNotOptimize(best +
                               (curvature > 0 ? 0.5 * (sums[best - 1] - sums[best + 1]) / curvature : 0));
      ++found;
    }
  }
  state.counters["matches"] = found;
}
BENCHMARK(classic_stereo)->Name("match/stereo/classic/1000");

void brute_force(benchmark::State& state) {
  if (!Scene::get()) return state.SkipWithError("opencv-doc is not installed");
  const Scene& s = *Scene::get();
  BruteForceMatcher matcher;
  std::vector<Match> matches;
  int found = 0;
  for (auto _ : state) found = matcher.match(s.features[0], s.features[1], matches);
  state.counters["matches"] = found;
}
BENCHMARK(brute_force)->Name("match/brute_force/sweepkit/1000");

void opencv_brute_force(benchmark::State& state) {
  if (!Scene::get()) return state.SkipWithError("opencv-doc is not installed");
  const Scene& s = *Scene::get();
  cv::setNumThreads(1);
  cv::Mat d[2];
  for (const int side : {0, 1})
    d[side] = cv::Mat(static_cast<int>(s.features[side].size()), 32, CV_8U,
                      const_cast<OrbDescriptor*>(s.features[side].descriptors.data()));
  const cv::BFMatcher matcher(cv::NORM_HAMMING, true);
  std::vector<cv::DMatch> matches;
  for (auto _ : state) matcher.match(d[0], d[1], matches);
  state.counters["matches"] = static_cast<double>(matches.size());
}
BENCHMARK(opencv_brute_force)->Name("match/brute_force/opencv/1000");

void projection(benchmark::State& state) {
  if (!Scene::get()) return state.SkipWithError("opencv-doc is not installed");
  const Scene& s = *Scene::get();
  struct Keypoint {
    float u, v, u_right = -1, angle = 0;
    std::int32_t octave;
  };
  Random random(2);
  std::vector<Keypoint> keypoints;
  std::vector<ProjectionQuery> queries;
  for (const KeyPoint& k : s.features[0].keypoints) {
    keypoints.push_back({.u = k.x, .v = k.y, .octave = k.octave});
    queries.push_back({.u = k.x + static_cast<float>(random.normal(0, 3)),
                       .v = k.y + static_cast<float>(random.normal(0, 3)),
                       .radius = 15,
                       .min_octave = k.octave - 1,
                       .max_octave = k.octave + 1});
  }
  KeypointGrid grid;
  ProjectionMatcher matcher;
  std::vector<Match> matches(queries.size());
  int found = 0;
  for (auto _ : state) {
    grid.build(keypoints);
    found = matcher.match(std::span<const ProjectionQuery>(queries), s.features[0].descriptors, grid,
                          std::span<const Keypoint>(keypoints), s.features[0].descriptors, matches);
  }
  state.counters["matches"] = found;
}
BENCHMARK(projection)->Name("match/projection/sweepkit/1000");

void align(benchmark::State& state) {
  if (!Scene::get()) return state.SkipWithError("opencv-doc is not installed");
  const Scene& s = *Scene::get();
  const PatchAligner aligner;
  const GrayView image = s.pyramid[0].level(0);
  Eigen::Matrix2f A;
  A << 1.02f, 0.01f, -0.02f, 0.99f;
  int found = 0;
  for (auto _ : state) {
    found = 0;
    for (const KeyPoint& k : s.features[0].keypoints)
      found += aligner.align(image, {k.x, k.y}, A, image, {k.x + 0.6f, k.y - 0.4f}).has_value();
  }
  state.counters["found"] = found;
}
// An image against itself, 1000 points, each from 0.7 px away.
BENCHMARK(align)->Name("match/align/sweepkit/1000");

}  // namespace
