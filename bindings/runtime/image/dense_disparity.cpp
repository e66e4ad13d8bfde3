// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/image/dense_disparity.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "disparity_smoothing.hpp"
#include "sweepkit/core/error.hpp"

namespace sweepkit {

namespace {

constexpr int kPrefilterCap = 31;  // grey levels by which a gradient counts, of semi-global matching
constexpr int kBehindRamp = 16;    // px; a multiple of 16
constexpr double kMaxRamp = 1000;  // px
constexpr int kOverlap = 8;  // px of disparity; the last ones are searched with half the neighbours only

cv::Mat mat_of(GrayView view) {
  return cv::Mat(view.height, view.width, CV_8U, const_cast<std::uint8_t*>(view.data),
                 static_cast<std::size_t>(view.stride));
}

/// Means of 2 x 2 pixels.
void halve(GrayView image, GrayImage& half) {
  half.resize(image.width / 2, image.height / 2);
  for (int v = 0; v < half.height(); ++v) {
    const std::uint8_t *a = image.row(2 * v), *b = image.row(2 * v + 1);
    std::uint8_t* to = half.row(v);
    for (int u = 0; u < half.width(); ++u)
      to[u] = static_cast<std::uint8_t>((a[2 * u] + a[2 * u + 1] + b[2 * u] + b[2 * u + 1] + 2) >> 2);
  }
}

}  // namespace

struct DenseMatcher::Work {
  DisparityOptions options;
  int block = 0;
  cv::Ptr<cv::StereoMatcher> matcher;
  cv::Mat padded[2], found, low, high;
  Image<std::int16_t> result;
  DisparitySmoother smoother;
  GrayImage half[2];
  std::unique_ptr<Work> near;  // at half the resolution

  explicit Work(const DisparityOptions& o)
      : options(o),
        block(o.block_size > 0                  ? o.block_size
              : o.method == DisparityMethod::bm ? 15
                                                : 5) {
    if (o.disparities <= 0 || o.disparities % 16 != 0)
      throw Error(ErrorKind::option, "disparities", "must be a positive multiple of 16",
                  std::to_string(o.disparities));
    const int least = o.method == DisparityMethod::bm ? 5 : 1;
    if (block % 2 == 0 || block < least)
      throw Error(ErrorKind::option, "block_size", fmt::format("must be odd and at least {}", least),
                  std::to_string(o.block_size));
    if (o.method == DisparityMethod::bm) {
      const auto bm = cv::StereoBM::create(o.disparities, block);
      bm->setUniquenessRatio(o.uniqueness);
      matcher = bm;
    } else {
      const int area = block * block;
      const int mode = o.method == DisparityMethod::sgbm_3way   ? cv::StereoSGBM::MODE_SGBM_3WAY
                       : o.method == DisparityMethod::sgbm_8way ? cv::StereoSGBM::MODE_HH
                                                                : cv::StereoSGBM::MODE_SGBM;
      matcher = cv::StereoSGBM::create(0, o.disparities, block, 8 * area, 32 * area, 0, kPrefilterCap,
                                       o.uniqueness, 0, 0, mode);
    }
    matcher->setDisp12MaxDiff(o.left_right_tolerance);
    matcher->setSpeckleWindowSize(o.speckle_window);
    matcher->setSpeckleRange(o.speckle_range);
    if (o.near) {
      DisparityOptions at_half = o;
      at_half.near = at_half.smooth.enabled = false;
      near = std::make_unique<Work>(at_half);
    }
  }

  /// Both images with room at the sides; the right one moved along by the ramp, row by row.
  void pad(GrayView left, GrayView right, const DisparityRamp& ramp, int before, int after) {
    cv::copyMakeBorder(mat_of(left), padded[0], 0, 0, before, after, cv::BORDER_REPLICATE);
    padded[1].create(padded[0].size(), CV_8U);
    for (int v = 0; v < right.height; ++v) {
      const int shift = ramp.sixteenths(v);
      const std::uint8_t* from = right.row(v);
      std::uint8_t* to = padded[1].ptr(v);
      const int weight = -shift & 15;  // of the right neighbour
      const int first = -before - ((shift + 15) >> 4);
      for (int x = 0; x < padded[1].cols; ++x) {
        const int a = std::clamp(first + x, 0, right.width - 1);
        const int b = std::clamp(first + x + 1, 0, right.width - 1);
        to[x] = static_cast<std::uint8_t>((from[a] * (16 - weight) + from[b] * weight + 8) >> 4);
      }
    }
  }

