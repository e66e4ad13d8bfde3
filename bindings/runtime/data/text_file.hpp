// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/time.hpp"

namespace sweepkit {

/// A text file read line by line, whose errors name file and line. A line may have 64 KiB.
class TextFile {
 public:
  /// @throws Error(io) if it cannot be opened
  explicit TextFile(std::filesystem::path file);

  /// Steps to the next line that is neither blank nor a comment (#); false at the end.
  bool next_data();
  /// Steps to the next line, whatever it is; false at the end.
  bool next_line();

  const std::filesystem::path& file() const { return file_; }
  const std::string& line() const { return line_; }
  int number() const { return number_; }
  std::string place() const { return place(number_); }
  std::string place(int number) const { return file_.string() + ":" + std::to_string(number); }

  /// Splits the line at commas, or at white space if it has none; fields are trimmed and valid until the next
  /// step.
  /// @throws Error(data) if there are fewer than `at_least`
  const std::vector<std::string_view>& fields(std::size_t at_least);

  /// @throws Error(data) unless the field is one whole finite number
  double number_of(std::string_view field) const;
  /// Integer nanoseconds. @throws Error(data)
  TimeNs stamp_ns_of(std::string_view field) const;
  /// Decimal seconds, exact to the nanosecond (rounded). @throws Error(data)
  TimeNs stamp_s_of(std::string_view field) const;

  /// @throws Error(data) unless t is after the stamp of the last call
  void check_order(TimeNs t);

  Error error(std::string_view message, std::string_view value = {}) const {
    return Error(ErrorKind::data, place(), message, std::string(value));
  }

 private:
  struct Closer {
    void operator()(std::FILE* stream) const { std::fclose(stream); }
  };

  std::filesystem::path file_;
  std::unique_ptr<std::FILE, Closer> stream_;
  std::string line_;
  std::vector<std::string_view> fields_;
  int number_ = 0;
  bool has_last_ = false;
  TimeNs last_ = 0;
};

}  // namespace sweepkit
