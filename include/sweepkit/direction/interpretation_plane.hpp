// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/feature/segment.hpp"
#include "sweepkit/geometry/camera.hpp"

namespace sweepkit {

/// The plane through the centre of projection and a segment: all that one view tells of a line's direction d
/// is normal . d = 0 (Barnard, Interpreting perspective images, 1983). All vectors are unit and in the frame
/// of the camera, or of a rotation given to interpretation_planes.
struct InterpretationPlane {
  Vec3<double> normal;       ///< middle x along
  Vec3<double> middle;       ///< ray to the middle of the segment
  Vec3<double> along;        ///< in the plane, square to `middle`, towards the segment's end
  double turn_sigma = 0;     ///< standard deviation of the plane's turn about `middle` [rad]
  double shift_sigma = 0;    ///< the same about `along` [rad]
  double length = 0;         ///< of the segment in the image [px]
  std::int32_t segment = 0;  ///< its index

  /// Variance of normal . direction that the end points cause [rad^2].
  double variance(const Vec3<double>& direction) const {
    const double a = turn_sigma * along.dot(direction), b = shift_sigma * middle.dot(direction);
    return a * a + b * b;
  }
};

/// Which segments are used and how far they are trusted.
struct SegmentTrustOptions {
  double min_length = 15.0;
  int max_segments = 400;
  double endpoint_sigma = 0.7;
  double model_sigma = 0.5;
  double full_length = 30.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(min_length, "min_length", "px", range(2.0, 1000.0), "shorter segments are not used");
    v(max_segments, "max_segments", "", range(3, 100000), "of more segments only the longest are used");
    v(endpoint_sigma, "endpoint_sigma", "px", range(0.01, 20.0),
      "standard deviation of an end point across its segment");
    v(model_sigma, "model_sigma", "deg", range(0.0, 10.0),
      "by how much edges of a building depart from its directions, and lenses from their model");
    v(full_length, "full_length", "px", range(1.0, 10000.0),
      "segments of this length and more have the weight 1, shorter ones less in proportion");
  }
};

/// Planes of the segments of one image, in the order of the segments. Left out are segments that are too
/// short, not finite or outside the camera's model.
/// @param R_frame_camera turns rays of the camera into the frame in which the planes are wanted
void interpretation_planes(const Camera& camera, std::span<const LineSegment> segments,
                           const SegmentTrustOptions& options, std::vector<InterpretationPlane>& planes,
                           const SO3d& R_frame_camera = {});

}  // namespace sweepkit
