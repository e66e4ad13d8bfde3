// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "drive_path.hpp"

#include <algorithm>
#include <cmath>

#include "smooth_step.hpp"

namespace sweepkit {

RoundedPath::RoundedPath(const Points& points, double corner) : origin_(points.front()) {
  std::vector<double> lengths;
  Points directions;
  for (std::size_t i = 1; i < points.size(); ++i) {
    const Vec2<double> piece = points[i] - points[i - 1];
    lengths.push_back(piece.norm());
    directions.push_back(piece / lengths.back());
  }
  direction_ = directions.front();
  length_ = lengths.front();
  for (std::size_t i = 1; i < lengths.size(); ++i) {
    // The first and the last piece are shared with nobody.
    const double before = i == 1 ? lengths[0] : 0.5 * lengths[i - 1];
    const double after = i + 1 == lengths.size() ? lengths[i] : 0.5 * lengths[i];
    corners_.push_back({length_, std::min({corner, before, after}), directions[i] - directions[i - 1]});
    length_ += lengths[i];
  }
}

RoundedPath::Place RoundedPath::at(double s) const {
  Place place{origin_ + s * direction_, direction_, 0.0};
  Vec2<double> change(0, 0);
  for (const Corner& c : corners_) {
    const double width = 2.0 * c.half, x = (s - c.s + c.half) / width;
    if (x <= 0.0) break;
    place.p += width * smooth_step_integral(x) * c.bend;
    place.d += smooth_step(x) * c.bend;
    change += smooth_step_slope(x) / width * c.bend;
  }
  const double speed2 = place.d.squaredNorm();
  place.curvature = (place.d.x() * change.y() - place.d.y() * change.x()) / (speed2 * std::sqrt(speed2));
  return place;
}

PathTiming::PathTiming(const RoundedPath& path, double speed, double turn_rate, double acceleration) {
  const auto count = static_cast<std::size_t>(std::ceil(path.length() / 0.004)) + 2;
  const double ds = path.length() / static_cast<double>(count - 1);
  // The fastest at each place, then what can be reached from rest at both ends.
  std::vector<double> limit(count);
  for (std::size_t i = 0; i < count; ++i) {
    const RoundedPath::Place place = path.at(ds * static_cast<double>(i));
    const double bend = std::abs(place.curvature);
    limit[i] = std::min(speed, bend > 1e-9 ? turn_rate / bend : speed) / place.d.norm();
  }
  limit.front() = limit.back() = 0.0;
  for (std::size_t i = 1; i < count; ++i)
    limit[i] = std::min(limit[i], std::sqrt(limit[i - 1] * limit[i - 1] + 2.0 * acceleration * ds));
  for (std::size_t i = count - 1; i-- > 0;)
    limit[i] = std::min(limit[i], std::sqrt(limit[i + 1] * limit[i + 1] + 2.0 * acceleration * ds));

  // Speeds at even times, their means over a moving window (twice: no kinks), and the length as their
  // integral.
  std::vector<double> when(count, 0.0);
  for (std::size_t i = 1; i < count; ++i) when[i] = when[i - 1] + 2.0 * ds / (limit[i - 1] + limit[i]);
  constexpr int kWindow = 13;
  const auto steps = static_cast<std::size_t>(std::ceil(when.back() / kStep)) + 1;
  std::vector<double> v(steps + 2 * kWindow, 0.0);
  for (std::size_t k = 0, i = 0; k < steps; ++k) {
    const double t = kStep * static_cast<double>(k);
    while (i + 2 < count && when[i + 1] <= t) ++i;
    const double share = std::clamp((t - when[i]) / (when[i + 1] - when[i]), 0.0, 1.0);
    v[k + kWindow] = t >= when.back() ? 0.0 : limit[i] + share * (limit[i + 1] - limit[i]);
  }
  for (int round = 0; round < 2; ++round) {
    std::vector<double> mean(v.size(), 0.0);
    for (std::size_t k = 0; k < v.size(); ++k)
      for (int j = -kWindow / 2; j <= kWindow / 2; ++j) {
        const auto at = static_cast<std::ptrdiff_t>(k) + j;
        if (at >= 0 && at < static_cast<std::ptrdiff_t>(v.size()))
          mean[k] += v[static_cast<std::size_t>(at)] / kWindow;
      }
    v = std::move(mean);
  }
  s_.assign(v.size(), 0.0);
  for (std::size_t k = 1; k < v.size(); ++k) s_[k] = s_[k - 1] + 0.5 * kStep * (v[k - 1] + v[k]);
  // Sampling costs a part in a thousand of the way, which all speeds make up for.
  const double scale = path.length() / s_.back();
  for (double& s : s_) s *= scale;
  for (double& speed_now : v) speed_now *= scale;
  v_ = std::move(v);
}

double PathTiming::duration() const { return kStep * static_cast<double>(s_.size() - 1); }

double PathTiming::at(double t) const {
  t = std::clamp(t, 0.0, duration());
  const auto k = std::min(static_cast<std::size_t>(t / kStep), s_.size() - 2);
  const double dt = t - kStep * static_cast<double>(k);
  return s_[k] + dt * (v_[k] + 0.5 * dt / kStep * (v_[k + 1] - v_[k]));
}

SmoothRun::SmoothRun(double whole, double top_speed, double acceleration)
    : speed(top_speed), sign(whole < 0.0 ? -1.0 : 1.0) {
  whole = std::abs(whole);
  // In a short run the top speed is not reached.
  speed = std::min(speed, std::sqrt(whole * acceleration / kSmoothStepSteepest));
  ramp = kSmoothStepSteepest * speed / acceleration;
  duration = speed > 0.0 ? whole / speed + ramp : 0.0;
}

double SmoothRun::at(double t) const {
  if (speed <= 0.0) return 0.0;
  return sign * speed * ramp *
         (smooth_step_integral(t / ramp) - smooth_step_integral((t - duration + ramp) / ramp));
}

}  // namespace sweepkit
