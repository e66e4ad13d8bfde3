// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

namespace sweepkit {

/// What went wrong, coarse enough to choose an exit code or a Python exception by.
enum class ErrorKind {
  argument,     ///< a call with a wrong value: the caller's mistake (ValueError in Python)
  option,       ///< an option that does not exist or is out of its range (exit code 2)
  calibration,  ///< a camera, rig or sensor description that cannot be (exit code 3)
  data,         ///< a file whose content is wrong (exit code 3)
  io,           ///< a file that cannot be opened, read or written (exit code 3)
};

/// The name of a kind, as messages and Python use it.
constexpr std::string_view to_string(ErrorKind kind) {
  switch (kind) {
    case ErrorKind::argument:
      return "argument";
    case ErrorKind::option:
      return "option";
    case ErrorKind::calibration:
      return "calibration";
    case ErrorKind::data:
      return "data";
    case ErrorKind::io:
      return "io";
  }
  return "unknown";
}

/// The one exception of the toolkit. what() reads "place: message (got value)".
class Error : public std::runtime_error {
 public:
  /// @param place where: "file:line", "file", an option's path or a function's parameter; may be empty
  /// @param value the offending value as text; may be empty
  Error(ErrorKind kind, std::string place, std::string_view message, std::string value = {})
      : std::runtime_error(compose(place, message, value)),
        kind_(kind),
        place_(std::move(place)),
        value_(std::move(value)) {}

  ErrorKind kind() const noexcept { return kind_; }
  const std::string& place() const noexcept { return place_; }
  const std::string& value() const noexcept { return value_; }

 private:
  static std::string compose(const std::string& place, std::string_view message, const std::string& value) {
    std::string text = place.empty() ? std::string() : place + ": ";
    text += message;
    if (!value.empty()) text += " (got " + value + ")";
    return text;
  }

  ErrorKind kind_;
  std::string place_;
  std::string value_;
};

/// Throws an argument error unless the condition holds; `place` names the function and parameter.
template <class Value>
inline void require(bool condition, std::string_view place, std::string_view message, const Value& value) {
  if (condition) [[likely]]
    return;
  std::ostringstream text;
  text << value;
  throw Error(ErrorKind::argument, std::string(place), message, text.str());
}

}  // namespace sweepkit
