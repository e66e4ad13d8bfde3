// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <optional>
#include <span>
#include <vector>

#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/motion/gyro_integration.hpp"
#include "sweepkit/motion/wheel_decoder.hpp"

namespace sweepkit {

/// How far the wheels rolled over an interval, by their nominal radius, and how that changes with the offset
/// of their clock.
struct WheelRoll {
  double left = 0.0, right = 0.0;              ///< [m]
  double left_slope = 0.0, right_slope = 0.0;  ///< with respect to the offset [m/s]
  double path = 0.0;                           ///< |left| + |right|, forth and back both positive [m]
};

/// Keeps what wheels and gyro said of late, and answers for any interval in it: what calibration and slip
/// detection compare with vision. Not thread-safe.
class WheelTrack {
 public:
  /// @param keep how far back questions may reach [ns]
  WheelTrack(const WheelGeometry& geometry, const SE3d& T_body_base, const ImuNoise& noise,
             const WheelDecoderOptions& options = {}, TimeNs keep = 20 * kNsPerSecond)
      : decoder_(geometry, options),
        R_base_body_(T_body_base.rotation().inverse()),
        noise_(noise),
        keep_(keep) {}

  /// False for a sample that is refused.
  bool add(const WheelSample& sample) {
    const std::size_t refused = decoder_.refused();
    const auto step = decoder_.push(sample);
    if (decoder_.refused() != refused) return false;
    Point next = points_.empty() ? Point{} : points_.back();
    next.t = sample.t;
    if (step) {
      next.left += step->left;
      next.right += step->right;
      next.path += std::abs(step->left) + std::abs(step->right);
      if (!step->measured) ++next.holes;
    } else if (!points_.empty()) {
      ++next.holes;
    }
    points_.push_back(next);
    forget(points_, sample.t - keep_);
    return true;
  }
  bool add(const ImuSample& sample) {
    if (!std::isfinite(sample.gyro.sum()) || (!gyro_.empty() && sample.t <= gyro_.back().t)) return false;
    gyro_.push_back(sample);
    forget(gyro_, sample.t - keep_);
    return true;
  }

  /// What the wheels rolled from `begin` to `end`; `offset` is added to the stamps of the wheels. Nothing
  /// unless measured samples cover it.
  std::optional<WheelRoll> roll(TimeNs begin, TimeNs end, TimeNs offset = 0) const {
    const auto a = at(begin - offset), b = at(end - offset);
    if (!a || !b || a->holes != b->holes || end < begin) return std::nullopt;
    return WheelRoll{b->left - a->left, b->right - a->right, a->left_speed - b->left_speed,
                     a->right_speed - b->right_speed, b->path - a->path};
  }
  /// The gyro's turn about the base's z axis [rad], and its variance; nothing unless samples cover it.
  struct Turn {
    double angle = 0.0;
    double variance = 0.0;
  };
  std::optional<Turn> turn(TimeNs begin, TimeNs end, const Vec3<double>& bias) const {
    if (gyro_.empty() || gyro_.front().t > begin || gyro_.back().t < end || end <= begin) return std::nullopt;
    auto first = std::upper_bound(gyro_.begin(), gyro_.end(), begin,
                                  [](TimeNs t, const ImuSample& s) { return t < s.t; });
    const std::span<const ImuSample> samples(&*(first - 1),
                                             static_cast<std::size_t>(gyro_.end() - first) + 1);
    const auto delta = integrate_gyro(samples, begin, end, bias, noise_);
    if (!delta || delta->uncovered > 0) return std::nullopt;
    return Turn{(R_base_body_ * delta->R.log()).z(), delta->variance};
  }
  /// Newest stamps, by their own clocks; nothing before the first sample.
  std::optional<TimeNs> newest_wheel() const {
    return points_.empty() ? std::nullopt : std::optional(points_.back().t);
  }
  std::optional<TimeNs> newest_gyro() const {
    return gyro_.empty() ? std::nullopt : std::optional(gyro_.back().t);
  }

 private:
  struct Point {
    TimeNs t = 0;
    double left = 0.0, right = 0.0, path = 0.0;
    int holes = 0;
    double left_speed = 0.0, right_speed = 0.0;  // about t, only in what at() gives
  };

  template <class T>
  static void forget(std::vector<T>& values, TimeNs oldest) {
    if (values.size() < 2 || values[values.size() / 2].t >= oldest) return;
    values.erase(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2));
  }
  std::optional<Point> at(TimeNs t) const {
    if (points_.size() < 2 || t < points_.front().t || t > points_.back().t) return std::nullopt;
    auto after =
        std::upper_bound(points_.begin(), points_.end(), t, [](TimeNs x, const Point& p) { return x < p.t; });
    if (after == points_.end()) --after;
    const Point &a = *(after - 1), &b = *after;
    const double span = to_seconds(b.t - a.t), s = to_seconds(t - a.t) / span;
    Point p = b;
    p.left = a.left + s * (b.left - a.left);
    p.right = a.right + s * (b.right - a.right);
    p.path = a.path + s * (b.path - a.path);
    // Over five steps: a speed from whole ticks is rough.
    const auto from = after - std::min<std::ptrdiff_t>(3, after - points_.begin());
    const auto to = after + std::min<std::ptrdiff_t>(2, points_.end() - 1 - after);
    const double width = to_seconds(to->t - from->t);
    p.left_speed = (to->left - from->left) / width;
    p.right_speed = (to->right - from->right) / width;
    if (a.holes != b.holes) p.holes = -1 - b.holes;  // inside a hole: equals no other
    return p;
  }

  WheelDecoder decoder_;
  SO3d R_base_body_;
  ImuNoise noise_;
  TimeNs keep_;
  std::vector<Point> points_;
  std::vector<ImuSample> gyro_;
};

}  // namespace sweepkit
