// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <optional>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/sample.hpp"

namespace sweepkit {

struct WheelDecoderOptions {
  double max_speed = 3.0;
  double max_gap = 0.1;
  double counter_range = 0.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(max_speed, "max_speed", "m/s", range(0.01, 1e3),
      "no wheel rolls faster; what looks faster is a counter that began anew");
    v(max_gap, "max_gap", "s", range(1e-3, 1e3), "samples farther apart than this are a hole");
    v(counter_range, "counter_range", "ticks", range(0.0, 1e18),
      "a counter wraps around after that many; 0: 2^16 and 2^32 are tried");
  }
};

/// How far the wheels rolled between two samples, by their nominal radius.
struct WheelStep {
  TimeNs begin = 0;
  TimeNs end = 0;
  double left = 0.0;   ///< [m]
  double right = 0.0;  ///< [m]
  /// False where nothing is known of it: the counters were reset, or speeds were silent for longer than
  /// max_gap. The distances are those of the speed before then, for max_gap at most.
  bool measured = true;

  double seconds() const { return to_seconds(end - begin); }
};

/// Turns wheel samples into distances. Samples that are not newer than the last, or not finite, are refused.
/// A counter that wraps around goes on; one that is reset leaves a step that is not measured. Not
/// thread-safe.
class WheelDecoder {
 public:
  explicit WheelDecoder(const WheelGeometry& geometry, const WheelDecoderOptions& options = {})
      : geometry_(geometry), options_(options) {
    require(std::isfinite(geometry.metres_per_tick()) && geometry.metres_per_tick() > 0,
            "WheelDecoder geometry", "must have a positive distance for a tick", geometry.metres_per_tick());
  }

  /// The step that ends with this sample; nothing for the first one and for refused ones.
  std::optional<WheelStep> push(const WheelSample& sample) {
    if (!std::isfinite(sample.left) || !std::isfinite(sample.right) || (has_last_ && sample.t <= last_.t)) {
      ++refused_;
      return std::nullopt;
    }
    if (!has_last_ || sample.reading != last_.reading) {
      last_ = sample;
      has_last_ = true;
      return std::nullopt;
    }
    WheelStep step{.begin = last_.t, .end = sample.t};
    const double dt = step.seconds();
    if (sample.reading == WheelReading::speeds) {
      step.measured = dt <= options_.max_gap && std::abs(sample.left) <= options_.max_speed &&
                      std::abs(sample.right) <= options_.max_speed;
      step.left = sample.left * dt;
      step.right = sample.right * dt;
    } else {
      const auto left = ticks_between(last_.left, sample.left, dt);
      const auto right = ticks_between(last_.right, sample.right, dt);
      step.measured = left && right;
      if (step.measured) {
        step.left = *left * geometry_.metres_per_tick();
        step.right = *right * geometry_.metres_per_tick();
      } else {
        ++resets_;
      }
    }
    if (!step.measured) {
      const double held = std::min(dt, options_.max_gap);
      step.left = left_speed_ * held;
      step.right = right_speed_ * held;
    } else {
      left_speed_ = step.left / dt;
      right_speed_ = step.right / dt;
    }
    last_ = sample;
    return step;
  }

  std::size_t refused() const { return refused_; }  ///< samples that were not taken
  std::size_t wraps() const { return wraps_; }      ///< times that a counter wrapped around
  std::size_t resets() const { return resets_; }    ///< times that the counters jumped

 private:
  std::optional<double> ticks_between(double before, double after, double dt) {
    const double most = options_.max_speed * dt / geometry_.metres_per_tick();
    const double difference = after - before;
    if (std::abs(difference) <= most) return difference;
    // A wrap takes the counter across the end of its range: from there on the difference is small again.
    const std::array<double, 2> ranges = options_.counter_range > 0
                                             ? std::array{options_.counter_range, options_.counter_range}
                                             : std::array{0x1p16, 0x1p32};
    for (const double range : ranges) {
      // A counter that wraps within dt cannot be told from another one if it could pass half its range.
      if (most >= 0.5 * range) continue;
      const double wrapped = difference - std::copysign(range, difference);
      if (std::abs(wrapped) <= most) {
        ++wraps_;
        return wrapped;
      }
    }
    return std::nullopt;
  }

  WheelGeometry geometry_;
  WheelDecoderOptions options_;
  WheelSample last_;
  bool has_last_ = false;
  double left_speed_ = 0.0, right_speed_ = 0.0;
  std::size_t refused_ = 0, wraps_ = 0, resets_ = 0;
};

}  // namespace sweepkit
