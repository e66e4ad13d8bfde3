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

}  // namespace sweepkit
