// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <string>

namespace sweepkit {

/// Tells people how far a long job is. On a terminal one line is rewritten ten times a second, else a line is
/// written every 10 s. The stream is given by the program (stderr); colour is left out where NO_COLOR is set.
class Progress {
 public:
  using Clock = std::chrono::steady_clock;

  /// @param total number of steps; 0 if unknown
  /// @param unit what is counted, "frames"
  Progress(std::FILE* stream, std::string job, std::int64_t total, std::string unit);
  /// For tests: neither the stream nor the environment is asked.
  Progress(std::FILE* stream, std::string job, std::int64_t total, std::string unit, bool terminal,
           bool color, Clock::time_point begin);

  /// @param done steps that are done
  /// @param note a few words that stand at the end of the line, "lost"
  void update(std::int64_t done, const std::string& note = {}, Clock::time_point now = Clock::now());
  /// Writes the last state and ends the line. Nothing is written if there never was an update.
  void finish(Clock::time_point now = Clock::now());

 private:
  void write(Clock::time_point now);

  std::FILE* stream_;
  std::string job_;
  std::int64_t total_;
  std::string unit_;
  bool terminal_;
  bool color_;
  Clock::time_point begin_;
  Clock::time_point last_;
  std::int64_t done_ = -1;
  std::string note_;
};

}  // namespace sweepkit
