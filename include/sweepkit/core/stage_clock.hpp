// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <string_view>

namespace sweepkit {

/// The stages whose times are kept. `frame` is all of the frame path without `read`.
enum class Stage {
  read,
  extract,
  stereo,
  track,
  frame,
  local_ba,
  bias,
  place,
  loop,
  lines,
  obstacles,
  objects,
  grid
};

inline constexpr std::array<std::string_view, 13> kStageNames = {
    "read",  "extract", "stereo", "track",     "frame",   "local_ba", "bias",
    "place", "loop",    "lines",  "obstacles", "objects", "grid"};

constexpr std::string_view to_string(Stage stage) { return kStageNames[static_cast<std::size_t>(stage)]; }

/// What was measured of a stage. Median and 95th percentile are good to 0.6 %, the maximum is exact.
struct StageTimes {
  double median_ms = 0.0;
  double p95_ms = 0.0;
  double max_ms = 0.0;
  std::int64_t count = 0;
};

/// Gathers times by stage in histograms whose bins grow by 2^(1/64): memory and work do not grow with the
/// length of the run. Thread-safe; a measurement costs two readings of the clock and a lock (under 0.1 us).
class StageClock {
 public:
  /// Measures from its making to its end.
  class Scope {
   public:
    Scope(StageClock& clock, Stage stage)
        : clock_(clock), stage_(stage), begin_(std::chrono::steady_clock::now()) {}
    ~Scope() {
      const std::chrono::duration<double, std::milli> elapsed = std::chrono::steady_clock::now() - begin_;
      clock_.add(stage_, elapsed.count());
    }
    Scope(const Scope&) = delete;
    Scope& operator=(const Scope&) = delete;

   private:
    StageClock& clock_;
    Stage stage_;
    std::chrono::steady_clock::time_point begin_;
  };

  /// `const auto scope = clock.time(Stage::extract);`
  [[nodiscard]] Scope time(Stage stage) { return Scope(*this, stage); }

  /// Adds a duration measured elsewhere [ms].
  void add(Stage stage, double ms) {
    const double octave = std::log2(std::max(ms, kShortest) / kShortest);
    const auto bin = std::min(static_cast<std::size_t>(octave * kBinsPerOctave), kBins - 1);
    const std::scoped_lock lock(mutex_);
    Histogram& histogram = histograms_[static_cast<std::size_t>(stage)];
    ++histogram.bins[bin];
    ++histogram.count;
    histogram.min_ms = std::min(histogram.min_ms, ms);
    histogram.max_ms = std::max(histogram.max_ms, ms);
  }

  /// Zero count for a stage that never ran.
  StageTimes times(Stage stage) const {
    const std::scoped_lock lock(mutex_);
    const Histogram& histogram = histograms_[static_cast<std::size_t>(stage)];
    if (histogram.count == 0) return {};
    return {histogram.quantile(0.5), histogram.quantile(0.95), histogram.max_ms, histogram.count};
  }

 private:
  static constexpr double kShortest = 1e-4;  // [ms]
  static constexpr double kBinsPerOctave = 64.0;
  static constexpr std::size_t kBins = 64 * 32;  // up to 2^32 * 0.1 us = 7 minutes

  struct Histogram {
    std::array<std::uint32_t, kBins> bins{};
    std::int64_t count = 0;
    double min_ms = 1e300;
    double max_ms = 0.0;

    double quantile(double share) const {
      const double rank = share * static_cast<double>(count - 1);
      std::int64_t before = 0;
      for (std::size_t bin = 0; bin < kBins; ++bin) {
        before += bins[bin];
        if (static_cast<double>(before) > rank) {
          const double middle = kShortest * std::exp2((static_cast<double>(bin) + 0.5) / kBinsPerOctave);
          return std::clamp(middle, min_ms, max_ms);
        }
      }
      return max_ms;
    }
  };

  mutable std::mutex mutex_;
  std::array<Histogram, kStageNames.size()> histograms_{};
};

}  // namespace sweepkit