  /// Disparities at the end of what was looked at and beyond it.
  void add_near(GrayView left, GrayView right, const DisparityRamp& ramp) {
    if (std::min(left.width, left.height) / 2 < block) return;
    halve(left, half[0]);
    halve(right, half[1]);
    near->match(std::as_const(half[0]).view(), std::as_const(half[1]).view(),
                {0.5 * ramp.at_top, ramp.per_row});
    for (int v = 0; v < 2 * half[0].height(); ++v) {
      const int least = ramp.sixteenths(v) + 16 * (options.disparities - kOverlap);
      const std::int16_t* from = near->result.row(v / 2);
      std::int16_t* to = result.row(v);
      for (int u = 0; u < 2 * half[0].width(); ++u)
        if (const int d = 2 * from[u / 2]; d >= least)
          to[u] = static_cast<std::int16_t>(std::min<int>(d, std::numeric_limits<std::int16_t>::max()));
    }
  }

  void match(GrayView left, GrayView right, const DisparityRamp& ramp) {
    // Behind the ramp, too, disparities are looked for.
    const bool sloped = ramp.sixteenths(0) != 0 || ramp.sixteenths(left.height - 1) != 0;
    const int lowest = sloped ? -kBehindRamp : 0;
    matcher->setMinDisparity(lowest);
    matcher->setNumDisparities(options.disparities - lowest);
    const int before = options.left_border ? options.disparities : 0;
    pad(left, right, ramp, before, -lowest);
    matcher->compute(padded[0], padded[1], found);
    const cv::Mat window = cv::Mat::ones(1, 2 * block + 1, CV_8U);
    cv::erode(mat_of(left), low, window);
    cv::dilate(mat_of(left), high, window);
    result.resize(left.width, left.height);
    for (int v = 0; v < left.height; ++v) {
      const std::int16_t* from = found.ptr<std::int16_t>(v) + before;
      const std::uint8_t *darkest = low.ptr(v), *brightest = high.ptr(v);
      std::int16_t* to = result.row(v);
      const int shift = ramp.sixteenths(v);
      for (int u = 0; u < left.width; ++u) {
        const int d = from[u] + shift;
        // A partner left of the right image's first column was never seen.
        const bool known = from[u] >= 16 * lowest && d > 0 && d <= 16 * u &&
                           brightest[u] - darkest[u] >= options.min_contrast;
        to[u] = known ? static_cast<std::int16_t>(d) : std::int16_t{0};
      }
    }
    if (near) add_near(left, right, ramp);
    if (options.smooth.enabled) smoother.smooth(left, options.smooth, ramp, result.view());
  }
};

DenseMatcher::DenseMatcher(const DisparityOptions& options) : work_(std::make_unique<Work>(options)) {}
DenseMatcher::~DenseMatcher() = default;
DenseMatcher::DenseMatcher(DenseMatcher&&) noexcept = default;
DenseMatcher& DenseMatcher::operator=(DenseMatcher&&) noexcept = default;

const DisparityOptions& DenseMatcher::options() const { return work_->options; }

DisparityView DenseMatcher::match(GrayView left, GrayView right, const DisparityRamp& ramp) {
  Work& w = *work_;
  const auto refuse = [&](const char* what) {
    throw Error(ErrorKind::argument, "DenseMatcher::match", what,
                fmt::format("{}x{} and {}x{} px", left.width, left.height, right.width, right.height));
  };
  if (left.empty() || right.empty()) refuse("images cannot be empty");
  if (left.width != right.width || left.height != right.height) refuse("images must have the same size");
  if (left.width < w.block || left.height < w.block) refuse("images are smaller than the block");
  const double last = ramp.at_top + ramp.per_row * left.height;
  if (!(std::abs(last) < kMaxRamp && std::abs(ramp.at_top) < kMaxRamp))
    throw Error(ErrorKind::argument, "DenseMatcher::match ramp", "must be finite and below 1000 px",
                fmt::format("{} + {} v", ramp.at_top, ramp.per_row));
  if (w.options.parallel)
    w.match(left, right, ramp);
  else
    // Within a parallel loop of its own OpenCV starts no other; that touches no setting of the process.
    cv::parallel_for_(cv::Range(0, 1), [&](const cv::Range&) { w.match(left, right, ramp); });
  return w.result.view();
}

StereoDisparity::StereoDisparity(const StereoRig& rig, const DisparityOptions& options)
    : rectifier_(rig), matcher_(options) {}

DisparityView StereoDisparity::match(GrayView left, GrayView right, const DisparityRamp& ramp) {
  rectifier_.rectify(left, right);
  disparity_.assign(matcher_.match(rectifier_.image(Side::left), rectifier_.image(Side::right), ramp));
  const GrayView seen_left = rectifier_.seen(Side::left), seen_right = rectifier_.seen(Side::right);
  for (int v = 0; v < disparity_.height(); ++v) {
    std::int16_t* d = disparity_.row(v);
    for (int u = 0; u < disparity_.width(); ++u) {
      const int u_right = std::clamp(u - ((d[u] + 8) >> 4), 0, disparity_.width() - 1);
      if (!seen_left(u, v) || !seen_right(u_right, v)) d[u] = 0;
    }
  }
  return disparity_.view();
}

}  // namespace sweepkit
