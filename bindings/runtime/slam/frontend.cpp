// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/frontend.hpp"

#include <cmath>

namespace sweepkit {
namespace {

StereoOptions at_scale_of(const OrbOptions& orb, StereoOptions stereo) {
  stereo.search.scale_factor = orb.scale_factor;
  return stereo;
}

}  // namespace

Frontend::Frontend(const StereoRig& rig, const FrontendOptions& options)
    : options_(options), extractor_(options.orb), matcher_(rig, at_scale_of(options.orb, options.stereo)) {}

void Frontend::extract(GrayView left, GrayView right) {
  extract(left, left_pyramid_, left_features_);
  extract(right, right_pyramid_, right_features_);
}

void Frontend::match(StereoFrame& frame) {
  matcher_.match(left_features_, left_pyramid_, right_features_, right_pyramid_, {}, matches_);
  collect(frame);
}

void Frontend::extract(GrayView image, ImagePyramid& pyramid, Features<256>& features) {
  pyramid.build(image, options_.orb.levels, options_.orb.scale_factor);
  extractor_.extract(pyramid, features);
}

// The refinement knows the noise of pixels only, not that patches are seldom flat and never quite alike.
// Measured against true depth of simulated recordings, errors are somewhat larger, and grow with the octave.
float Frontend::disparity_sigma(const StereoMatch& match, int octave) const {
  return static_cast<float>(std::hypot(options_.disparity_sigma_factor * match.sigma,
                                       options_.disparity_sigma_floor * left_pyramid_.scale(octave)));
}

void Frontend::collect(StereoFrame& frame) const {
  frame.measurements.clear();
  frame.descriptors.clear();
  for (std::size_t i = 0; i < matches_.size(); ++i) {
    const StereoMatch& match = matches_[i];
    if (!match.rectified) continue;
    const KeyPoint& keypoint = left_features_.keypoints[i];
    frame.measurements.push_back(
        {.u = match.u_left,
         .v = match.v_left,
         .u_right = match.found() ? match.u_right : -1,
         .sigma = static_cast<float>(options_.keypoint_sigma) * left_pyramid_.scale(keypoint.octave),
         .sigma_right = match.found() ? disparity_sigma(match, keypoint.octave) : 1,
         .angle = keypoint.angle,
         .octave = keypoint.octave});
    frame.measurements.back().shift_disparity(disparity_bias_);
    frame.descriptors.push_back(left_features_.descriptors[i]);
  }
  frame.disparity_bias = disparity_bias_;
  frame.grid.build(frame.measurements);
}

}  // namespace sweepkit
