// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/feature/lbd.hpp"
#include "sweepkit/feature/segment.hpp"
#include "sweepkit/geometry/line_triangulation.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/match/match.hpp"
#include "sweepkit/match/segment_grid.hpp"

namespace sweepkit {

/// What stereo matching found for a left segment, in the rectified pair.
struct LineStereoMatch {
  std::int32_t right = -1;    ///< right segment; -1 none
  std::int32_t distance = 0;  ///< Hamming distance of the descriptors
  Segment2d left;             ///< the left segment, rectified; also of unmatched ones
  float disparity1 = 0;       ///< of its start: to the right line in the same row; positive for matches [px]
  float disparity2 = 0;       ///< of its end
  float sigma1 = 0;           ///< standard deviations to expect of the disparities [px]
  float sigma2 = 0;
  std::uint8_t rectified = 0;  ///< 0 where the rig cannot rectify the segment; `left` is zero then

  bool found() const { return right >= 0; }
  friend bool operator==(const LineStereoMatch&, const LineStereoMatch&) = default;
};

struct LineStereoOptions {
  double min_overlap = 0.5;
  double min_angle = 8.0;
  double max_turn = 30.0;
  double max_disparity = 200.0;
  int max_distance = 60;
  int max_octave_difference = 1;
  double ratio = 0.85;
  bool left_right_check = true;
  double scale_factor = 1.5;
  double sigma = 0.5;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(min_overlap, "min_overlap", "", range(0.01, 1.0),
      "share of the rows of the shorter segment that both have in common");
    v(min_angle, "min_angle", "deg", range(1.0, 80.0),
      "segments nearer to the direction of the baseline have no certain disparity and are left out");
    v(max_turn, "max_turn", "deg", range(1.0, 90.0), "by how much the directions of a pair may differ");
    v(max_disparity, "max_disparity", "px", range(1.0, 10000.0), "largest disparity of an end");
    v(max_distance, "max_distance", "", range(0, 256), "largest Hamming distance of a match [bits]");
    v(max_octave_difference, "max_octave_difference", "", range(0, 31), "octaves that a pair may differ by");
    v(ratio, "ratio", "", range(0.1, 1.0),
      "the best must lie below this part of the second best elsewhere; 1 switches the test off");
    v(left_right_check, "left_right_check", "", any_value(),
      "keep a pair only if the left segment is also the best for the right one");
    v(scale_factor, "scale_factor", "", range(1.01, 4.0),
      "size of a pyramid level against the next: that of the extractor");
    v(sigma, "sigma", "px", range(0.01, 10.0),
      "standard deviation of an edge point, on the level of its segment's octave");
  }
};

/// Stereo matching of segments by their rectified ends; images are not read. The right segments are sorted
/// into a grid; for a left one the candidates are those that share rows with it, run in a like direction with
/// the same side dark, and give both of its ends a disparity in (0, max_disparity]; the smallest descriptor
/// distance wins, at equal distance the first. Lenses bend long lines: rectification takes the chord.
/// Keeps its buffers: allocates nothing after warm-up. Not thread-safe.
class LineStereoMatcher {
 public:
  /// Throws Error(option) if an option is out of range.
  explicit LineStereoMatcher(const StereoRig& rig, const LineStereoOptions& options = {});

  const StereoRig& rig() const { return rig_; }
  const LineStereoOptions& options() const { return options_; }

  /// @param matches one for each left segment
  /// Returns the number of matches. Throws Error(argument) where segments and descriptors differ in number.
  int match(const LineFeatures<256>& left, const LineFeatures<256>& right,
            std::vector<LineStereoMatch>& matches);

  /// The segment in space of a match, in the rectified left camera, with its covariance; nothing for what was
  /// not matched or lies too nearly in the plane of the other view.
  std::optional<Segment3d> triangulate(const LineStereoMatch& match) const;

 private:
  struct Side2d {
    std::vector<Segment2d> segments;
    std::vector<Vec2<float>> directions;  // unit
    std::vector<std::uint8_t> skip;       // not rectified, a point, or along the baseline
  };
  struct Pairing {
    float disparity1, disparity2;  // of the ends of the left segment
    float place1, place2;          // of their rows along the right one: 0 its start, 1 its end
  };

  void rectify(Side side, const LineFeatures<256>& lines, Side2d& rectified) const;
  std::optional<Pairing> pair(std::size_t i, std::size_t j) const;

  StereoRig rig_;
  LineStereoOptions options_;
  float cos_max_turn_, sin_min_angle_;
  Side2d left_, right_;
  SegmentGrid grid_;
  std::vector<std::uint64_t> best_left_;  // for each right segment: distance, left index
};

/// Where a line of the map, or of the frame before, should be seen.
struct LineQuery {
  Segment2d predicted;          ///< in the rectified left image [px]
  float radius = 0;             ///< how far off its line the segment may lie [px]
  std::int32_t min_octave = 0;  ///< octaves to accept, both ends included
  std::int32_t max_octave = 31;
};

/// The place of a segment in space as a camera sees it, cut off at the camera's plane; nothing if it lies
/// behind. @param T_camera_frame from the segment's frame to the camera's
std::optional<LineQuery> predict_line(const RectifiedCamera& camera, const SE3d& T_camera_frame,
                                      const Segment3d& segment, float radius);

struct LineProjectionOptions {
  double min_overlap = 0.3;
  double max_turn = 10.0;
  int max_distance = 80;
  double ratio = 0.9;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(min_overlap, "min_overlap", "", range(0.01, 1.0),
      "share of the shorter of prediction and segment that both have in common, along the prediction");
    v(max_turn, "max_turn", "deg", range(0.1, 90.0),
      "by how much a segment may be turned against its prediction");
    v(max_distance, "max_distance", "", range(0, 256), "largest Hamming distance of a match [bits]");
    v(ratio, "ratio", "", range(0.1, 1.0),
      "the best must lie below this part of the second best elsewhere; 1 switches the test off");
  }
};

/// Finds for each predicted line the segment nearest in descriptor among those near it. One-to-one: a segment
/// goes to the query with the smallest distance, at equal distance to the first. Keeps its buffers; not
/// thread-safe.
class LineProjectionMatcher {
 public:
  explicit LineProjectionMatcher(const LineProjectionOptions& options = {});

  const LineProjectionOptions& options() const { return options_; }

  /// @param queries predictions; @param query_descriptors theirs, index by index
  /// @param segments, octaves, descriptors of the frame, index by index; segments rectified
  /// @param matches one for each query
  /// Returns the number of matches. Throws Error(argument) if lengths differ.
  int match(std::span<const LineQuery> queries, std::span<const LineDescriptor> query_descriptors,
            std::span<const Segment2d> segments, std::span<const std::int32_t> octaves,
            std::span<const LineDescriptor> descriptors, std::vector<Match>& matches);

 private:
  LineProjectionOptions options_;
  SegmentGrid grid_;
  std::vector<std::uint64_t> best_query_;
  std::vector<std::uint8_t> skip_;
};

}  // namespace sweepkit
