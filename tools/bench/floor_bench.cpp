// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Dense stereo and the floor at 640x400, one thread. Disparities are those of a floor with boxes on it, noise
// of 0.3 px, a tenth of the pixels unknown. The rival of mask and cloud is what OpenCV offers: a comparison
// with the floor's disparities (a ready image) for the mask, reprojectImageTo3D, and a copy by mask; for the
// list a walk over the mask. The bound counts bytes that have to move: disparities read, mask and coordinates
// written, 64 bytes a cycle at 4 GHz.
#include <benchmark/benchmark.h>

#include <cmath>
#include <cstdint>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/floor/obstacle_cloud.hpp"
#include "sweepkit/image/dense_disparity.hpp"

namespace {

using namespace sweepkit;

constexpr int kWidth = 640, kHeight = 400;
const RectifiedCamera kCamera{320, 319.2, 199.4, 0.06};

struct Scene {
  GroundPlane plane{Vec3<double>(0.01, 1, 0.05).normalized(), 0.08};
  FloorDisparity floor = plane.disparity(kCamera);
  FloorTolerance tolerance = FloorTolerance::of({}, plane, kCamera);
  Image<float> pixels{kWidth, kHeight};
  Image<std::int16_t> sixteenths{kWidth, kHeight};
  cv::Mat limit = cv::Mat(kHeight, kWidth, CV_32F);  // disparities beyond are obstacles

  Scene() {
    cv::setNumThreads(1);
    Random random(1);
    for (int v = 0; v < kHeight; ++v)
      for (int u = 0; u < kWidth; ++u) {
        const double f = floor(u, v);
        const bool box = (u / 50 + v / 60) % 3 == 0;
        double d = std::max(f, 8.0 + u / 40 % 5) + (box ? 20 : 0) + random.normal(0, 0.3);
        if (random.index(10) == 0) d = 0;
        pixels(u, v) = static_cast<float>(d);
        sixteenths(u, v) = static_cast<std::int16_t>(std::lround(16 * d));
        limit.at<float>(v, u) = static_cast<float>(std::max(f, 0.0) + tolerance.towards(f));
      }
  }

