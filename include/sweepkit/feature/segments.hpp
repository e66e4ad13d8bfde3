// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/view.hpp"
#include "sweepkit/feature/edge_map.hpp"
#include "sweepkit/feature/false_alarms.hpp"
#include "sweepkit/feature/segment.hpp"

namespace sweepkit {

struct SegmentOptions {
  double threshold = 3.0;
  double min_length = 12.0;
  double tolerance = 0.75;
  double max_gap = 10.0;
  double angle_tolerance = 18;
  double max_false_alarms = 1.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(threshold, "threshold", "grey levels / px", range(0.1, 250.0), "least gradient of an edge");
    v(min_length, "min_length", "px", range(5.0, 10000.0), "least length of a segment");
    v(tolerance, "tolerance", "px", range(0.1, 5.0), "how far edge points may lie off their segment");
    v(max_gap, "max_gap", "px", range(0.0, 1000.0),
      "longest gap over which two collinear segments become one");
    v(angle_tolerance, "angle_tolerance", "deg", range(1.0, 80.0),
      "how far the edge's direction at a pixel may be off its segment's");
    v(max_false_alarms, "max_false_alarms", "", range(1e-300, 1e300),
      "segments to expect in an image of noise; those expected more often are dropped");
  }
};

/// Line segments in the manner of edge drawing: the gradient's ridges (EdgeMap) are linked to chains of
/// points that lie between pixels, chains are cut into stretches of straight line, each a fit by total least
/// squares to all its points; collinear stretches across small gaps become one; what noise could bring about
/// as well is dropped (Validation). After C. Akinlar, C. Topal, EDLines (Pattern Recognition Letters 2011),
/// and I. Suarez et al., ELSED (Pattern Recognition 2022); the validation is that of R. Grompone von Gioi et
/// al., LSD (PAMI 2010).
///
/// Deterministic; SIMD and portable paths give identical segments. Not for several threads at once: give each
/// its own. Allocates nothing once it has seen images of a kind.
template <EdgePixel Pixel, SegmentValidation Validation>
class BasicSegmentDetector {
 public:
  /// Throws Error(option) if an option is out of range.
  explicit BasicSegmentDetector(const SegmentOptions& options = {}) : options_(options) {
    check_options(options_);
  }

  const SegmentOptions& options() const { return options_; }

  /// Finds segments, in the order of reading of the first pixel met. Replaces what `segments` held. An image
  /// without content, one too small (below 5 px) included, has none.
  void detect(View2d<const Pixel> image, std::vector<LineSegment>& segments);

  /// The gradient of the last image. Its ridges are spent.
  const EdgeMap& edge_map() const { return map_; }

 private:
  /// A point of an edge, between pixels across it, and the gradient there.
  struct EdgePoint {
    float x, y;
    std::int16_t gx, gy;
  };
  struct Line {
    double cx, cy;  // centre
    double dx, dy;  // unit direction
    double sigma;   // of the points about it
  };
  /// Sums over points, for a line by total least squares.
  struct Fit {
    double n = 0, x = 0, y = 0, xx = 0, xy = 0, yy = 0;

    void add(const EdgePoint& p);
    void add(const Fit& other);
    Line solve() const;
  };
  /// A stretch of straight edge, dark on its left.
  struct Stretch {
    Fit fit;
    Line line;
    double t1, t2;    // of its ends along the line
    int points;       // pixels from end to end
    int aligned;      // of which the edge runs along the line
    double contrast;  // sum of the gradients across
    bool alive;

    double x(double t) const { return line.cx + t * line.dx; }
    double y(double t) const { return line.cy + t * line.dy; }
  };

  void link(int x, int y);
  void link_one_way(int x, int y, int sign, std::vector<EdgePoint>& points);
  EdgePoint point_at(int x, int y) const;
  void cut_chain();
  void measure(int first, int last, const Fit& fit);
  void join_stretches();
  bool join(Stretch& a, Stretch& b) const;
  double response(const Stretch& s) const { return validation_.response(s.points, s.aligned); }

  SegmentOptions options_;
  Validation validation_;
  EdgeMap map_;
  std::vector<EdgePoint> chain_, back_;
  std::vector<Stretch> stretches_;
  std::vector<std::int32_t> cell_of_, cell_start_, in_cell_;
};

/// The usual detector: 8-bit images, a control of false alarms.
using SegmentDetector = BasicSegmentDetector<std::uint8_t, NumberOfFalseAlarms>;

}  // namespace sweepkit

#include "sweepkit/feature/impl/segments.hpp"
