// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdint>

namespace sweepkit {

/// A stamp or a span of time in integer nanoseconds; all sensors of a recording share one clock.
using TimeNs = std::int64_t;

inline constexpr TimeNs kNsPerSecond = 1'000'000'000;

/// Nanoseconds to seconds. Exact to a nanosecond only for spans below about 100 days: subtract stamps first.
constexpr double to_seconds(TimeNs ns) { return static_cast<double>(ns) * 1e-9; }

/// Seconds to nanoseconds, rounded to the nearest.
inline TimeNs from_seconds(double s) { return static_cast<TimeNs>(std::llround(s * 1e9)); }

}  // namespace sweepkit
