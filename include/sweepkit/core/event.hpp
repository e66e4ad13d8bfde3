// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <concepts>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "sweepkit/core/time.hpp"

namespace sweepkit {

using EventValue = std::variant<bool, std::int64_t, double, std::string>;

/// Something that happened, with fields of its own: `Event(t, "lost").with("points", 7)`.
struct Event {
  TimeNs t = 0;
  std::string name;  ///< `started`, `lost`, ...: the key "event" of its line
  std::vector<std::pair<std::string, EventValue>> fields;

  Event() = default;
  Event(TimeNs t, std::string_view name) : t(t), name(name) {}

  template <class Value>
  Event&& with(std::string_view key, const Value& value) && {
    add(key, value);
    return std::move(*this);
  }
  template <class Value>
  Event& with(std::string_view key, const Value& value) & {
    add(key, value);
    return *this;
  }

 private:
  template <class Value>
  void add(std::string_view key, const Value& value) {
    if constexpr (std::same_as<Value, bool>)
      fields.emplace_back(key, EventValue(std::in_place_type<bool>, value));
    else if constexpr (std::integral<Value>)
      fields.emplace_back(key,
                          EventValue(std::in_place_type<std::int64_t>, static_cast<std::int64_t>(value)));
    else if constexpr (std::floating_point<Value>)
      fields.emplace_back(key, EventValue(std::in_place_type<double>, static_cast<double>(value)));
    else
      fields.emplace_back(key, EventValue(std::in_place_type<std::string>, value));
  }
};

/// One JSON object without a line end: "t" in seconds with 9 decimals, "event", then the fields in order. A
/// number that is not finite becomes null; text that is not UTF-8 loses the bytes that are not.
std::string to_json(const Event& event);

/// Who wants to hear of events. Called from any thread.
class EventSink {
 public:
  virtual ~EventSink() = default;
  virtual void on_event(const Event& event) = 0;
};

/// Writes events to a file, one JSON object a line, each at once so that a crash loses none. Thread-safe.
class EventLog : public EventSink {
 public:
  /// @throws Error(io) if the file cannot be made
  explicit EventLog(std::filesystem::path file);
  ~EventLog() override;
  EventLog(const EventLog&) = delete;
  EventLog& operator=(const EventLog&) = delete;

  /// @throws Error(io) if it cannot be written
  void on_event(const Event& event) override;

 private:
  std::filesystem::path file_;
  std::FILE* stream_;
  std::mutex mutex_;
};

}  // namespace sweepkit
