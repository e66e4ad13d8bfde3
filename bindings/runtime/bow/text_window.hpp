// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <zlib.h>

#include <charconv>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "sweepkit/core/error.hpp"

namespace sweepkit::impl {

/// A text file, plain or of gzip, seen through a window that slides on: memory does not depend on the
/// file's length.
class TextWindow {
 public:
  /// What is asked for at once is at most so long: a line, or a node.
  static constexpr std::size_t kReach = 1u << 16;

  explicit TextWindow(const std::string& path) : path_(path), buffer_(kCapacity) {
    file_.reset(gzopen(path.c_str(), "rb"));
    if (!file_) throw Error(ErrorKind::io, path, "cannot be opened");
    gzbuffer(file_.get(), 1u << 17);
    refill();
  }
  TextWindow(const TextWindow&) = delete;
  TextWindow& operator=(const TextWindow&) = delete;

  const std::string& path() const { return path_; }
  int line() const { return line_; }
  [[noreturn]] void fail(std::string_view what, std::string_view value = {}) const {
    throw Error(ErrorKind::data, path_ + ":" + std::to_string(line_), what, std::string(value.substr(0, 40)));
  }

  bool at_end() {
    if (p_ == end_) refill();
    return p_ == end_;
  }
  /// The next character; 0 at the end.
  char peek() { return at_end() ? '\0' : *p_; }
  void advance() {
    line_ += *p_ == '\n';
    ++p_;
  }
  /// Takes the rest of the line, without its end.
  std::string_view take_line() {
    ensure();
    const auto* stop = static_cast<const char*>(std::memchr(p_, '\n', static_cast<std::size_t>(end_ - p_)));
    if (!stop && end_ - p_ >= static_cast<std::ptrdiff_t>(kReach)) fail("the line is too long");
    const char* begin = p_;
    p_ = stop ? stop + 1 : end_;
    std::string_view text(begin, static_cast<std::size_t>((stop ? stop : end_) - begin));
    if (!text.empty() && text.back() == '\r') text.remove_suffix(1);
    line_ += stop != nullptr;
    return text;
  }
  void skip_space() {
    for (;;) {
      if (p_ == end_) refill();
      if (p_ == end_) return;
      if (*p_ != ' ' && *p_ != '\n' && *p_ != '\t' && *p_ != '\r') return;
      line_ += *p_ == '\n';
      ++p_;
    }
  }
  /// After spaces: takes the character if it is next.
  bool take(char c) {
    skip_space();
    if (p_ == end_ || *p_ != c) return false;
    ++p_;
    return true;
  }
  void expect(char c) {
    if (!take(c))
      fail(std::string("expected '") + c + "'", at_end() ? "end of file" : std::string_view(p_, 1));
  }
  /// A name of letters, digits and '_'; empty if there is none.
  std::string_view take_name() {
    skip_space();
    ensure();
    const char* begin = p_;
    while (p_ != end_ && (is_letter(*p_) || (*p_ >= '0' && *p_ <= '9'))) ++p_;
    return {begin, static_cast<std::size_t>(p_ - begin)};
  }
  /// A number after spaces.
  template <class Number>
  Number take_number() {
    skip_space();
    ensure();
    Number number{};
    const auto [stop, error] = std::from_chars(p_, end_, number);
    if (error != std::errc())
      fail("expected a number", std::string_view(p_, static_cast<std::size_t>(end_ - p_)));
    p_ = stop;
    return number;
  }
  /// A text in quotes. Valid until the next call.
  std::string_view take_quoted() {
    skip_space();
    ensure();
    if (p_ == end_ || (*p_ != '"' && *p_ != '\'')) fail("expected a text in quotes");
    const char quote = *p_;
    const auto* stop =
        static_cast<const char*>(std::memchr(p_ + 1, quote, static_cast<std::size_t>(end_ - p_ - 1)));
    if (!stop) fail("a text in quotes does not end");
    const std::string_view text(p_ + 1, static_cast<std::size_t>(stop - p_ - 1));
    p_ = stop + 1;
    return text;
  }

 private:
  struct Close {
    void operator()(gzFile_s* file) const { gzclose_r(file); }
  };
  static constexpr std::size_t kCapacity = 4 * kReach;

  static bool is_letter(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_'; }

  /// Makes kReach characters visible, or all that are left.
  void ensure() {
    if (end_ - p_ < static_cast<std::ptrdiff_t>(kReach) && !done_) refill();
  }
  void refill() {
    if (done_) return;
    const auto kept = static_cast<std::size_t>(end_ - p_);
    if (kept > 0) std::memmove(buffer_.data(), p_, kept);
    p_ = buffer_.data();
    const int got = gzread(file_.get(), buffer_.data() + kept, static_cast<unsigned>(kCapacity - kept));
    int code = Z_OK;
    const char* message = gzerror(file_.get(), &code);
    if (got < 0 || (code != Z_OK && code != Z_STREAM_END))
      throw Error(ErrorKind::data, path_, "cannot be read or is damaged", message ? message : "");
    end_ = p_ + kept + got;
    done_ = got == 0;
  }

  std::string path_;
  std::unique_ptr<gzFile_s, Close> file_;
  std::vector<char> buffer_;
  const char* p_ = nullptr;
  const char* end_ = nullptr;
  bool done_ = false;
  int line_ = 1;
};

}  // namespace sweepkit::impl
