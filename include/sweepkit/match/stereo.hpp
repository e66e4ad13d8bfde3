// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/image/pyramid.hpp"
#include "sweepkit/match/stereo_filter.hpp"
#include "sweepkit/match/stereo_refinement.hpp"
#include "sweepkit/match/stereo_search.hpp"

namespace sweepkit {

/// The accelerated sparse stereo matcher: search by key points (StereoSearch), then a disparity to a part of
/// a pixel and the removal of outliers as policies. No image is rectified at any step. Keeps its buffers:
/// allocates nothing after warm-up. Not thread-safe; give each thread its own.
template <StereoRefinement Refinement, StereoFilter Filter>
class BasicStereoMatcher {
 public:
  struct Options {
    StereoSearchOptions search;
    typename Refinement::Options refinement;
    typename Filter::Options filter;

    template <class Visitor>
    void visit_options(Visitor& v) {
      v.group(search, "search", "which key points are paired");
      v.group(refinement, "refinement", "disparity to a part of a pixel");
      v.group(filter, "filter", "removal of outliers");
    }
  };

  explicit BasicStereoMatcher(const StereoRig& rig, const Options& options = {})
      : options_(options),
        search_(rig, options.search),
        refinement_(rig, options.refinement),
        filter_(options.filter) {
    check_options(options_);
  }

  const StereoRig& rig() const { return search_.rig(); }
  const Options& options() const { return options_; }

  /// Matches the key points of a raw stereo image.
  /// @param left_pyramid, right_pyramid the raw images in which the key points were found
  /// @param prior expected disparity of each left key point (focal * baseline / depth) [px], not positive
  /// where
  ///   nothing is expected; or empty
  /// @param matches one for each left key point
  /// Returns the number of matches. Throws Error(argument) for lengths that do not agree.
  int match(const Features<256>& left, const ImagePyramid& left_pyramid, const Features<256>& right,
            const ImagePyramid& right_pyramid, std::span<const float> prior,
            std::vector<StereoMatch>& matches) {
    search_.match(left, right, prior, matches);
    refinement_.refine(left, left_pyramid, right, right_pyramid, matches);
    filter_.filter(matches);
    return static_cast<int>(std::ranges::count_if(matches, &StereoMatch::found));
  }

 private:
  Options options_;
  StereoSearch search_;
  Refinement refinement_;
  Filter filter_;
};

using StereoMatcher = BasicStereoMatcher<PatchRefinement, MedianFilter>;
using StereoOptions = StereoMatcher::Options;

}  // namespace sweepkit
