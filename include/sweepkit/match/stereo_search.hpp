// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/match/keypoint_grid.hpp"

namespace sweepkit {

/// What stereo matching found for a left key point. Positions are those of the rectified pair.
struct StereoMatch {
  std::int32_t right = -1;  ///< right key point; -1 none
  float u_left = 0;         ///< rectified position of the left key point, also of unmatched ones [px]
  float v_left = 0;
  float u_right = 0;           ///< u_left - disparity [px]
  float disparity = 0;         ///< positive for matches, 0 for none [px]
  float sigma = 0;             ///< standard deviation to expect of the disparity [px]
  std::int32_t distance = 0;   ///< Hamming distance of the descriptors
  std::uint8_t rectified = 0;  ///< 0 where the rig cannot rectify the key point; u_left, v_left are 0 then

  bool found() const { return right >= 0; }
  friend bool operator==(const StereoMatch&, const StereoMatch&) = default;
};

struct StereoSearchOptions {
  double row_tolerance = 2.0;
  double threshold = 16.0;
  int max_distance = 100;
  int max_octave_difference = 1;
  double ratio = 0.9;
  bool left_right_check = true;
  double scale_factor = 1.2;
  double sigma = 0.6;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(row_tolerance, "row_tolerance", "px", range(0.0, 20.0),
      "rows that a right key point may lie off, times the scale of the left one's octave");
    v(threshold, "threshold", "px", range(0.1, 1000.0), "half range of disparity about a prior");
    v(max_distance, "max_distance", "", range(0, 256), "largest Hamming distance of a match [bits]");
    v(max_octave_difference, "max_octave_difference", "", range(0, 31), "octaves that a pair may differ by");
    v(ratio, "ratio", "", range(0.1, 1.0),
      "the best must lie below this part of the second best elsewhere; 1 switches the test off");
    v(left_right_check, "left_right_check", "", any_value(),
      "keep a pair only if the left key point is also the best for the right one");
    v(scale_factor, "scale_factor", "", range(1.01, 4.0),
      "size of a pyramid level against the next; Frontend puts in that of its pyramid");
    v(sigma, "sigma", "px", range(0.01, 10.0),
      "standard deviation of a disparity from key points alone, on the level of their octave");
  }
};

/// Stereo matching by key points alone: images are neither rectified nor read. The key points of both images
/// are rectified as points; those of the right one are sorted into bands of rows by cells of columns. For a
/// left key point of octave o the candidates are the right ones whose row differs by at most row_tolerance *
/// scale_factor^o and whose disparity lies in (0, focal], which is depth >= baseline, or within `threshold`
/// of a prior disparity; the smallest descriptor distance wins, at equal distance the first. Keeps its
/// buffers: allocates nothing after warm-up. Not thread-safe.
class StereoSearch {
 public:
  explicit StereoSearch(const StereoRig& rig, const StereoSearchOptions& options = {});

  const StereoRig& rig() const { return rig_; }
  const StereoSearchOptions& options() const { return options_; }

  /// @param prior expected disparity of each left key point [px], not positive where nothing is expected; or
  ///   empty
  /// @param matches one for each left key point; u_right is that of the right key point
  /// Returns the number of matches. Throws Error(argument) where key points and descriptors differ in number,
  /// prior is neither empty nor as long as the left key points, or an octave lies outside [0, 32).
  int match(const Features<256>& left, const Features<256>& right, std::span<const float> prior,
            std::vector<StereoMatch>& matches);

 private:
  struct Position {
    float u, v;
    std::int32_t octave;
  };

  int search(const Features<256>& left, std::span<const float> prior, std::vector<StereoMatch>& matches);
  int keep_mutual(std::vector<StereoMatch>& matches) const;

  StereoRig rig_;
  StereoSearchOptions options_;
  std::array<float, 32> scale_;
  KeypointGrid grid_;
  std::vector<Vec2<float>> rectified_;
  std::vector<std::uint8_t> valid_, skip_;
  std::vector<Position> right_;
  std::vector<OrbDescriptor> right_descriptors_;  // in the order of the grid
  std::vector<std::uint64_t> best_left_;          // for each slot of the grid: distance, left index
  std::vector<std::int32_t> slot_;                // for each left key point: its right one's slot
  std::vector<std::int32_t> slots_;               // candidates
  std::vector<std::uint32_t> distances_;          // theirs
};

}  // namespace sweepkit