  static const Scene& get() {
    static const Scene scene;
    return scene;
  }
  template <class D>
  View2d<const D> disparity() const {
    if constexpr (std::is_same_v<D, float>)
      return pixels;
    else
      return sixteenths;
  }
  cv::Mat mat() const {
    return cv::Mat(kHeight, kWidth, CV_32F, const_cast<float*>(pixels.row(0)),
                   static_cast<std::size_t>(pixels.stride()) * sizeof(float));
  }
};

double us_bound(double bytes) { return bytes / 64 / 4e9 * 1e6; }

template <class D>
void mask(benchmark::State& state) {
  const Scene& s = Scene::get();
  GrayImage labels(kWidth, kHeight);
  for (auto _ : state) {
    obstacle_mask(s.disparity<D>(), s.floor, s.tolerance, labels.view());
    benchmark::DoNotOptimize(labels.row(0));
  }
  state.counters["us_bound"] = us_bound(kWidth * kHeight * (sizeof(D) + 1.0));
}
BENCHMARK_TEMPLATE(mask, float)->Name("floor/mask/sweepkit/float")->Unit(benchmark::kMicrosecond);
BENCHMARK_TEMPLATE(mask, std::int16_t)->Name("floor/mask/sweepkit/int16")->Unit(benchmark::kMicrosecond);

template <class D>
void organised(benchmark::State& state) {
  const Scene& s = Scene::get();
  OrganisedCloud cloud;
  for (auto _ : state) {
    cloud.build(s.disparity<D>(), kCamera, s.floor, s.tolerance);
    benchmark::DoNotOptimize(cloud.z().data);
  }
  state.counters["us_bound"] = us_bound(kWidth * kHeight * (sizeof(D) + 13.0));
}
BENCHMARK_TEMPLATE(organised, float)
    ->Name("floor/mask_and_cloud/sweepkit/float")
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_TEMPLATE(organised, std::int16_t)
    ->Name("floor/mask_and_cloud/sweepkit/int16")
    ->Unit(benchmark::kMicrosecond);

template <class D>
void list(benchmark::State& state) {
  const Scene& s = Scene::get();
  PointList points;
  for (auto _ : state) {
    points.build(s.disparity<D>(), kCamera, s.floor, s.tolerance);
    benchmark::DoNotOptimize(points.points().data());
  }
  state.counters["points"] = static_cast<double>(points.size());
  state.counters["us_bound"] =
      us_bound(kWidth * kHeight * (sizeof(D) + 1.0) + static_cast<double>(points.size()) * 16.0);
}
BENCHMARK_TEMPLATE(list, float)->Name("floor/mask_and_list/sweepkit/float")->Unit(benchmark::kMicrosecond);
BENCHMARK_TEMPLATE(list, std::int16_t)
    ->Name("floor/mask_and_list/sweepkit/int16")
    ->Unit(benchmark::kMicrosecond);

cv::Mat reprojection() {
  return (cv::Mat_<double>(4, 4) << 1, 0, 0, -kCamera.cx, 0, 1, 0, -kCamera.cy, 0, 0, 0, kCamera.focal, 0, 0,
          1 / kCamera.baseline, 0);
}

void organised_opencv(benchmark::State& state) {
  const Scene& s = Scene::get();
  const cv::Mat disparity = s.mat(), q = reprojection();
  cv::Mat labels, points, cloud;
  for (auto _ : state) {
    cv::compare(disparity, s.limit, labels, cv::CMP_GT);
    cv::reprojectImageTo3D(disparity, points, q);
    cloud.create(points.size(), points.type());
    cloud.setTo(cv::Scalar::all(std::numeric_limits<float>::quiet_NaN()));
    points.copyTo(cloud, labels);
    benchmark::DoNotOptimize(cloud.data);
  }
}
BENCHMARK(organised_opencv)->Name("floor/mask_and_cloud/opencv/float")->Unit(benchmark::kMicrosecond);

void list_opencv(benchmark::State& state) {
  const Scene& s = Scene::get();
  const cv::Mat disparity = s.mat(), q = reprojection();
  cv::Mat labels, points;
  std::vector<cv::Point> pixels;
  std::vector<cv::Vec3f> found;
  for (auto _ : state) {
    cv::compare(disparity, s.limit, labels, cv::CMP_GT);
    cv::reprojectImageTo3D(disparity, points, q);
    cv::findNonZero(labels, pixels);
    found.clear();
    for (const cv::Point& p : pixels) found.push_back(points.at<cv::Vec3f>(p));
    benchmark::DoNotOptimize(found.data());
  }
  state.counters["points"] = static_cast<double>(found.size());
}
BENCHMARK(list_opencv)->Name("floor/mask_and_list/opencv/float")->Unit(benchmark::kMicrosecond);

// Rectification and matching of a pair of distorted cameras that look at a texture along the floor.
struct Pair {
  StereoRig rig;
  GrayImage raw[2];

  Pair()
      : rig(Camera({320, 319, 318, 203}, Distortion::radial_tangential, {-0.28, 0.07, 0.0002, 0.00002},
                   kWidth, kHeight),
            Camera({319, 320, 323, 198}, Distortion::radial_tangential, {-0.285, 0.075, -0.0001, 0.0001},
                   kWidth, kHeight),
            SE3d(), SE3d(SO3d::exp(Vec3<double>(0.006, -0.012, 0.014)), {0.06, 0.001, -0.002})) {
    cv::setNumThreads(1);
    Random random(2);
    cv::Mat texture(1024, 1024, CV_8U);
    for (int y = 0; y < texture.rows; ++y)
      for (int x = 0; x < texture.cols; ++x)
        texture.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(random());
    cv::GaussianBlur(texture, texture, {}, 1.5);
    const RectifiedCamera camera = rectified_camera(rig);
    const FloorDisparity floor = Scene::get().floor;
    for (const Side side : {Side::left, Side::right}) {
      GrayImage& image = raw[static_cast<int>(side)];
      image.resize(kWidth, kHeight);
      for (int v = 0; v < kHeight; ++v)
        for (int u = 0; u < kWidth; ++u) {
          const auto p = rig.rectify(side, Vec2<double>(u, v));
          const double d = p ? std::max(floor(camera.cx, p->y()), 10.0) : 0.0;
          const double x = p ? p->x() + (side == Side::right ? d : 0.0) : 0.0, y = p ? p->y() : 0.0;
          // One sample of the blurred texture: what the time needs is texture, not truth.
          image(u, v) =
              texture.at<std::uint8_t>(static_cast<int>(y + 300) & 1023, static_cast<int>(x + 300) & 1023);
        }
    }
  }

