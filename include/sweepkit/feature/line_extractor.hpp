// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/view.hpp"
#include "sweepkit/feature/lbd.hpp"
#include "sweepkit/feature/segments.hpp"
#include "sweepkit/image/pyramid.hpp"

namespace sweepkit {

struct LineOptions {
  int octaves = 3;
  double scale_factor = 1.5;
  SegmentOptions segments;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(octaves, "octaves", "", range(1, 16), "sizes of the image in which segments are looked for");
    v(scale_factor, "scale_factor", "", range(1.05, 4.0), "size of a pyramid level against the next");
    v.group(segments, "segments", "what counts as a segment; lengths are those on the level of its octave");
  }
};

/// Line segments with LBD descriptors on all levels of a pyramid. A segment is described on the level where
/// it was found, so that the strip about it grows with its scale; an edge found on several levels appears
/// once for each, as in the paper of LBD, and matches on the level that fits. Coordinates are those of level
/// 0. Deterministic; not for several threads at once. Allocates nothing once it has seen images of a kind.
class LineExtractor {
 public:
  /// Throws Error(option) if an option is out of range.
  explicit LineExtractor(const LineOptions& options = {}) : options_(options), detector_(options.segments) {
    check_options(options_);
  }

  const LineOptions& options() const { return options_; }

  /// Finds and describes segments, those of level 0 first. Replaces what `lines` held. Levels too small for a
  /// segment have none.
  void extract(const ImagePyramid& pyramid, LineFeatures<256>& lines) {
    lines.clear();
    for (int l = 0; l < pyramid.levels(); ++l) extract_level(pyramid.level(l), pyramid, l, lines);
  }

  /// Builds the pyramid that the options ask for, then extracts. An empty image has no segments.
  void extract(GrayView image, LineFeatures<256>& lines) {
    lines.clear();
    if (image.empty()) return;
    pyramid_.build(image, options_.octaves, options_.scale_factor);
    extract(pyramid_, lines);
  }

  /// Describes given segments of an image, each on the level of its octave (the last one for octaves that the
  /// pyramid lacks). Replaces what `descriptors` held; see BasicLbd::describe for segments that cannot be.
  void describe(const ImagePyramid& pyramid, std::span<const LineSegment> segments,
                std::vector<LineDescriptor>& descriptors) {
    descriptors.assign(segments.size(), {});
    for (int l = 0; l < pyramid.levels(); ++l) {
      bool built = false;
      for (std::size_t i = 0; i < segments.size(); ++i) {
        if (std::clamp(segments[i].octave, 0, pyramid.levels() - 1) != l) continue;
        if (!built) map_.build<std::uint8_t>(pyramid.level(l), EdgeMap::kNoRidges);
        built = true;
        descriptors[i] = describe_at(map_, pyramid, l, segments[i]);
      }
    }
  }

 private:
  LineDescriptor describe_at(const EdgeMap& map, const ImagePyramid& pyramid, int l,
                             const LineSegment& s) const {
    return lbd_.describe(map, pyramid.to_level_x(l, s.x1), pyramid.to_level_y(l, s.y1),
                         pyramid.to_level_x(l, s.x2), pyramid.to_level_y(l, s.y2));
  }

  void extract_level(GrayView level, const ImagePyramid& pyramid, int l, LineFeatures<256>& lines) {
    detector_.detect(level, found_);
    for (LineSegment& s : found_) {
      lines.descriptors.push_back(lbd_.describe(detector_.edge_map(), s.x1, s.y1, s.x2, s.y2));
      s = {pyramid.to_full_x(l, s.x1),
           pyramid.to_full_y(l, s.y1),
           pyramid.to_full_x(l, s.x2),
           pyramid.to_full_y(l, s.y2),
           s.width * pyramid.scale(l),
           s.contrast / pyramid.scale(l),
           s.response,
           l};
      lines.segments.push_back(s);
    }
  }

  LineOptions options_;
  SegmentDetector detector_;
  Lbd lbd_;
  ImagePyramid pyramid_;
  EdgeMap map_;
  std::vector<LineSegment> found_;
};

}  // namespace sweepkit
