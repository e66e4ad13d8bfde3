// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/motion/interpolation.hpp"

#include <catch2/catch.hpp>
#include <limits>

#include "sweepkit/core/random.hpp"

using namespace sweepkit;

TEST_CASE("a track gives straight lines back, at the common time", "[motion][interpolation]") {
  SampleTrack<Eigen::Vector3d> track(-5'000'000);
  const Eigen::Vector3d a(1, 2, 3), b(-4, 0, 0.5);
  Random random(1);
  TimeNs t = 0;
  for (int i = 0; i < 100; ++i) {
    CHECK(track.push(t, a + b * to_seconds(t - 5'000'000)));
    t += 1 + static_cast<TimeNs>(random.index(90'000'000));
  }
  for (int i = 0; i < 200; ++i) {
    const auto span = static_cast<std::uint64_t>(track.end_time() - track.begin_time());
    TimeNs from = track.begin_time() + static_cast<TimeNs>(random.index(span));
    TimeNs to = track.begin_time() + static_cast<TimeNs>(random.index(span));
    CHECK((track.at(from).value() - (a + b * to_seconds(from))).norm() < 1e-12);
    if (from > to) std::swap(from, to);
    if (from == to) continue;
    CHECK((track.mean(from, to).value() - (a + b * (0.5 * to_seconds(from) + 0.5 * to_seconds(to)))).norm() <
          1e-11);
  }
  CHECK_FALSE(track.at(track.begin_time() - 1));
  CHECK_FALSE(track.at(track.end_time() + 1));
  CHECK_FALSE(track.mean(track.begin_time(), track.end_time() + 1));
  CHECK_FALSE(track.mean(track.end_time(), track.begin_time()));
}

TEST_CASE("means add up", "[motion][interpolation]") {
  SampleTrack<double> track;
  Random random(2);
  for (int i = 0; i < 50; ++i) track.push(i * 10'000'000, random.normal());
  for (int i = 0; i < 100; ++i) {
    TimeNs t[3];
    for (auto& x : t) x = static_cast<TimeNs>(random.index(490'000'000));
    std::sort(t, t + 3);
    if (t[0] == t[1] || t[1] == t[2]) continue;
    const double whole = track.mean(t[0], t[2]).value() * to_seconds(t[2] - t[0]);
    const double parts = track.mean(t[0], t[1]).value() * to_seconds(t[1] - t[0]) +
                         track.mean(t[1], t[2]).value() * to_seconds(t[2] - t[1]);
    CHECK(whole == Approx(parts).margin(1e-14));
  }
}

TEST_CASE("a track refuses what is not newer or not finite, and knows holes", "[motion][interpolation]") {
  SampleTrack<double> track(0, 100);
  CHECK_FALSE(track.at(0));
  CHECK(track.push(0, 1));
  CHECK_FALSE(track.push(0, 2));
  CHECK_FALSE(track.push(-5, 2));
  CHECK_FALSE(track.push(10, std::numeric_limits<double>::quiet_NaN()));
  CHECK_FALSE(track.push(10, std::numeric_limits<double>::infinity()));
  CHECK(track.push(100, 3));
  CHECK(track.push(300, 5));
  CHECK(track.size() == 3);
  CHECK(track.at(0) == 1.0);
  CHECK(track.at(50) == 2.0);
  CHECK(track.at(100) == 3.0);
  CHECK_FALSE(track.at(200));
  CHECK(track.at(300) == 5.0);
  CHECK(track.mean(0, 100) == 2.0);
  CHECK_FALSE(track.mean(0, 101));
}

TEST_CASE("forgetting keeps what is needed later", "[motion][interpolation]") {
  SampleTrack<double> track;
  for (int i = 0; i < 1000; ++i) {
    track.push(i * 10, i);
    track.forget_before(i * 10 - 55);
    CHECK(track.size() <= 8);
    if (i > 6) CHECK(track.at(i * 10 - 55).value() == Approx(i - 5.5));
  }
}
