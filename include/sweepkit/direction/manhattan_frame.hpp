// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/direction/interpretation_plane.hpp"
#include "sweepkit/direction/vanishing_points.hpp"

namespace sweepkit {

struct ManhattanOptions {
  int hypotheses = 400;
  int candidates = 16;
  int refined = 8;
  double inlier_sigmas = 3.0;
  double up_sigma = 0.5;
  double tolerance = 3.0;
  int seed = 1;
  SegmentTrustOptions segments;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(hypotheses, "hypotheses", "", range(1, 100000), "pairs of segments whose common direction is tried");
    v(candidates, "candidates", "", range(1, 1000), "directions for which the other two are looked for");
    v(refined, "refined", "", range(1, 1000), "frames that are refined before the best is chosen");
    v(inlier_sigmas, "inlier_sigmas", "", range(0.5, 20.0),
      "a segment belongs to a direction within so many of its standard deviations");
    v(up_sigma, "up_sigma", "deg", range(0.0, 10.0),
      "standard deviation of a known up direction, in each axis");
    v(tolerance, "tolerance", "deg", range(0.1, 20.0),
      "error up to which a frame counts as right in `confidence`");
    v(seed, "seed", "", range(0, 2147483647), "seed of the pairs: same seed, same result");
    v.group(segments, "segments", "which segments are used and how far they are trusted");
  }
};

/// Three directions square to one another along which the edges of a scene run.
struct ManhattanFrame {
  /// Columns are the directions in the frame of the planes (the camera's). The second is the one nearest to
  /// the y axis (with a known up direction: opposite to it) and points along it; the third is the nearest of
  /// the rest to the z axis: a camera that looks along a wall, level, has the identity. Directions have no
  /// sign of their own, and the frame is one of 24 alike.
  SO3d R_camera_manhattan;
  /// Of the rotation vector in the camera's frame, Exp(phi) R [rad^2]: from the spread of the segments alone.
  Mat3<double> covariance = Mat3<double>::Zero();
  /// Probability that the frame is within `tolerance` of the scene's; how it was calibrated is in the page.
  double confidence = 0;
  std::array<double, 3> support{};  ///< weight of the segments along each direction
  double share = 0;                 ///< weight of the segments along any of them over that of all
  int segments = 0;                 ///< segments used
};

/// The least angle between two frames over the 24 that are alike [rad], in [0, 62.8 degrees].
double manhattan_distance(const SO3d& a, const SO3d& b);

/// Finds the Manhattan frame of one image from its segments (Coughlan and Yuille, Manhattan World, 1999):
/// two-line hypotheses for a direction, the other two by a vote of all segments over the angle about it,
/// consensus weighted by length and by the uncertainty of the end points, then maximum likelihood on SO(3)
/// under a mixture of three directions and outliers by iteratively reweighted least squares with a falling
/// scale. The same planes and options give the same result. Keeps its buffers; not thread-safe.
class ManhattanEstimator {
 public:
  explicit ManhattanEstimator(const ManhattanOptions& options = {});

  const ManhattanOptions& options() const { return options_; }

  /// Nothing with fewer than three segments, or where all segments together fix no frame (all parallel).
  std::optional<ManhattanFrame> estimate(std::span<const InterpretationPlane> planes);

  /// The same where the up direction is known: one segment suffices for each further direction.
  /// Nothing where no segment tells anything of a horizontal direction.
  /// @param up in the frame of the planes; of any length but zero, else Error(argument)
  std::optional<ManhattanFrame> estimate(std::span<const InterpretationPlane> planes, const Vec3<double>& up);

  /// For each plane of the last call the column of the frame that it belongs to, or -1.
  std::span<const std::int8_t> labels() const { return labels_; }

 private:
  struct Candidate {
    SO3d R;
    double score = 0;
  };
  /// What one pass over all planes gives: normal equations of a small turn, Exp(-H^-1 g) R.
  struct Equations {
    Mat3<double> H = Mat3<double>::Identity() * 1e-3;
    Vec3<double> g = Vec3<double>::Zero();
  };

  double score(const SO3d& R) const;
  void vote(const Vec3<double>& axis, std::vector<double>& peaks) const;
  void add_frame(const SO3d& R);
  Equations nearest_direction(const SO3d& R, double reach) const;
  Equations mixture(const SO3d& R) const;
  void turn(SO3d& R, const Equations& e) const;
  std::optional<ManhattanFrame> best_frame();
  void describe(ManhattanFrame& frame, const Candidate& best, double runner_up);

  ManhattanOptions options_;
  impl::PlaneSet planes_;
  VanishingPointFinder finder_;
  std::vector<VanishingPoint> points_;
  std::vector<Candidate> frames_;
  std::vector<double> peaks_;
  std::vector<InterpretationPlane> used_;
  std::vector<std::int32_t> index_;  // of the planes used, among those given
  std::vector<std::int8_t> labels_;
  std::optional<Vec3<double>> up_;
};

}  // namespace sweepkit
