// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>

#include "sweepkit/core/options.hpp"
#include "sweepkit/image/disparity.hpp"
#include "sweepkit/image/image.hpp"
#include "sweepkit/image/rectify.hpp"

namespace sweepkit {

enum class DisparityMethod {
  bm,         ///< block matching: quickest, holes where there is little texture
  sgbm,       ///< semi-global matching over five directions
  sgbm_3way,  ///< the same over three
  sgbm_8way,  ///< over eight, with twice the time
};

/// The weighted least squares filter after matching; see DisparityOptions::smooth.
struct DisparitySmoothing {
  bool enabled = false;
  double smoothness = 200.0;
  double sigma = 6.0;
  bool fill = false;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(enabled, "enabled", "", any_value(), "smooth disparities along the edges of the left image");
    v(smoothness, "smoothness", "", range(0.0, 1e6), "how smooth; 0 leaves the disparities as they are");
    v(sigma, "sigma", "grey levels", range(0.1, 255.0), "difference of neighbours that counts as an edge");
    v(fill, "fill", "", any_value(), "also invent disparities where matching found none");
  }
};

/// How DenseMatcher works.
struct DisparityOptions {
  DisparityMethod method = DisparityMethod::sgbm;
  int disparities = 128;
  int block_size = 0;
  int uniqueness = 10;
  int left_right_tolerance = 1;
  int speckle_window = 100;
  int speckle_range = 2;
  int min_contrast = 4;
  bool left_border = true;
  bool near = false;
  bool parallel = true;
  DisparitySmoothing smooth;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v.choice(method, "method",
             {{DisparityMethod::bm, "bm"},
              {DisparityMethod::sgbm, "sgbm"},
              {DisparityMethod::sgbm_3way, "sgbm_3way"},
              {DisparityMethod::sgbm_8way, "sgbm_8way"}},
             "block matching, or semi-global matching over five, three or eight directions");
    v(disparities, "disparities", "px", range(16, 1024),
      "disparities looked at, from 0 on, a multiple of 16; near floor needs 128 or more");
    v(block_size, "block_size", "px", range(0, 51), "side of the block compared, odd; 0: 15 for bm, else 5");
    v(uniqueness, "uniqueness", "%", range(0, 100),
      "margin by which the best must beat the rest to be believed");
    v(left_right_tolerance, "left_right_tolerance", "px", range(-1, 100),
      "largest difference when matched back from the right image; -1 switches the check off");
    v(speckle_window, "speckle_window", "px", range(0, 100000),
      "patches of up to so many pixels that stand alone are dropped; 0 keeps all");
    v(speckle_range, "speckle_range", "px", range(0, 100), "step of disparity that ends a patch");
    v(min_contrast, "min_contrast", "grey levels", range(0, 255),
      "pixels in whose neighbourhood along the row the image varies by less are unknown");
    v(left_border, "left_border", "", any_value(),
      "also match the columns at the left that have not all disparities in the right image");
    v(near, "near", "", any_value(),
      "match again at half the resolution: twice the disparities, for what stands nearer");
    v(parallel, "parallel", "", any_value(), "let OpenCV use its threads; the result is the same");
    v.group(smooth, "smooth", "weighted least squares filter");
  }
};

/// Dense disparities of a rectified pair by OpenCV's StereoBM or StereoSGBM. Keeps its buffers. Not
/// thread-safe, but any number may work at once.
///
/// Gives int16 in sixteenths of a pixel, 0 where unknown: left of the right image's edge, at occlusions, and
/// where there is nothing to match. With DisparityOptions::near disparities go on to twice as many; the
/// larger ones come from images of half the size, in blocks of 2 x 2 pixels and steps of 1/8 px. An image
/// that is constant, black or overexposed gives no disparity there. Same images, same result, whatever the
/// threads.
class DenseMatcher {
 public:
  /// Throws Error(option) for a number of disparities that is no multiple of 16 or an even block size.
  explicit DenseMatcher(const DisparityOptions& options = {});
  ~DenseMatcher();
  DenseMatcher(DenseMatcher&&) noexcept;
  DenseMatcher& operator=(DenseMatcher&&) noexcept;

  const DisparityOptions& options() const;

  /// The disparities of the left image, valid until the next call. Throws Error(argument), naming both sizes,
  /// for images that are empty, differ in size or are smaller than the block.
  /// @param ramp disparities are looked for from 16 px below it on: matching takes surfaces as facing the
  ///   camera, and with the floor's ramp the floor does. Without it the disparities of the floor, which
  ///   change by more than half a pixel a row, are drawn to those of the rows before.
  DisparityView match(GrayView left, GrayView right, const DisparityRamp& ramp = {});

 private:
  struct Work;
  std::unique_ptr<Work> work_;
};

/// Disparities of the rectified left image from a raw pair: rectification and DenseMatcher. What lies outside
/// the raw images is unknown. A DisparitySource.
class StereoDisparity {
 public:
  explicit StereoDisparity(const StereoRig& rig, const DisparityOptions& options = {});

  const RectifiedCamera& camera() const { return rectifier_.camera(); }
  const StereoRectifier& rectifier() const { return rectifier_; }
  const DisparityOptions& options() const { return matcher_.options(); }

  /// Valid until the next call. Throws Error(argument) unless the images have the sizes of their cameras.
  DisparityView match(GrayView left, GrayView right, const DisparityRamp& ramp = {});

 private:
  StereoRectifier rectifier_;
  DenseMatcher matcher_;
  Image<std::int16_t> disparity_;
};

static_assert(DisparitySource<StereoDisparity>);

}  // namespace sweepkit
