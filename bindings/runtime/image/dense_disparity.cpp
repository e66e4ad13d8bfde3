// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/image/dense_disparity.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <mutex>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "sweepkit/core/error.hpp"

namespace sweepkit {

namespace {

cv::Mat mat_of(GrayView view) {
  return cv::Mat(view.height, view.width, CV_8U, const_cast<std::uint8_t*>(view.data),
                 static_cast<std::size_t>(view.stride));
}

}  // namespace

struct DenseMatcher::Work {
  DisparityOptions options;
  int block = 0;
  cv::Ptr<cv::StereoMatcher> matcher;
  cv::Mat padded[2], found, low, high;
  Image<std::int16_t> result;

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
      matcher =
          cv::StereoSGBM::create(0, o.disparities, block, 8 * area, 32 * area, 0, 31, o.uniqueness, 0, 0,
                                 o.method == DisparityMethod::sgbm_3way ? cv::StereoSGBM::MODE_SGBM_3WAY
                                                                        : cv::StereoSGBM::MODE_SGBM);
    }
    matcher->setDisp12MaxDiff(o.left_right_tolerance);
    matcher->setSpeckleWindowSize(o.speckle_window);
    matcher->setSpeckleRange(o.speckle_range);
  }
};

DenseMatcher::DenseMatcher(const DisparityOptions& options) : work_(std::make_unique<Work>(options)) {}
DenseMatcher::~DenseMatcher() = default;
DenseMatcher::DenseMatcher(DenseMatcher&&) noexcept = default;
DenseMatcher& DenseMatcher::operator=(DenseMatcher&&) noexcept = default;

const DisparityOptions& DenseMatcher::options() const { return work_->options; }

DisparityView DenseMatcher::match(GrayView left, GrayView right) {
  Work& w = *work_;
  const auto refuse = [&](const char* what) {
    throw Error(ErrorKind::argument, "DenseMatcher::match", what,
                fmt::format("{}x{} and {}x{} px", left.width, left.height, right.width, right.height));
  };
  if (left.empty() || right.empty()) refuse("images cannot be empty");
  if (left.width != right.width || left.height != right.height) refuse("images must have the same size");
  if (left.width < w.block || left.height < w.block) refuse("images are smaller than the block");
  const int pad = w.options.left_border ? w.options.disparities : 0;
  cv::copyMakeBorder(mat_of(left), w.padded[0], 0, 0, pad, 0, cv::BORDER_REPLICATE);
  cv::copyMakeBorder(mat_of(right), w.padded[1], 0, 0, pad, 0, cv::BORDER_REPLICATE);
  w.matcher->compute(w.padded[0], w.padded[1], w.found);
  w.result.resize(left.width, left.height);
  for (int v = 0; v < left.height; ++v) {
    const std::int16_t* from = w.found.ptr<std::int16_t>(v) + pad;
    std::int16_t* to = w.result.row(v);
    // A partner left of the right image's first column was never seen.
    for (int u = 0; u < left.width; ++u) to[u] = from[u] > 0 && from[u] <= 16 * u ? from[u] : std::int16_t{0};
  }
  return w.result.view();
}

StereoDisparity::StereoDisparity(const StereoRig& rig, const DisparityOptions& options)
    : rectifier_(rig), matcher_(options) {}

DisparityView StereoDisparity::match(GrayView left, GrayView right) {
  rectifier_.rectify(left, right);
  disparity_.assign(matcher_.match(rectifier_.image(Side::left), rectifier_.image(Side::right)));
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
