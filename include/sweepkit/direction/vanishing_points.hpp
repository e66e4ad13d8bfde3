// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/direction/impl/plane_set.hpp"
#include "sweepkit/direction/interpretation_plane.hpp"

namespace sweepkit {

struct VanishingPointOptions {
  int max_points = 6;
  int hypotheses = 400;
  double inlier_sigmas = 3.0;
  double separation = 4.0;
  double min_support = 1.5;
  int seed = 1;
  SegmentTrustOptions segments;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(max_points, "max_points", "", range(1, 1000), "vanishing points to give at most");
    v(hypotheses, "hypotheses", "", range(1, 100000), "pairs of segments whose common direction is tried");
    v(inlier_sigmas, "inlier_sigmas", "", range(0.5, 20.0),
      "a segment belongs to a direction within so many of its standard deviations");
    v(separation, "separation", "deg", range(0.0, 45.0), "least angle between two vanishing points");
    v(min_support, "min_support", "", range(0.0, 1e6),
      "least weight of the segments of a vanishing point beyond what chance would give it");
    v(seed, "seed", "", range(0, 2147483647), "seed of the pairs: same seed, same result");
    v.group(segments, "segments", "which segments are used and how far they are trusted");
  }
};

/// A direction of space that several segments of one image share; its vanishing point is where a ray along it
/// meets the image plane, possibly at infinity.
struct VanishingPoint {
  Vec3<double> direction;  ///< unit, in the frame of the planes; the sign means nothing, z is not negative
  double support = 0;      ///< weight of its segments, those farther off counting less
  double sigma = 0;  ///< standard deviation along the direction's worst axis, from its segments alone [rad]
  int segments = 0;
};

/// Vanishing points of a calibrated camera, by consensus on the sphere: the cross product of two normals is a
/// hypothesis; pairs are drawn by weight. Keeps its buffers; not thread-safe.
class VanishingPointFinder {
 public:
  explicit VanishingPointFinder(const VanishingPointOptions& options = {});

  const VanishingPointOptions& options() const { return options_; }

  /// Vanishing points by falling support; each segment supports the strongest one that it fits, and no other.
  /// Empty with fewer than two segments. All parallel gives one.
  void find(std::span<const InterpretationPlane> planes, std::vector<VanishingPoint>& points);

  /// For each plane of the last find the point that it belongs to, or -1.
  std::span<const std::int32_t> labels() const { return labels_; }

  /// Directions with the largest consensus, `separation` apart, each refined; segments may support several.
  /// `planes` must have been assigned.
  void candidates(const impl::PlaneSet& planes, int count, std::vector<VanishingPoint>& points);

 private:
  struct Hypothesis {
    Vec3<float> direction;
    float support;
  };

  VanishingPointOptions options_;
  impl::PlaneSet planes_;
  std::vector<Hypothesis> hypotheses_;
  std::vector<double> cumulative_;
  std::vector<std::int32_t> labels_;
};

}  // namespace sweepkit
