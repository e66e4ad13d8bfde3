// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <utility>

#include "sweepkit/bow/bag.hpp"
#include "sweepkit/bow/vocabulary.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/feature/descriptor.hpp"

namespace sweepkit {

/// The words of the points and of the lines of an image.
struct PointLineBag {
  Bag points, lines;
};

/// Two small vocabularies, one over descriptors of points (ORB) and one over those of lines (LBD), with one
/// score. Threads may share one.
template <int PointBits = 256, int LineBits = 256>
class PointLineVocabulary {
 public:
  using Point = BinaryDescriptor<PointBits>;
  using Line = BinaryDescriptor<LineBits>;

  /// @param line_weight part of the score that lines have, in [0, 1]
  /// Throws Error(argument) for a weight out of range or vocabularies of different scores.
  PointLineVocabulary(Vocabulary<PointBits> points, Vocabulary<LineBits> lines, double line_weight = 0.2)
      : points_(std::move(points)), lines_(std::move(lines)), line_weight_(line_weight) {
    require(line_weight >= 0 && line_weight <= 1, "PointLineVocabulary line_weight", "must be in [0, 1]",
            line_weight);
    require(points_.info().score == lines_.info().score, "PointLineVocabulary lines",
            "must have the score of the points", static_cast<int>(lines_.info().score));
  }

  const Vocabulary<PointBits>& points() const { return points_; }
  const Vocabulary<LineBits>& lines() const { return lines_; }
  double line_weight() const { return line_weight_; }

  void transform(std::span<const Point> points, std::span<const Line> lines, PointLineBag& bag,
                 TransformBuffers& buffers) const {
    points_.transform(points, bag.points, buffers);
    lines_.transform(lines, bag.lines, buffers);
  }
  PointLineBag transform(std::span<const Point> points, std::span<const Line> lines) const {
    PointLineBag bag;
    TransformBuffers buffers;
    transform(points, lines, bag, buffers);
    return bag;
  }

  /// (1 - line_weight) times the score of the points plus line_weight times that of the lines. Where one of
  /// the images has no lines the points alone decide, so that it is not less alike to others for that.
  double score(const PointLineBag& a, const PointLineBag& b) const {
    const double points = points_.score(a.points, b.points);
    if (line_weight_ == 0 || a.lines.empty() || b.lines.empty()) return points;
    return (1 - line_weight_) * points + line_weight_ * lines_.score(a.lines, b.lines);
  }

 private:
  Vocabulary<PointBits> points_;
  Vocabulary<LineBits> lines_;
  double line_weight_;
};

}  // namespace sweepkit
