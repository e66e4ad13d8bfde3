// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/core/event.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "scratch_folder.hpp"
#include "sweepkit/core/error.hpp"

using namespace sweepkit;

TEST_CASE("an event is one line of JSON with its time to the nanosecond and its fields in order") {
  const Event event = Event(1403715273262142976, "lost")
                          .with("points", 7)
                          .with("share", 0.25)
                          .with("first", true)
                          .with("why", "a \"b\"\n\xff")
                          .with("bad", std::nan(""));
  CHECK(to_json(event) ==
        R"({"t": 1403715273.262142976, "event": "lost", "points": 7, "share": 0.25, "first": true, )"
        R"("why": "a \"b\"\n", "bad": null})");
  CHECK(to_json(Event(-1, "x")) == R"({"t": -0.000000001, "event": "x"})");
  CHECK(to_json(Event(0, "x")) == R"({"t": 0.000000000, "event": "x"})");
}

TEST_CASE("the log has a line for each event, whole, from whatever thread") {
  const ScratchFolder folder;
  {
    EventLog log(folder / "events.jsonl");
    std::vector<std::jthread> threads;
    for (int i = 0; i < 4; ++i)
      threads.emplace_back([&log, i] {
        for (int k = 0; k < 100; ++k) log.on_event(Event(k, "overload").with("thread", i).with("k", k));
      });
  }
  std::ifstream file(folder / "events.jsonl");
  std::string line;
  int lines = 0, next[4] = {};
  while (std::getline(file, line)) {
    const auto json = nlohmann::json::parse(line);
    CHECK(json["event"] == "overload");
    CHECK(json["k"] == next[json["thread"].get<int>()]++);
    ++lines;
  }
  CHECK(lines == 400);
  CHECK_THROWS_AS(EventLog("/nowhere/events.jsonl"), Error);
}
