// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <mutex>
#include <string>
#include <vector>

#include "sweepkit/core/event.hpp"

namespace sweepkit {

/// Keeps all events.
class EventRecord : public EventSink {
 public:
  void on_event(const Event& event) override {
    const std::scoped_lock lock(mutex_);
    events_.push_back(event);
  }
  std::vector<Event> all() const {
    const std::scoped_lock lock(mutex_);
    return events_;
  }
  std::vector<Event> named(const std::string& name) const {
    std::vector<Event> chosen;
    for (const Event& event : all())
      if (event.name == name) chosen.push_back(event);
    return chosen;
  }
  /// All as lines of events.jsonl.
  std::string text() const {
    std::string lines;
    for (const Event& event : all()) lines += to_json(event) + "\n";
    return lines;
  }

 private:
  mutable std::mutex mutex_;
  std::vector<Event> events_;
};

}  // namespace sweepkit
