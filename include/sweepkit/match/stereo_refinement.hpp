// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <concepts>
#include <span>

#include "sweepkit/core/options.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/image/pyramid.hpp"
#include "sweepkit/match/stereo_search.hpp"

namespace sweepkit {

/// A policy that makes the disparities of matches more exact with the raw images. It offers
/// - `Options`, a struct of options it is constructed from, together with the rig,
/// - `refine(left, left_pyramid, right, right_pyramid, matches)`, which may change u_right, disparity and
/// sigma
///   of matches, never the left position, and may clear matches (`clear_match`).
template <class R>
concept StereoRefinement = HasOptions<typename R::Options> &&
    std::constructible_from<R, const StereoRig&, const typename R::Options&> &&
    requires(R refinement, const Features<256>& features, const ImagePyramid& pyramid,
             std::span<StereoMatch> matches) {
  refinement.refine(features, pyramid, features, pyramid, matches);
};

/// Leaves disparities as the key points give them.
struct NoRefinement {
  struct Options {
    template <class Visitor>
    void visit_options(Visitor&) {}
  };

  NoRefinement(const StereoRig&, const Options&) {}
  void refine(const Features<256>&, const ImagePyramid&, const Features<256>&, const ImagePyramid&,
              std::span<StereoMatch>) const {}
};

/// Compares the patch about the left key point with the right image along the epipolar line, in the raw
/// images.
///
/// Both patches are sampled on the grid of the rectified pair through the local affine map of each camera
/// (inverse of the Jacobian of rectification), so that a column of the grid is a pixel of disparity; of a
/// pair that is rectified already they are plain copies. Zero-mean normalised correlation, climbed in whole
/// pixels, finds where to start; inverse-compositional Gauss-Newton on disparity, gain and offset (Baker and
/// Matthews 2004) finishes; a fourth unknown lets the disparity change from row to row, as it does on floors.
/// The gradient is taken from the left patch alone and the right one is read by four-point Lagrange
/// interpolation, whose phase is right to fourth order: so neither noise nor interpolation draws the result
/// to whole or half pixels, as the parabola through sums of absolute differences does. First roughly on
/// the pyramid level of the key point, then on level 0, whose small patch lies on one surface more often;
/// pairs that fail there or disagree between the two are removed, and the more certain result stays.
class PatchRefinement {
 public:
  struct Options {
    bool enabled = true;
    int radius = 5;
    int iterations = 6;
    double max_shift = 3.0;
    double min_correlation = 0.8;
    double max_sigma = 0.5;
    double max_difference = 0.5;
    double image_noise = 2.0;
    double sigma_floor = 0.05;
    double shear_sigma = 0.3;
    bool finish_on_full_image = true;

    template <class Visitor>
    void visit_options(Visitor& v) {
      v(enabled, "enabled", "", any_value(), "refine disparities at all");
      v(radius, "radius", "px", range(2, 7),
        "rows of the patch above and below the key point; it is 8 columns wide");
      v(iterations, "iterations", "", range(1, 30), "Gauss-Newton steps at most");
      v(max_shift, "max_shift", "px", range(0.5, 3.0),
        "pairs that move farther from where key points put them, on the level of their octave, are removed");
      v(min_correlation, "min_correlation", "", range(-1.0, 1.0),
        "pairs whose patches correlate less are removed");
      v(max_sigma, "max_sigma", "px", range(0.001, 100.0),
        "pairs whose disparity is less certain, on the level of their octave, are removed: too little "
        "texture "
        "along the epipolar line");
      v(max_difference, "max_difference", "px", range(0.01, 100.0),
        "pairs whose disparities on the two levels differ by more, on the level of their octave, are "
        "removed");
      v(image_noise, "image_noise", "", range(0.0, 50.0),
        "least standard deviation of a pixel's grey value to expect");
      v(sigma_floor, "sigma_floor", "px", range(0.0, 10.0),
        "added in quadrature to the standard deviation that noise alone explains: calibration, slanted "
        "surfaces");
      v(shear_sigma, "shear_sigma", "", range(0.001, 10.0),
        "change of disparity from row to row to expect, as on a floor: baseline / camera height [px a row]");
      v(finish_on_full_image, "finish_on_full_image", "", any_value(),
        "refine on level 0, from a rough result on the level of the octave; pairs that fail there are "
        "removed");
    }
  };

  PatchRefinement(const StereoRig& rig, const Options& options) : rig_(rig), options_(options) {
    check_options(options_);
  }

  void refine(const Features<256>& left, const ImagePyramid& left_pyramid, const Features<256>& right,
              const ImagePyramid& right_pyramid, std::span<StereoMatch> matches) const;

 private:
  StereoRig rig_;
  Options options_;
};

static_assert(StereoRefinement<PatchRefinement> && StereoRefinement<NoRefinement>);

}  // namespace sweepkit
