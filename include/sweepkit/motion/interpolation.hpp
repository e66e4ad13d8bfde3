// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <type_traits>
#include <vector>

#include "sweepkit/core/time.hpp"

namespace sweepkit {

namespace impl {
template <class Value>
bool all_finite(const Value& value) {
  if constexpr (std::is_arithmetic_v<Value>)
    return std::isfinite(value);
  else
    return value.allFinite();
}
}  // namespace impl

/// What one sensor said, at its own rate and by its own clock, as a function of the common time: the straight
/// lines between its samples. `Value` is a number or an Eigen vector. A sample that is not newer than the
/// last, or not finite, is refused, so that what is kept always runs forward. Not thread-safe.
template <class Value>
class SampleTrack {
 public:
  /// @param offset common time = time of the sensor + offset [ns]
  /// @param max_gap samples farther apart than this leave a hole [ns]
  explicit SampleTrack(TimeNs offset = 0, TimeNs max_gap = kNsPerSecond / 10)
      : offset_(offset), max_gap_(max_gap) {}

  /// False, and nothing kept, for a sample that is not newer than the last or has no finite value.
  bool push(TimeNs sensor_time, const Value& value) {
    const TimeNs t = sensor_time + offset_;
    if (!impl::all_finite(value) || (size() > 0 && t <= times_.back())) return false;
    times_.push_back(t);
    values_.push_back(value);
    return true;
  }

  std::size_t size() const { return times_.size() - first_; }
  bool empty() const { return size() == 0; }
  TimeNs begin_time() const { return times_[first_]; }  ///< common time of the oldest sample; not empty
  TimeNs end_time() const { return times_.back(); }     ///< of the newest; not empty
  TimeNs offset() const { return offset_; }

  /// The value at a common time; nothing outside the samples or in a hole.
  std::optional<Value> at(TimeNs t) const {
    if (empty() || t < begin_time() || t > end_time()) return std::nullopt;
    const std::size_t k = segment(t);
    if (times_[k] == t) return values_[k];
    if (times_[k + 1] - times_[k] > max_gap_ && times_[k + 1] != t) return std::nullopt;
    return on_segment(k, t);
  }

  /// The mean over [from, to], exact for the straight lines; nothing if a part of it lies outside the samples
  /// or in a hole, or if it is empty.
  std::optional<Value> mean(TimeNs from, TimeNs to) const {
    if (to <= from || empty() || from < begin_time() || to > end_time()) return std::nullopt;
    Value sum = values_[first_] * 0.0;
    for (std::size_t k = segment(from); k + 1 < times_.size() && times_[k] < to; ++k) {
      if (times_[k + 1] - times_[k] > max_gap_) return std::nullopt;
      const TimeNs a = std::max(from, times_[k]), b = std::min(to, times_[k + 1]);
      sum += (on_segment(k, a) + on_segment(k, b)) * (0.5 * to_seconds(b - a));
    }
    return Value(sum * (1.0 / to_seconds(to - from)));
  }

  /// Forgets what is not needed at or after a common time.
  void forget_before(TimeNs t) {
    while (size() > 1 && times_[first_ + 1] <= t) ++first_;
    if (first_ > 64 && 2 * first_ > times_.size()) {
      times_.erase(times_.begin(), times_.begin() + static_cast<std::ptrdiff_t>(first_));
      values_.erase(values_.begin(), values_.begin() + static_cast<std::ptrdiff_t>(first_));
      first_ = 0;
    }
  }

 private:
  /// The sample at or before t, which lies within the samples.
  std::size_t segment(TimeNs t) const {
    const auto after =
        std::upper_bound(times_.begin() + static_cast<std::ptrdiff_t>(first_), times_.end(), t);
    return static_cast<std::size_t>(after - times_.begin()) - 1;
  }
  Value on_segment(std::size_t k, TimeNs t) const {
    if (t == times_[k]) return values_[k];
    if (t == times_[k + 1]) return values_[k + 1];
    const double s = to_seconds(t - times_[k]) / to_seconds(times_[k + 1] - times_[k]);
    return Value(values_[k] * (1.0 - s) + values_[k + 1] * s);
  }

  TimeNs offset_;
  TimeNs max_gap_;
  std::vector<TimeNs> times_;
  std::vector<Value> values_;
  std::size_t first_ = 0;
};

}  // namespace sweepkit
