// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <numbers>

#include "sweepkit/core/options.hpp"

namespace sweepkit {

/// What a keyframe rule may look at.
struct KeyframeSituation {
  int tracked_points = 0;    ///< map points found in this frame
  int reference_points = 0;  ///< map points of the newest keyframe that others see too
  int near_tracked = 0;      ///< of measurements with a certain depth: those with a map point
  int near_untracked = 0;    ///< and those without
  double distance = 0;       ///< from the newest keyframe [m]
  double angle = 0;          ///< from the newest keyframe [rad]
  double seconds = 0;        ///< since the newest keyframe
};

/// Anything that says whether a frame becomes a keyframe.
template <class Rule>
concept KeyframePolicy = requires(const Rule rule, const KeyframeSituation& situation) {
  { rule.wants_keyframe(situation) } -> std::convertible_to<bool>;
};

/// A keyframe whenever tracking has lost touch with the newest one: too few of its points are left, or too
/// many near points of this frame are not in the map yet, or the view has turned away.
struct KeyframeRule {
  double tracked_ratio = 0.75;
  int near_tracked = 100;
  int near_untracked = 70;
  double max_angle = 15;
  double max_distance = 0.5;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(tracked_ratio, "tracked_ratio", "", range(0, 1),
      "share of the newest keyframe's points below which one is made");
    v(near_tracked, "near_tracked", "", range(0, 10000), "with fewer near points tracked ...");
    v(near_untracked, "near_untracked", "", range(0, 10000), "... and more near ones untracked one is made");
    v(max_angle, "max_angle", "deg", range(0.1, 180),
      "turn since the newest keyframe after which one is made");
    v(max_distance, "max_distance", "m", range(0.001, 1000),
      "way since the newest keyframe after which one is made");
  }

  bool wants_keyframe(const KeyframeSituation& s) const {
    return s.tracked_points < tracked_ratio * s.reference_points ||
           (s.near_tracked < near_tracked && s.near_untracked > near_untracked) ||
           s.angle > max_angle * std::numbers::pi / 180 || s.distance > max_distance;
  }
};

static_assert(KeyframePolicy<KeyframeRule>);

/// A keyframe of a robot that sees nothing, whenever beta = distance / a + angle / b exceeds 1.
struct BlindKeyframeRule {
  double distance = 0.1;
  double angle = 10;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(distance, "distance", "m", range(0.001, 1000), "way since the newest keyframe that alone makes one");
    v(angle, "angle", "deg", range(0.1, 360), "turn since the newest keyframe that alone makes one");
  }

  double beta(double metres, double radians) const {
    return metres / distance + radians * (180 / std::numbers::pi) / angle;
  }
  bool wants_keyframe(const KeyframeSituation& s) const { return beta(s.distance, s.angle) > 1; }
};

static_assert(KeyframePolicy<BlindKeyframeRule>);

}  // namespace sweepkit
