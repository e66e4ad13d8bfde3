// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/options.hpp"
#include "sweepkit/feature/brief.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/feature/fast.hpp"
#include "sweepkit/feature/orientation.hpp"
#include "sweepkit/feature/spread.hpp"
#include "sweepkit/image/blur.hpp"
#include "sweepkit/image/pyramid.hpp"

namespace sweepkit {

/// What OrbExtractor looks for, and the pyramid that it expects.
struct OrbOptions {
  int count = 1000;
  int levels = 8;
  double scale_factor = 1.2;
  int threshold = 20;
  int fallback_threshold = 7;
  int cell_size = 60;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(count, "count", "", range(1, 20000), "key points to find in an image");
    v(levels, "levels", "", range(1, 16), "levels of the image pyramid");
    v(scale_factor, "scale_factor", "", range(1.05, 2.0), "size of a pyramid level against the next");
    v(threshold, "threshold", "", range(1, 254), "grey levels by which a corner differs from its circle");
    v(fallback_threshold, "fallback_threshold", "", range(1, 254),
      "the same, in cells without a corner above the threshold");
    v(cell_size, "cell_size", "px", range(8, 1000), "side of the cells that share the key points evenly");
  }
};

/// Oriented FAST and rotated BRIEF (E. Rublee et al., ICCV 2011) on all levels of a pyramid, with key points
/// spread evenly over each level. Deterministic; SIMD and portable paths give identical features. Not for
/// several threads at once: give each its own. Allocates nothing once it has seen images of a size.
template <PairPattern Pattern>
class BasicOrbExtractor {
 public:
  static constexpr int kBits = Pattern::kBits;

  /// Throws Error(option) if an option is out of range.
  explicit BasicOrbExtractor(const OrbOptions& options = {}) : options_(options) { check_options(options_); }

  const OrbOptions& options() const { return options_; }

  /// Key points lie at least so far from the sides of their level [px].
  static constexpr int border() { return std::max(RotatedBrief<Pattern>::radius(), kOrientationRadius + 1); }

  /// Finds and describes key points, those of level 0 first, within a level the strongest first. Coordinates
  /// are those of level 0. Replaces what `features` held.
  void extract(const ImagePyramid& pyramid, Features<kBits>& features) {
    features.clear();
    if (pyramid.empty()) return;
    brief_.prepare(pyramid.stride());
    // What a poor level leaves over goes to the next ones.
    double weight_left = 0;
    for (int l = 0; l < pyramid.levels(); ++l) weight_left += level_weight(pyramid.level(l));
    for (int l = 0; l < pyramid.levels(); ++l) {
      const double weight = level_weight(pyramid.level(l));
      if (weight <= 0) break;  // no room, and none on smaller levels
      const int open = options_.count - static_cast<int>(features.size());
      const int wanted = static_cast<int>(std::lround(open * weight / weight_left));
      weight_left -= weight;
      extract_level(pyramid, l, wanted, features);
    }
  }

  /// Builds the pyramid that the options ask for, then extracts.
  void extract(GrayView image, Features<kBits>& features) {
    pyramid_.build(image, options_.levels, options_.scale_factor);
    extract(pyramid_, features);
  }

 private:
  /// Share of the key points, from the area where they may lie. By area fine levels, which locate better, get
  /// almost all; by side (area^0.5) coarse ones, which match better over a change of scale, get more.
  static double level_weight(GrayView level) {
    const double columns = std::max(0, level.width - 2 * border());
    const double rows = std::max(0, level.height - 2 * border());
    return std::pow(columns * rows, 0.6);
  }

  void extract_level(const ImagePyramid& pyramid, int l, int wanted, Features<kBits>& features) {
    const GrayView image = pyramid.level(l);
    fast_.detect(image, std::min(options_.threshold, options_.fallback_threshold), border(), corners_);
    spread_.select(corners_, image.width, image.height, wanted, options_.cell_size, options_.threshold,
                   chosen_);
    if (chosen_.empty()) return;
    smoothed_.resize(image.width, image.height, pyramid.stride());
    blur_(image, smoothed_.view());
    for (const Corner& c : chosen_) {
      const SubPixel offset = fast_.refine(c);
      const float angle = centroid_angle(patch_moments(image, c.x, c.y));
      features.keypoints.push_back({pyramid.to_full_x(l, c.x + offset.x),
                                    pyramid.to_full_y(l, c.y + offset.y), angle, static_cast<float>(c.score),
                                    l});
      features.descriptors.push_back(brief_.describe(smoothed_, c.x, c.y, angle));
    }
  }

  OrbOptions options_;
  ImagePyramid pyramid_;
  FastDetector fast_;
  std::vector<Corner> corners_, chosen_;
  SpreadSelector spread_;
  GaussianBlur7 blur_;
  GrayImage smoothed_;
  RotatedBrief<Pattern> brief_;
};

/// The usual extractor: 256 bits, the published pattern.
using OrbExtractor = BasicOrbExtractor<OrbPattern>;

}  // namespace sweepkit
