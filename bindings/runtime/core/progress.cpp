// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/core/progress.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <cstdlib>

namespace sweepkit {
namespace {

std::string duration_text(double seconds) {
  const auto whole = static_cast<long>(seconds + 0.5);
  if (whole >= 3600) return fmt::format("{}:{:02d}:{:02d}", whole / 3600, whole / 60 % 60, whole % 60);
  return fmt::format("{}:{:02d}", whole / 60, whole % 60);
}

bool color_wanted() {
  const char* no_color = std::getenv("NO_COLOR");
  return no_color == nullptr || *no_color == '\0';
}

}  // namespace

Progress::Progress(std::FILE* stream, std::string job, std::int64_t total, std::string unit)
    : Progress(stream, std::move(job), total, std::move(unit), isatty(fileno(stream)) == 1, color_wanted(),
               Clock::now()) {}

Progress::Progress(std::FILE* stream, std::string job, std::int64_t total, std::string unit, bool terminal,
                   bool color, Clock::time_point begin)
    : stream_(stream),
      job_(std::move(job)),
      total_(total),
      unit_(std::move(unit)),
      terminal_(terminal),
      color_(terminal && color),
      begin_(begin),
      last_(begin) {}

void Progress::update(std::int64_t done, const std::string& note, Clock::time_point now) {
  done_ = done;
  note_ = note;
  const auto pause = terminal_ ? std::chrono::milliseconds(100) : std::chrono::milliseconds(10000);
  if (now - last_ < pause) return;
  last_ = now;
  write(now);
}

void Progress::finish(Clock::time_point now) {
  if (done_ < 0) return;
  write(now);
  if (terminal_) std::fputc('\n', stream_);
  std::fflush(stream_);
  done_ = -1;
}

void Progress::write(Clock::time_point now) {
  const double elapsed = std::chrono::duration<double>(now - begin_).count();
  const double rate = elapsed > 0 ? static_cast<double>(done_) / elapsed : 0.0;
  std::string line = color_ ? "\x1b[1m" + job_ + "\x1b[0m" : job_;
  if (total_ > 0)
    line += fmt::format("  {}/{} {}  {:.0f} %", done_, total_, unit_,
                        100.0 * static_cast<double>(done_) / static_cast<double>(total_));
  else
    line += fmt::format("  {} {}", done_, unit_);
  line += fmt::format("  {:.1f}/s", rate);
  if (total_ > done_ && rate > 0)
    line += "  left " + duration_text(static_cast<double>(total_ - done_) / rate);
  else
    line += "  took " + duration_text(elapsed);
  if (!note_.empty()) line += "  " + note_;
  if (terminal_)
    fmt::print(stream_, "\r{}\x1b[K", line);
  else
    fmt::print(stream_, "{}\n", line);
  std::fflush(stream_);
}

}  // namespace sweepkit