  static const Pair& get() {
    static const Pair pair;
    return pair;
  }
};

void rectify(benchmark::State& state) {
  const Pair& pair = Pair::get();
  StereoRectifier rectifier(pair.rig);
  for (auto _ : state) {
    rectifier.rectify(pair.raw[0], pair.raw[1]);
    benchmark::DoNotOptimize(rectifier.image(Side::left).data);
  }
}
BENCHMARK(rectify)->Name("image/rectify/sweepkit/640x400")->Unit(benchmark::kMicrosecond);

/// As OpenCV's examples do it, with maps in single precision.
void rectify_opencv(benchmark::State& state) {
  const Pair& pair = Pair::get();
  cv::Mat source[2], map[2], image;
  for (const Side side : {Side::left, Side::right}) {
    const int i = static_cast<int>(side);
    source[i] = cv::Mat(kHeight, kWidth, CV_8U, const_cast<std::uint8_t*>(pair.raw[i].row(0)),
                        static_cast<std::size_t>(pair.raw[i].stride()));
    map[i].create(kHeight, kWidth, CV_32FC2);
    for (int v = 0; v < kHeight; ++v)
      for (int u = 0; u < kWidth; ++u) {
        const auto p = pair.rig.unrectify(side, Vec2<double>(u, v));
        map[i].at<cv::Vec2f>(v, u) =
            p ? cv::Vec2f(static_cast<float>(p->x()), static_cast<float>(p->y())) : cv::Vec2f(-9, -9);
      }
  }
  for (auto _ : state)
    for (int i = 0; i < 2; ++i) {
      cv::remap(source[i], image, map[i], cv::noArray(), cv::INTER_LINEAR);
      benchmark::DoNotOptimize(image.data);
    }
}
BENCHMARK(rectify_opencv)->Name("image/rectify/opencv/640x400")->Unit(benchmark::kMicrosecond);

/// Raw pair to disparities; the methods are OpenCV's, the columns at the left and the ramp are ours.
void disparity(benchmark::State& state, DisparityMethod method, bool smooth, int disparities = 128,
               bool near = false) {
  const Pair& pair = Pair::get();
  DisparityOptions options;
  options.method = method;
  options.disparities = disparities;
  options.near = near;
  options.smooth.enabled = smooth;
  options.parallel = false;
  StereoDisparity source(pair.rig, options);
  const DisparityRamp ramp = Scene::get().floor.ramp(kCamera.cx);
  DisparityView found;
  for (auto _ : state) found = source.match(pair.raw[0], pair.raw[1], ramp);
  int known = 0;
  for (int v = 0; v < found.height; ++v)
    for (int u = 0; u < found.width; ++u) known += found(u, v) > 0;
  state.counters["known"] = known / static_cast<double>(kWidth * kHeight);
}
BENCHMARK_CAPTURE(disparity, bm, DisparityMethod::bm, false)
    ->Name("image/disparity/bm/128")
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(disparity, sgbm, DisparityMethod::sgbm, false)
    ->Name("image/disparity/sgbm/128")
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(disparity, sgbm_smooth, DisparityMethod::sgbm, true)
    ->Name("image/disparity/sgbm_smooth/128")
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(disparity, sgbm_3way, DisparityMethod::sgbm_3way, false)
    ->Name("image/disparity/sgbm_3way/128")
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(disparity, sgbm_3way_near, DisparityMethod::sgbm_3way, false, 128, true)
    ->Name("image/disparity/sgbm_3way_near/128")
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(disparity, sgbm_3way_256, DisparityMethod::sgbm_3way, false, 256)
    ->Name("image/disparity/sgbm_3way/256")
    ->Unit(benchmark::kMillisecond);

/// OpenCV's SGBM alone, on the rectified pair.
void disparity_opencv(benchmark::State& state) {
  const Pair& pair = Pair::get();
  StereoRectifier rectifier(pair.rig);
  rectifier.rectify(pair.raw[0], pair.raw[1]);
  cv::Mat image[2], found;
  for (const Side side : {Side::left, Side::right}) {
    const GrayView view = rectifier.image(side);
    image[static_cast<int>(side)] =
        cv::Mat(view.height, view.width, CV_8U, const_cast<std::uint8_t*>(view.data),
                static_cast<std::size_t>(view.stride))
            .clone();
  }
  const auto sgbm = cv::StereoSGBM::create(0, 128, 5, 200, 800, 1, 31, 10, 100, 2);
  for (auto _ : state) sgbm->compute(image[0], image[1], found);
  state.counters["known"] = cv::countNonZero(found > 0) / static_cast<double>(kWidth * kHeight);
}
BENCHMARK(disparity_opencv)->Name("image/disparity/opencv_sgbm/128")->Unit(benchmark::kMillisecond);

}  // namespace
