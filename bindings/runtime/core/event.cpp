// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/core/event.hpp"

#include <fmt/format.h>

#include <cerrno>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/options.hpp"

namespace sweepkit {
namespace {

std::string json_string(const std::string& text) {
  return nlohmann::json(text).dump(-1, ' ', false, nlohmann::json::error_handler_t::ignore);
}

}  // namespace

std::string to_json(const Event& event) {
  const std::uint64_t magnitude =
      event.t < 0 ? 0 - static_cast<std::uint64_t>(event.t) : static_cast<std::uint64_t>(event.t);
  std::string line = fmt::format(R"({{"t": {}{}.{:09d}, "event": {})", event.t < 0 ? "-" : "",
                                 magnitude / kNsPerSecond, magnitude % kNsPerSecond, json_string(event.name));
  for (const auto& [key, value] : event.fields) {
    line += ", " + json_string(key) + ": ";
    if (const auto* flag = std::get_if<bool>(&value))
      line += *flag ? "true" : "false";
    else if (const auto* integer = std::get_if<std::int64_t>(&value))
      line += std::to_string(*integer);
    else if (const auto* number = std::get_if<double>(&value))
      line += std::isfinite(*number) ? number_text(*number) : "null";
    else
      line += json_string(std::get<std::string>(value));
  }
  return line + "}";
}

EventLog::EventLog(std::filesystem::path file)
    : file_(std::move(file)), stream_(std::fopen(file_.c_str(), "wb")) {
  if (!stream_)
    throw Error(ErrorKind::io, file_.string(), std::string("cannot be written: ") + std::strerror(errno));
}

EventLog::~EventLog() { std::fclose(stream_); }

void EventLog::on_event(const Event& event) {
  const std::string line = to_json(event) + "\n";
  const std::scoped_lock lock(mutex_);
  if (std::fwrite(line.data(), 1, line.size(), stream_) != line.size() || std::fflush(stream_) != 0)
    throw Error(ErrorKind::io, file_.string(), std::string("cannot be written: ") + std::strerror(errno));
}

}  // namespace sweepkit
