// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/view.hpp"
#include "sweepkit/feature/orb.hpp"
#include "sweepkit/image/pyramid.hpp"
#include "sweepkit/match/stereo.hpp"
#include "sweepkit/slam/stereo_frame.hpp"

namespace sweepkit {

/// What the way from images to measurements may be told.
struct FrontendOptions {
  OrbOptions orb;
  StereoOptions stereo;
  double keypoint_sigma = 0.3;
  double disparity_sigma_factor = 1.2;
  double disparity_sigma_floor = 0.06;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v.group(orb, "orb", "key points");
    v.group(stereo, "stereo", "stereo matching");
    v(keypoint_sigma, "keypoint_sigma", "px", range(0.01, 10),
      "standard deviation of a key point's position, on the level of its octave");
    v(disparity_sigma_factor, "disparity_sigma_factor", "", range(0.1, 100),
      "by how much disparities are less certain than their refinement says");
    v(disparity_sigma_floor, "disparity_sigma_floor", "px", range(0, 10),
      "standard deviation added to that of a disparity, on the level of its octave");
  }
};

/// From a raw stereo image to a frame with measurements in the rectified camera: pyramids, ORB in both
/// images, stereo matching. Keeps its buffers; one thread at a time; deterministic.
class Frontend {
 public:
  /// The stereo search takes its scale factor from `options.orb`.
  Frontend(const StereoRig& rig, const FrontendOptions& options);

  /// First half: key points of both raw images, of the sizes that the rig has.
  void extract(GrayView left, GrayView right);

  /// Second half: stereo matches, and from them the frame's measurements, descriptors and grid. Key points
  /// outside the cameras' domain are left out.
  void match(StereoFrame& frame);

  /// What to take off the disparities of the frames to come [px].
  void set_disparity_bias(double bias) { disparity_bias_ = bias; }

 private:
  void extract(GrayView image, ImagePyramid& pyramid, Features<256>& features);
  float disparity_sigma(const StereoMatch& match, int octave) const;
  void collect(StereoFrame& frame) const;

  FrontendOptions options_;
  OrbExtractor extractor_;
  StereoMatcher matcher_;
  ImagePyramid left_pyramid_, right_pyramid_;
  Features<256> left_features_, right_features_;
  std::vector<StereoMatch> matches_;
  double disparity_bias_ = 0;
};

}  // namespace sweepkit
