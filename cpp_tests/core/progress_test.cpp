// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/core/progress.hpp"

#include <catch2/catch.hpp>

using namespace sweepkit;
using namespace std::chrono_literals;

namespace {

struct Recorded {
  std::FILE* stream = std::tmpfile();
  ~Recorded() { std::fclose(stream); }
  std::string text() const {
    std::rewind(stream);
    std::string content;
    for (int c = std::fgetc(stream); c != EOF; c = std::fgetc(stream)) content += static_cast<char>(c);
    return content;
  }
};

}  // namespace

TEST_CASE("away from a terminal a line comes every 10 s, with rate and time left") {
  Recorded recorded;
  const Progress::Clock::time_point begin{};
  Progress progress(recorded.stream, "job", 100, "frames", false, true, begin);
  for (int i = 1; i <= 25; ++i) progress.update(i, i == 20 ? "lost" : "", begin + i * 1s);
  progress.finish(begin + 25s);
  CHECK(recorded.text() ==
        "job  10/100 frames  10 %  1.0/s  left 1:30\n"
        "job  20/100 frames  20 %  1.0/s  left 1:20  lost\n"
        "job  25/100 frames  25 %  1.0/s  left 1:15\n");
}

TEST_CASE("on a terminal one line is written again and again") {
  for (const bool color : {false, true}) {
    Recorded recorded;
    const Progress::Clock::time_point begin{};
    Progress progress(recorded.stream, "job", 0, "frames", true, color, begin);
    progress.update(1, "", begin + 50ms);  // too soon
    progress.update(2, "", begin + 200ms);
    progress.finish(begin + 4000s);
    const std::string job = color ? "\x1b[1mjob\x1b[0m" : "job";
    CHECK(recorded.text() == "\r" + job + "  2 frames  10.0/s  took 0:00\x1b[K\r" + job +
                                 "  2 frames  0.0/s  took 1:06:40\x1b[K\n");
  }
}

TEST_CASE("a job that never began says nothing") {
  Recorded recorded;
  Progress(recorded.stream, "job", 5, "frames", true, true, {}).finish();
  CHECK(recorded.text().empty());
}
