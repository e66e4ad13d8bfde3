// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "text_file.hpp"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>

namespace sweepkit {
namespace {

constexpr std::size_t kMaxLine = 1 << 16;

bool is_space(char c) { return c == ' ' || c == '\t' || c == '\r'; }

std::string_view trim(std::string_view text) {
  while (!text.empty() && is_space(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_space(text.back())) text.remove_suffix(1);
  return text;
}

}  // namespace

TextFile::TextFile(std::filesystem::path file) : file_(std::move(file)) {
  if (std::filesystem::is_directory(file_))
    throw Error(ErrorKind::io, file_.string(), "is a folder, not a file");
  stream_.reset(std::fopen(file_.c_str(), "rb"));
  if (!stream_)
    throw Error(ErrorKind::io, file_.string(), std::string("cannot be opened: ") + std::strerror(errno));
}

bool TextFile::next_line() {
  line_.clear();
  int c = getc_unlocked(stream_.get());
  if (c == EOF) {
    if (std::ferror(stream_.get())) throw Error(ErrorKind::io, place(), "cannot be read on");
    return false;
  }
  ++number_;
  for (; c != EOF && c != '\n'; c = getc_unlocked(stream_.get())) {
    if (line_.size() == kMaxLine) throw error("the line is too long: is this a text file?");
    line_ += static_cast<char>(c);
  }
  return true;
}

bool TextFile::next_data() {
  while (next_line()) {
    const std::string_view text = trim(line_);
    if (!text.empty() && text.front() != '#') return true;
  }
  return false;
}

const std::vector<std::string_view>& TextFile::fields(std::size_t at_least) {
  fields_.clear();
  const std::string_view text = trim(line_);
  if (text.find(',') != std::string_view::npos) {
    for (std::size_t at = 0; at <= text.size();) {
      const std::size_t end = std::min(text.find(',', at), text.size());
      fields_.push_back(trim(text.substr(at, end - at)));
      at = end + 1;
    }
    // A comma at the end of the line is a habit of some writers, not a field.
    if (fields_.back().empty()) fields_.pop_back();
  } else {
    for (std::size_t at = 0; at < text.size();) {
      std::size_t end = at;
      while (end < text.size() && !is_space(text[end])) ++end;
      fields_.push_back(text.substr(at, end - at));
      while (end < text.size() && is_space(text[end])) ++end;
      at = end;
    }
  }
  if (fields_.size() < at_least)
    throw error("needs " + std::to_string(at_least) + " columns, has " + std::to_string(fields_.size()),
                text.substr(0, 80));
  return fields_;
}

double TextFile::number_of(std::string_view field) const {
  double value = 0.0;
  std::string_view digits = field;
  if (!digits.empty() && digits.front() == '+') digits.remove_prefix(1);
  const auto result = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  if (result.ec != std::errc() || result.ptr != digits.data() + digits.size() || !std::isfinite(value))
    throw error("is not a finite number", field.empty() ? "nothing" : field);
  return value;
}

TimeNs TextFile::stamp_ns_of(std::string_view field) const {
  TimeNs t = 0;
  const auto result = std::from_chars(field.data(), field.data() + field.size(), t);
  if (result.ec != std::errc() || result.ptr != field.data() + field.size() || t < 0)
    throw error("is not a stamp in whole nanoseconds", field.empty() ? "nothing" : field);
  return t;
}

TimeNs TextFile::stamp_s_of(std::string_view field) const {
  const std::size_t dot = field.find('.');
  if (field.find_first_not_of("0123456789.") == std::string_view::npos && dot != std::string_view::npos &&
      dot > 0 && dot <= 9 + 1 && field.find('.', dot + 1) == std::string_view::npos) {
    // By digits: a double of seconds since 1970 is good to 0.2 microseconds only.
    TimeNs t = 0;
    std::from_chars(field.data(), field.data() + dot, t);
    std::string_view fraction = field.substr(dot + 1);
    const bool up = fraction.size() > 9 && fraction[9] >= '5';
    for (std::size_t i = 0; i < 9; ++i) t = 10 * t + (i < fraction.size() ? fraction[i] - '0' : 0);
    return t + (up ? 1 : 0);
  }
  const double seconds = number_of(field);
  if (std::abs(seconds) > 9e9) throw error("is not a stamp in seconds", field);
  return from_seconds(seconds);
}

void TextFile::check_order(TimeNs t) {
  if (has_last_ && t <= last_)
    throw error("time goes backwards: the stamp before is " + std::to_string(last_) + " ns",
                std::to_string(t) + " ns");
  has_last_ = true;
  last_ = t;
}

}  // namespace sweepkit
