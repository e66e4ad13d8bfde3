// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/match/keypoint_grid.hpp"
#include "sweepkit/match/match.hpp"
#include "sweepkit/match/orientation.hpp"

namespace sweepkit {

/// Where a map point should be seen, and how far from there to look.
struct ProjectionQuery {
  float u = 0, v = 0;  ///< predicted position in the rectified left image [px]
  float u_right = -1;  ///< predicted column in the rectified right image; negative: not predicted [px]
  float radius = 0;    ///< half side of the square to search [px]
  std::int32_t min_octave = 0;  ///< octaves to accept, both ends included
  std::int32_t max_octave = 31;
  float angle = 0;  ///< orientation of the point's feature when it was last seen [rad]
};

struct ProjectionOptions {
  int max_distance = 100;
  double ratio = 0.9;
  bool check_orientation = false;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(max_distance, "max_distance", "", range(0, 256), "largest Hamming distance of a match [bits]");
    v(ratio, "ratio", "", range(0.1, 1.0),
      "the best must lie below this part of the second best of the same octave; 1 switches the test off");
    v(check_orientation, "check_orientation", "", any_value(),
      "keep only matches that agree on how much the image turned");
  }
};

/// Anything that key points of a frame must offer to be matched by projection: rectified position, octave,
/// column in the right image (negative: none) and orientation.
template <class P>
concept ProjectableKeypoint = RectifiedPosition<P> && requires(const P p) {
  { p.u_right } -> std::convertible_to<float>;
  { p.angle } -> std::convertible_to<float>;
};

/// Finds for each predicted point the key point nearest in descriptor among those near its position.
/// One-to-one: a key point goes to the point with the smallest distance, at equal distance to the first.
/// Keeps its buffers between calls; not thread-safe.
class ProjectionMatcher {
 public:
  explicit ProjectionMatcher(const ProjectionOptions& options = {}) : options_(options) {
    check_options(options);
  }
  const ProjectionOptions& options() const { return options_; }

  /// @param queries predicted points; @param query_descriptors theirs, index by index
  /// @param grid built over `keypoints`
  /// @param keypoints, descriptors of the frame, index by index
  /// @param matches as many as queries
  /// @param taken key points that must not be used (!= 0), one for each key point; may be empty
  /// Returns the number of matches. Throws Error(argument) if lengths differ.
  template <ProjectableKeypoint Keypoint>
  int match(std::span<const ProjectionQuery> queries, std::span<const OrbDescriptor> query_descriptors,
            const KeypointGrid& grid, std::span<const Keypoint> keypoints,
            std::span<const OrbDescriptor> descriptors, std::span<Match> matches,
            std::span<const std::uint8_t> taken = {});

 private:
  ProjectionOptions options_;
  std::vector<std::int32_t> owner_;
  OrientationCheck orientation_;
};

}  // namespace sweepkit

#include "sweepkit/match/impl/projection.hpp"
